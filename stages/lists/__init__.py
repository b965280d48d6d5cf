"""Points in the order of a list: whole clouds of other sensors, and what of KITTI's lies off the rings."""

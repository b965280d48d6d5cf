"""Points off the rings of KITTI's files: put on a sensor's lattice all the same (aimed), along guessed rays, or by their bits."""

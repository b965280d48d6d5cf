"""Points on the lattice of a sensor whose model is known, in the order of their list: laser, tick, count, and what the model is off by."""

"""One scan of the sensor profile <-> its payload: mask, levels, corrections, strays, intensities, classes."""

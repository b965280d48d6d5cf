"""Points without a lattice: each on a ray guessed from the points around it."""

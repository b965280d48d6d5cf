"""What efforts above ``fast`` learn of lists of points: their order, counts and rays, by neighbours and by the sweep before."""

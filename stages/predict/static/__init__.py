"""Predictions of effort ``fast``: a few running means, and distributions from shipped tables."""

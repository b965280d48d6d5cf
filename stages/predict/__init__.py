"""Predict: what the next range will be, and how sure that is."""

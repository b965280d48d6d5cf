"""Scans by what is in them: the catalogue of an output folder, and conditions over it."""

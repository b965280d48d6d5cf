"""Ingest: sources, sensor model, motion inversion, lattice; scan <-> sweep."""

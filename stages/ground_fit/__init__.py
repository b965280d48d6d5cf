"""Ground fit: a plane model per ground region (paper, section V-A)."""

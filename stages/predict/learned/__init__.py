"""The learned range model: features, a small exact network, a mixture of logistics (docs/sensor_lattice.md 3, 4)."""

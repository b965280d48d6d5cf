"""The learned range model: features, a small exact network, a mixture of logistics (SENSOR_LATTICE 3, 4)."""

"""Find the sensor model of scans that nothing is known of."""

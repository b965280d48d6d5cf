"""Where the sensor was: poses that are given, read and checked, or found by registration; and scans as they were seen from there."""

"""Clean maps and localisation from decoded scans: kernels on NumPy arrays, one file per verb.

Poses are ``(4, 4)`` float64 and take a point of the sensor's frame to the map's; a point of a scan is in the
sensor's frame in the middle of its turn, as compensated scans are.
"""

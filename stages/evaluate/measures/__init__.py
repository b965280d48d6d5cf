"""What is measured of decoded scans: errors point by point, sums of a sequence."""

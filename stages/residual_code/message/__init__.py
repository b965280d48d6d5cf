"""What a recorded PointCloud2 holds besides x, y, z and intensity <-> bytes."""

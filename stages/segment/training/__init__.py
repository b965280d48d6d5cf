"""Train the segmentation network: labelled scans from disk, augmented crops, losses, the loop."""

"""The network of section IV: what it reads of a scan, its layers, and how it is run; from range image and points to logits."""

"""Residual code: entropy coders, payloads, the archive reader and writer."""

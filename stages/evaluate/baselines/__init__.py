"""Baselines: the codecs that this project is compared with, one file each."""

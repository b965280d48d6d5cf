"""Entropy coding: symbols <-> bytes. Knows nothing of LiDAR.

Range coder and rANS at the bottom; on them columns, symbols, integers, bytes and intervals with models that learn.
"""

"""The sensor lattice: a scan <-> its sweep (laser, tick, count), bit for bit; see docs/sensor_lattice.md.

A sensor model, the formulas of its returns, the motion that was compensated, and trigonometry that is the same everywhere.
"""

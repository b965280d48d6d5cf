"""Hesai's own driver for the Pandar64 in another version: as :mod:`.pandar`, but that azimuth indices become degrees in float32, as of :mod:`.velodyne`.

With azimuth index i, all in float32::

    C[i], S[i] = cosine, sine of the float32 next to i * 0.01 degrees in radians
    c, s, x, y, z: as of pandar
"""

from __future__ import annotations

from salpcc.stages.lattice.drivers.pandar import bearing, phase, row
from salpcc.stages.lattice.drivers.velodyne import STEPS, table

__all__ = ["STEPS", "bearing", "phase", "row", "table"]

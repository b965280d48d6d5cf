"""Cast rays into the street and its traffic with Embree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from salpcc.schemas.errors import UsageError
from salpcc.stages.ingest.simulator.drive import Drive
from salpcc.stages.ingest.simulator.mesh import Mesh, merge
from salpcc.stages.ingest.simulator.street import Piece
from salpcc.stages.ingest.simulator.traffic import Mover

try:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene
except ImportError as error:  # no wheel of it for Linux on ARM
    raise UsageError(f"the simulator needs embreex ({error}): pip install 'salpcc-pipeline[run]'") from error

F64 = NDArray[np.float64]
_WINDOW = 40.0  # metres of drive between two rebuilds of the static scene
_REACH = 95.0  # metres of street on either side that a scene holds


@dataclass(frozen=True, eq=False)
class Hits:
    """What each ray met; ``distance`` is inf where nothing. All arrays ``(N,)``."""

    distance: F64
    cosine: F64
    material: NDArray[np.uint8]
    label: NDArray[np.uint32]
    gain: F64


class _Scene:
    """A mesh in Embree."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.centre = mesh.vertices.mean(0)
        self._scene = EmbreeScene(robust=True)  # a ray along a shared edge meets one of its triangles
        TriangleMesh(
            self._scene, (mesh.vertices - self.centre).astype(np.float32), mesh.triangles.astype(np.int32)
        )

    def cast(self, origin: F64, direction: F64) -> Hits:
        """Cast rays ``(N, 3)``; directions are unit vectors."""
        toward = direction.astype(np.float32)
        answer = self._scene.run((origin - self.centre).astype(np.float32), toward, output=True)
        hit = answer["primID"] >= 0
        distance = np.where(hit, answer["tfar"], np.inf).astype(np.float64)
        triangle = np.where(hit, answer["primID"], 0)
        normal = answer["Ng"]  # as long as the triangle is large
        length = np.where(hit, np.linalg.norm(normal, axis=1), 1)
        cosine = np.abs((normal * toward).sum(1) / length).astype(np.float64)
        m = self.mesh
        return Hits(distance, cosine, m.material[triangle], m.label[triangle], m.gain[triangle])


class Caster:
    """The world of one drive: static scene in windows, movers each in a scene of their own."""

    def __init__(self, drive: Drive, ground: Mesh, pieces: list[Piece], movers: list[Mover]) -> None:
        self._drive, self._ground, self._pieces, self._movers = drive, ground, pieces, movers
        self._mover_scenes = [_Scene(m.mesh) for m in movers]
        self._radii = [float(np.linalg.norm(m.mesh.vertices, axis=1).max()) for m in movers]
        self._window = -1
        self._static: _Scene | None = None

    def _scene(self, s: float) -> _Scene:
        window = int(s // _WINDOW)
        if self._static is None or window != self._window:
            low, high = window * _WINDOW - _REACH, (window + 1) * _WINDOW + _REACH
            near = [p.mesh for p in self._pieces if low < p.s < high]
            self._static, self._window = _Scene(merge([self._ground, *near])), window
        return self._static

    def cast(self, origin: F64, direction: F64, t: float, delay: F64) -> Hits:
        """Cast world rays ``(N, 3)`` of the scan at time ``t``; ``delay`` seconds after it per ray."""
        hits = self._scene(float(self._drive.length(t))).cast(origin, direction)
        eye = origin.mean(0)
        bearing = np.arctan2(direction[:, 1], direction[:, 0])
        for mover, scene, radius in zip(self._movers, self._mover_scenes, self._radii, strict=True):
            _, place = mover.pose(self._drive, t)
            away = place[:2] - eye[:2]
            far = float(np.hypot(*away))
            if far > 85.0:
                continue
            half = np.pi if far < radius + 3 else np.arcsin((radius + 2) / far)
            off = np.abs((bearing - np.arctan2(away[1], away[0]) + np.pi) % (2 * np.pi) - np.pi)
            near = np.flatnonzero(off < half)
            self._overlay(hits, mover, scene, near, origin[near], direction[near], t, delay[near])
        return hits

    def _overlay(
        self,
        hits: Hits,
        mover: Mover,
        scene: _Scene,
        near: NDArray[np.intp],
        origin: F64,
        direction: F64,
        t: float,
        delay: F64,
    ) -> None:
        """Cast into the frame of a mover, which goes straight and turns evenly within a scan."""
        (yaw_a, a), (yaw_b, b) = (mover.pose(self._drive, t + d) for d in (-0.06, 0.06))
        part = (delay + 0.06) / 0.12
        yaw = yaw_a + part * (yaw_b - yaw_a)
        c, s = np.cos(yaw), np.sin(yaw)
        x, y, z = (origin - (a + part[:, None] * (b - a))).T
        dx, dy, dz = direction.T
        own = np.stack([c * x + s * y, c * y - s * x, z], 1)
        answer = scene.cast(own, np.stack([c * dx + s * dy, c * dy - s * dx, dz], 1))
        closer = answer.distance < hits.distance[near]
        at = near[closer]
        hits.distance[at], hits.cosine[at] = answer.distance[closer], answer.cosine[closer]
        hits.material[at], hits.label[at], hits.gain[at] = (
            answer.material[closer],
            answer.label[closer],
            answer.gain[closer],
        )

"""MPEG G-PCC by its test model, ``tmc3`` (TMC13), where the program is at hand (``--tmc3``, or on the PATH).

Points are rounded to a grid of twice the asked error and coded losslessly on it: by the octree, plain or in angular
mode with the lasers of our own sensor model, or by the predictive tree in that mode (the best bounded mode on
spinning sensors). Geometry only. The order is lost. The time is the user time that the program tells, files excluded.
"""

from __future__ import annotations

import re
import struct
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.evaluate.baselines.baseline import (
    Baseline,
    NotPossible,
    Points,
    Promise,
    dequantize,
    find_program,
    quantize,
    step_of,
)

PROGRAM = "tmc3"
_HEAD = struct.Struct("<d")
_LIMIT_S = 60
_USER_TIME = re.compile(r"^Processing time \(user\): ([\d.]+) s", re.MULTILINE)
_told: list[float] = []  # the time of the last call
_COMMON = ("--disableAttributeCoding=1", "--mergeDuplicatedPoints=0", "--positionQuantizationScale=1")
_OCTREE = (
    "--trisoupNodeSizeLog2=0",
    "--neighbourAvailBoundaryLog2=8",
    "--intra_pred_max_node_size_log2=6",
    "--inferredDirectCodingMode=3",
    "--maxNumQtBtBeforeOt=6",
    "--minQtbtSizeLog2=0",
    "--planarEnabled=1",
    "--planarModeIdcmUse=32",
)
_AZIMUTH_UNITS = 1 << 24  # a turn, at positionAzimuthScaleLog2 = 12
_PREDICTIVE = (
    "--geomTreeType=1",
    "--predGeomSort=0",
    "--sortInputByAzimuth=1",
    "--predGeomAzimuthSortPrecision=1024",
    "--positionAzimuthScaleLog2=12",
)


def _angular(step: float) -> list[str]:
    """Options of the angular mode for our 64-laser sensor."""
    from salpcc.stages.lattice.sensor_model import load_sensor

    sensor = load_sensor("hdl64e")
    rising = np.argsort(sensor.theta)
    ticks = sensor.ticks_per_turn
    return [
        f"--positionAzimuthSpeed={_AZIMUTH_UNITS // ticks}",
        "--angularEnabled=1",
        "--lidarHeadPosition=0,0,0",
        f"--numLasers={sensor.n_lasers}",
        "--lasersTheta=" + ",".join(f"{value:.6f}" for value in np.tan(sensor.theta[rising])),
        "--lasersZ=" + ",".join(f"{value:.3f}" for value in -sensor.z0[rising] / step),
        "--lasersNumPhiPerTurn=" + ",".join([str(ticks)] * sensor.n_lasers),
        "--planarBufferDisabled=1",
    ]


def _encode(points: Points, max_error: float, tree: Sequence[str], angular: bool) -> bytes:
    step = step_of(max_error)
    levels = quantize(points[:, :3], step)
    if len(levels) and np.abs(levels).max() >= 2**20:
        raise NotPossible("a coordinate does not fit 21 bits at this step")
    with tempfile.TemporaryDirectory() as folder:
        source, stream = Path(folder) / "in.ply", Path(folder) / "out.bin"
        source.write_bytes(to_ply(levels.astype(np.int32)))
        options = [*tree, *(_angular(step) if angular else ())]
        paths = [f"--uncompressedDataPath={source}", f"--compressedStreamPath={stream}"]
        _run(["--mode=0", *_COMMON, *options, *paths])
        return _HEAD.pack(step) + stream.read_bytes()


def decode(data: bytes) -> Points:
    """Decode either mode; the stream says which it is."""
    (step,) = _HEAD.unpack_from(data)
    with tempfile.TemporaryDirectory() as folder:
        stream, decoded = Path(folder) / "in.bin", Path(folder) / "out.ply"
        stream.write_bytes(data[_HEAD.size :])
        paths = [f"--compressedStreamPath={stream}", f"--reconstructedDataPath={decoded}"]
        _run(["--mode=1", "--outputBinaryPly=1", *paths])
        return dequantize(from_ply(decoded.read_bytes()), float(step))


def _run(options: Sequence[str]) -> None:
    """Run the program.

    Raises:
        NotPossible: it fails, or takes more than a minute; its last line says why.
    """
    _told.clear()
    command = [find_program(PROGRAM) or PROGRAM, *options]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise NotPossible(f"{PROGRAM} took more than {_LIMIT_S} s") from error
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
        raise NotPossible(f"{PROGRAM} failed: {lines[-1]}")
    _told.extend(float(seconds) for seconds in _USER_TIME.findall(done.stdout))


def _own_seconds() -> float | None:
    """The user time that the last call told, or None where it told none."""
    return _told[-1] if _told else None


def to_ply(levels: NDArray[np.int32]) -> bytes:
    """Write ``(N, 3)`` integers as a binary PLY of float32 coordinates, which hold them exactly."""
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(levels)}"]
    head += [f"property float {axis}" for axis in "xyz"]
    return "\n".join([*head, "end_header\n"]).encode() + levels.astype("<f4").tobytes()


def from_ply(data: bytes) -> NDArray[np.float64]:
    """Read the vertices ``(N, 3)`` of a binary PLY that has three floats or doubles each, and maybe no faces.

    Raises:
        NotPossible: another kind of PLY.
    """
    head, _, body = data.partition(b"end_header\n")
    words = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    counts = {word[1]: int(word[2]) for word in words if word[0] == "element"}
    kinds = {word[1] for word in words if word[0] == "property" and word[1] != "list"}
    names = [word[2] for word in words if word[0] == "property" and word[1] != "list"]
    kind = {"float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8"}.get("".join(kinds))
    plain = ["format", "binary_little_endian", "1.0"] in words and not counts.get("face")
    if not plain or kind is None or names != ["x", "y", "z"]:
        raise NotPossible(f"{PROGRAM} wrote a PLY of {counts} with {names}, expected vertices x, y, z")
    return np.frombuffer(body, kind, 3 * counts["vertex"]).reshape(-1, 3).astype(np.float64)


def _baseline(title: str, tree: Sequence[str], angular: bool) -> Baseline:
    return Baseline(
        title=title,
        packages=(),
        promise=Promise(bound="axis", order=False, count=True, intensity=False),
        encode=lambda points, max_error: _encode(points, max_error, tree, angular),
        decode=decode,
        program=PROGRAM,
        own_seconds=_own_seconds,
    )


TMC13 = _baseline("MPEG TMC13, predictive, angular", _PREDICTIVE, angular=True)
TMC13_OCTREE = _baseline("MPEG TMC13, octree", _OCTREE, angular=False)
TMC13_OCTREE_ANGULAR = _baseline("MPEG TMC13, octree, angular", _OCTREE, angular=True)

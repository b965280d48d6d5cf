"""Scans of arrays with any fields, and what is said of arrays of wrong kinds."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from salpcc import Archive, encode_scans, scan_from_arrays
from salpcc.schemas.errors import KindError, UsageError
from salpcc.schemas.scan import Scan

N = 500


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return np.random.default_rng(0).normal(0, 10, (N, 3)).astype(np.float32)


FIELDS: dict[str, np.ndarray] = {
    "ring": np.arange(N, dtype=np.uint8) % 32,
    "time": np.arange(N, dtype=np.uint32) * 1000,
    "offset": np.linspace(-1, 1, N, dtype=np.float32),
    "stamp_s": 1.6e9 + np.arange(N) * 1e-5,
    "normal": np.random.default_rng(1).normal(0, 1, (N, 3)).astype(np.float32),
    "signed": np.arange(N, dtype=np.int16) - 250,
}


@pytest.mark.parametrize("max_error", [None, 0.01])
def test_fields_come_back_bit_for_bit(points: np.ndarray, tmp_path: Path, max_error: float | None) -> None:
    intensity = np.arange(N, dtype=np.uint16)
    path = tmp_path / "a.mcap"
    encode_scans(points, path, intensity=intensity, effort="fast", max_error=max_error, **FIELDS)  # type: ignore[arg-type]
    with Archive.open(path) as archive:
        (scan,) = archive
    assert np.linalg.norm(scan.points - points, axis=1).max() <= (max_error or 0)
    assert (scan.intensity == intensity).all() and list(scan.fields) == list(FIELDS)
    for name, values in FIELDS.items():
        assert scan.fields[name].dtype == values.dtype and scan.fields[name].tobytes() == values.tobytes()


def test_tensors_are_arrays(points: np.ndarray, tmp_path: Path) -> None:
    """With gradients or without, views of other order, alone or in scans."""
    xyz = torch.from_numpy(points).double().requires_grad_()
    ring = torch.arange(N, dtype=torch.int32)
    encode_scans(xyz, tmp_path / "a.mcap", ring=ring, intensity=torch.rand(N).round(), effort="fast")  # type: ignore[arg-type]
    scan = Archive.open(tmp_path / "a.mcap")[0]
    assert (scan.points == points).all() and (scan.fields["ring"] == ring.numpy()).all()
    plain = Scan("b", xyz, torch.zeros(N), classes=torch.full((N,), 9))  # type: ignore[arg-type]
    encode_scans([plain], tmp_path / "b.mcap", effort="fast", labels="given")
    back = Archive.open(tmp_path / "b.mcap")["b"]
    assert (back.points == points).all() and (back.classes == 9).all() and back.fields == {}
    assert (scan_from_arrays(np.asfortranarray(points)[::-1]).points == points[::-1]).all()


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"points": np.zeros((5, 4), np.float32)}, "give the fourth column as intensity"),
        ({"points": np.zeros(5)}, r"shape \(5,\)"),
        ({"points": np.array([["a", "b", "c"]])}, "of type <U1"),
        ({"points": np.full((1, 3), 0.1)}, "float32 would change"),
        ({"intensity": np.zeros(4)}, r"intensity of shape \(4,\) for 5 points"),
        ({"ring": np.zeros(4, np.uint8)}, r"ring of shape \(4,\) for 5 points"),
        ({"ring": np.zeros((5, 2, 2), np.uint8)}, "ring of shape"),
        ({"ring": np.zeros(5, np.int64)}, r"ring of type int64.*astype\(numpy.uint8\)"),
        ({"ring": np.arange(5) - 40_000}, r"astype\(numpy.int32\)"),
        ({"time": np.full(5, 1 << 60)}, r"view\(numpy.uint32\).* all of its bits"),
        ({"flag": np.zeros(5, np.bool_)}, r"flag of type bool.*uint8"),
        ({"ring": np.zeros(5, np.float16)}, r"astype\(numpy.float32\)"),
        ({"ring": torch.zeros(5, dtype=torch.bfloat16)}, "is no array"),
        ({"points": torch.zeros(5, 3, device="meta")}, "is no array"),
        ({"points": np.full((5, 3), (1 << 53) + 1)}, "float32 would change"),  # as float64 would, too
        ({"points": np.ma.masked_equal(np.eye(5, 3), 1)}, "nothing holds the mask"),
        ({"ring": np.ma.masked_equal(np.arange(5, dtype=np.uint8), 3)}, "give the mask as a field"),
    ],
)
def test_wrong_kinds_are_type_errors(arrays: dict[str, Any], said: str) -> None:
    given = {"points": np.zeros((5, 3), np.float32), **arrays}
    with pytest.raises(TypeError, match=said) as caught:
        scan_from_arrays(given.pop("points"), **given)
    assert isinstance(caught.value, UsageError)


def test_classes_that_are_given_are_kept(points: np.ndarray, tmp_path: Path) -> None:
    """With points or with scans, where nobody asks the network for others; without a word nothing is left out."""
    classes = np.arange(N) % 9
    encode_scans(points, tmp_path / "a.mcap", classes=classes, effort="fast")
    scan = Archive.open(tmp_path / "a.mcap")[0]
    assert scan.classes is not None and (scan.classes == classes).all() and scan.movable is None
    encode_scans(Archive.open(tmp_path / "a.mcap"), tmp_path / "b.mcap", effort="fast")
    again = Archive.open(tmp_path / "b.mcap")[0]
    assert again.classes is not None and (again.classes == classes).all()
    some = [
        Scan("a", points, points[:, 0]),
        Scan("b", points, points[:, 0], classes=classes.astype(np.uint8)),
    ]
    with pytest.raises(UsageError, match="scan 'b': it has classes, and the scans before have none"):
        encode_scans(some, tmp_path / "c.mcap", effort="fast")
    with pytest.raises(UsageError, match="scan 'a': labels are given, but its classes are None"):
        encode_scans(some[::-1], tmp_path / "c.mcap", effort="fast")


def test_arrays_may_be_filled_again(points: np.ndarray, tmp_path: Path) -> None:
    """Scans of a group are coded together, later than each was made."""
    xyz, classes, labels = points.copy(), np.zeros(N, np.uint8), np.zeros(N, np.uint32)

    def scans() -> Iterator[Scan]:
        for n in range(5):
            xyz[:], classes[:], labels[:] = points * np.float32(n), n, n
            yield Scan(f"{n}", xyz, xyz[:, 1], labels=labels, classes=classes)

    encode_scans(scans(), tmp_path / "a.mcap", effort="fast", gop=3)
    for n, scan in enumerate(Archive.open(tmp_path / "a.mcap")):
        assert (scan.points == points * np.float32(n)).all() and (scan.intensity == scan.points[:, 1]).all()
        assert scan.labels is not None and (scan.labels == n).all()
        assert scan.classes is not None and (scan.classes == n).all()


def test_what_does_not_go_together(points: np.ndarray, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="x is a column"):
        scan_from_arrays(points, x=points[:, 0])
    for name in ("", "a\0b", "\udc80"):
        with pytest.raises(UsageError, match="a name is text that can be printed"):
            scan_from_arrays(points, **{name: points[:, 0]})
    for name in ("points", "stamp", "name", "frame_id"):
        with pytest.raises(UsageError, match=f"cannot be named {name}"):
            encode_scans(points, tmp_path / "a.mcap", **{name: points[:, 0]})  # type: ignore[arg-type]
    for nothing in (None, 3):
        with pytest.raises(KindError, match="neither scans nor an array"):
            encode_scans(nothing, tmp_path / "a.mcap")  # type: ignore[arg-type]
    scan = Scan("a", points, points[:, 0])
    with pytest.raises(KindError, match="ring: arrays go with points"):
        encode_scans([scan], tmp_path / "a.mcap", ring=np.zeros(N))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="ndarray is no Scan"):
        encode_scans([points], tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_scans_by_time(points: np.ndarray, tmp_path: Path) -> None:
    times = (0, 100, 200, 1000)
    scans = [Scan(f"{n:06d}", points, points[:, 0], time) for n, time in enumerate(times)]
    archive = Archive.open(encode_scans(scans, tmp_path / "a.mcap", effort="fast", gop=3))
    assert archive.times.tolist() == list(times) and archive.times.dtype == np.int64
    for time, name in ((0, 0), (-5, 0), (149, 1), (150, 1), (151, 2), (np.int64(601), 3), (1 << 80, 3)):
        assert archive.at(time).name == f"{name:06d}"  # type: ignore[arg-type]
    for wrong in (1.5, "100", True, None):
        with pytest.raises(TypeError, match="whole number of nanoseconds"):
            archive.at(wrong)  # type: ignore[arg-type]

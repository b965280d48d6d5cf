"""What ``encode_scans`` takes, what it refuses before anything is written, and that it checks what it wrote."""

from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from salpcc.pipeline import Archive, Scan, decode, encode_scans
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import ArchiveError, UsageError

FAST: dict[str, Any] = {"effort": "fast"}


def scan_of(n: int = 50, **fields: Any) -> Scan:
    rng = np.random.default_rng(n)
    made = Scan("0", rng.normal(0, 9, (n, 3)).astype(np.float32), rng.random(n).astype(np.float32))
    return replace(made, **fields)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"points": np.zeros((50, 4), np.float32)}, r"points of shape \(50, 4\)"),
        ({"points": np.zeros(150, np.float32)}, r"points of shape \(150,\)"),
        ({"points": np.full((50, 3), 5_000_000.1)}, "float32 would change by up to 0.1.*take an offset off"),
        ({"points": np.full((50, 3), 1e300)}, "float32 would change"),
        ({"points": np.zeros((50, 3), np.complex128)}, "type complex128"),
        ({"points": np.full((50, 3), "1")}, "type <U1"),
        ({"points": None}, "points of type object"),
        ({"intensity": np.zeros(49, np.float32)}, r"intensity of shape \(49,\) for 50 points"),
        ({"intensity": np.zeros((50, 1), np.float32)}, "intensity of shape"),
        ({"intensity": np.full(50, 0.1)}, "intensity of type float64 that float32 would change"),
        ({"time": 1.5}, "time 1.5 is no whole number of nanoseconds"),
        ({"time": -1}, "negative"),
        ({"time": 1 << 63}, "too large"),
        ({"time": True}, "no whole number"),
        ({"name": "a/b"}, "without slashes"),
        ({"name": ".."}, "without slashes"),
        ({"name": ""}, "without slashes"),
        ({"name": 7}, "a name is text"),
        ({"name": "\ud800"}, "a name is text"),
        ({"name": "n" * 300}, "at most 200 bytes"),
        ({"frame_id": None}, "frame_id None is no text"),
        ({"classes": np.zeros(49, np.uint8)}, r"classes uint8 of shape \(49,\)"),
        ({"classes": np.full(50, 99)}, "class 99 is none of"),
        ({"classes": np.full(50, -1)}, "is none of"),
        ({"classes": np.zeros(50)}, "classes float64"),
    ],
)
def test_what_is_no_scan_is_refused_and_nothing_written(
    tmp_path: Path, fields: dict[str, Any], said: str
) -> None:
    scans = [scan_of(name="first"), scan_of(**fields)]
    with pytest.raises(UsageError, match=said):
        encode_scans(scans, tmp_path / "a.mcap", **FAST)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("scans", "options", "said"),
    [
        ([], {}, "no scans"),
        ([scan_of(), scan_of()], {}, "one of that name already"),
        ([scan_of()], {"sequence": "a/b"}, "without slashes"),
        ([scan_of()], {"max_error": -1}, "option max_error"),
        ([scan_of()], {"loudness": 11}, "option loudness"),
        ([scan_of()], {"labels": "given", "keep_movable": False}, "its classes are None"),
        ([scan_of()], {"device": "cuda"}, "option device: there is none"),
        ([scan_of()], {"gop": None}, "option gop: .*valid integer"),
        ([scan_of()], {"effort": "maximal"}, "option effort: .*'fast', 'default' or 'max'"),
        ([np.zeros((5, 4))], {}, "ndarray is no Scan"),
    ],
)
def test_wrong_use_is_refused_and_nothing_written(
    tmp_path: Path, scans: list[Any], options: dict[str, Any], said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        encode_scans(scans, tmp_path / "a.mcap", **{**FAST, **options})
    assert not list(tmp_path.iterdir())


def test_what_is_there_stays_unless_told(tmp_path: Path) -> None:
    path = encode_scans([scan_of()], tmp_path / "a.mcap", **FAST)
    before = path.read_bytes()
    with pytest.raises(UsageError, match="overwrite=True"):
        encode_scans([scan_of(60)], path, **FAST)
    assert path.read_bytes() == before
    assert len(Archive.open(encode_scans([scan_of(60)], path, overwrite=True, **FAST))[0]) == 60


@pytest.mark.parametrize("points", [np.float64, np.float16, np.int32])
def test_other_types_that_lose_nothing_are_taken(tmp_path: Path, points: type) -> None:
    wanted = np.arange(150).reshape(50, 3).astype(np.float32)
    given = scan_of(
        points=wanted.astype(points), intensity=np.arange(50), time=np.int64(7), classes=np.arange(50) % 5
    )
    with Archive.open(encode_scans([given], tmp_path / "a.mcap", labels="given", **FAST)) as archive:
        assert archive[0].points.tobytes() == wanted.tobytes() and archive[0].time == 7
        assert archive[0].classes is not None and archive[0].classes.tolist() == (np.arange(50) % 5).tolist()


def test_what_does_not_come_back_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = decode.scan_of

    def spoiled(*arguments: Any) -> Scan:
        scan = real(*arguments)
        scan.intensity[3] += 1
        return scan

    monkeypatch.setattr(decode, "scan_of", spoiled)
    with pytest.raises(ArchiveError, match=r"not written.*scan 0: intensity differs"):
        encode_scans([scan_of()], tmp_path / "a.mcap", **FAST)
    assert not list(tmp_path.iterdir())


def test_writing_into_a_scan_changes_no_other(tmp_path: Path, toy_root: Path, done: Path) -> None:
    """Arrays are the caller's own, also those that the decoder goes on from."""
    with Archive.open(done / "archives" / "00.mcap") as archive:
        wanted = [scan.points.tobytes() + scan.intensity.tobytes() for scan in archive]
        for scan in archive:
            for values in (scan.points, scan.intensity, scan.motion, scan.classes):
                if values is not None:
                    values[:] = 0
        for place in (0, 0, 1, 0, 4):
            scan = archive[place]
            assert scan.points.tobytes() + scan.intensity.tobytes() == wanted[place]
            scan.points[:] = 0
            scan.intensity[:] = 0


def test_options_are_those_of_a_run() -> None:
    """Typed and with their defaults, but that arrays keep what can move in their one layer; wrong types are TypeErrors."""
    options = {
        name: parameter.default
        for name, parameter in signature(encode_scans).parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY and name not in ("overwrite", "intensity")
    }
    assert options == {name: getattr(RunConfig(), name) for name in options} | {"keep_movable": True}
    of_runs = {"source", "frames", "topics", "columns", "side_files", "baselines", "device"}
    told_by_names = {"sensor_digest", "weights_digest"}
    assert set(RunConfig.model_fields) == {*options, *of_runs, *told_by_names}
    for wrong in ({"max_eror": 0.01}, {"gop": "8 scans"}, {"sensor": 64}, {"ring": [1, 2]}):
        with pytest.raises(UsageError, match=f"option {next(iter(wrong))}: ") as caught:
            encode_scans([scan_of()], "never.mcap", **wrong)  # type: ignore[arg-type]
        assert isinstance(caught.value, TypeError) == ("gop" not in wrong)

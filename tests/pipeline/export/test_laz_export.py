"""LAZ, read by laspy: one unit of intensity for an archive, and nothing lost without a word."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path

import laspy
import numpy as np
import pytest

from salpcc.pipeline import Archive, Scan, encode_scans
from salpcc.pipeline.export.gps_time import adjusted_gps_time
from salpcc.pipeline.export.laz import SCALE, to_laz
from salpcc.schemas.errors import UsageError

from ..conftest import cloud_of

N = 500


def rows_of(intensity: np.ndarray, **more: np.ndarray) -> np.ndarray:
    """Points on a line, with intensities and other fields of any type."""
    fields = {"x": "f4", "y": "f4", "z": "f4", "intensity": intensity.dtype} | {
        k: v.dtype for k, v in more.items()
    }
    rows = np.zeros(len(intensity), list(fields.items()))
    rows["x"] = np.arange(len(intensity)) / 100
    rows["intensity"] = intensity
    for name, values in more.items():
        rows[name] = values
    return rows


def written(scans: list[Scan], folder: Path, **options: str) -> tuple[list[laspy.LasData], list[str]]:
    """Read what ``to_laz`` writes of an archive of these scans, and what it tells."""
    labels = "given" if scans[0].classes is not None else "network"
    archive = Archive.open(encode_scans(scans, folder / "a.mcap", labels=labels, effort="fast"))
    told: list[str] = []
    files = [laspy.read(path) for path in to_laz(archive, iter(archive), folder, told.append, **options)]
    return files, told


def text_of(las: laspy.LasData) -> str:
    (record,) = [v for v in las.header.vlrs if (v.user_id, v.record_id) == ("LASF_Spec", 3)]
    return bytes(record.record_data_bytes()).decode()


def ramp(low: float, high: float) -> np.ndarray:
    return np.linspace(low, high, N).astype(np.float32)


def with_one(value: float) -> np.ndarray:
    values = ramp(0, 1)
    values[7] = value
    return values


@pytest.mark.parametrize(
    ("intensity", "factor", "wrong"),
    [
        (ramp(0, 1), 65535, 0),
        (with_one(1.02), 65535, 1),
        (with_one(np.inf), 65535, 1),
        (with_one(np.nan), 65535, 1),
        (ramp(-2, 0.9), 65535, int((ramp(-2, 0.9) < 0).sum())),
        (ramp(0, 255), 1, 0),
        ((np.arange(N) % 2).astype(np.uint8), 1, 0),
        ((np.arange(N) % 200).astype(np.uint8), 1, 0),
        (np.arange(N).astype(np.uint16) * 131, 1, 0),
        (np.arange(N).astype(np.uint32) * 1000, 1, int((np.arange(N) * 1000 > 65535).sum())),
        (np.arange(N).astype(np.int16) - 5, 1, 5),
        (np.linspace(0, 1, N), 65535, 0),
    ],
    ids=lambda value: str(value.dtype) if isinstance(value, np.ndarray) else str(value),
)
def test_a_ramp_stays_a_ramp(intensity: np.ndarray, factor: int, wrong: int, tmp_path: Path) -> None:
    (las,), told = written([cloud_of(rows_of(intensity))], tmp_path)
    with np.errstate(invalid="ignore"):
        expected = np.rint(np.nan_to_num(np.clip(intensity.astype(np.float64) * factor, 0, 65535)))
    assert np.array_equal(las.intensity, expected)
    whole = intensity.dtype in (np.uint8, np.uint16)
    assert ("recorded_intensity" in las.point_format.extra_dimension_names) != whole
    if not whole:
        assert las.recorded_intensity.tobytes() == intensity.tobytes()
        assert las.recorded_intensity.dtype == intensity.dtype
    unit = (
        f"{intensity.dtype} counts as recorded"
        if factor == 1
        else f"{intensity.dtype} as recorded times 65535"
    )
    assert told[0].startswith(f"intensity: {unit}") and told[0] in text_of(las)
    assert [line for line in told[1:] if line.startswith(f"intensity: {wrong} negative")] == told[1:]
    assert len(told) == 1 + bool(wrong)


def test_an_archive_has_one_unit(tmp_path: Path) -> None:
    """A dark scan of a sensor of counts, and a bright point of one of fractions, are of their sensor's unit."""
    dark, light = (np.arange(N) % 2).astype(np.float32), ramp(0, 255)
    files, told = written(
        [cloud_of(rows_of(i), number=n) for n, i in enumerate([dark, light, dark])], tmp_path
    )
    assert [int(las.intensity.max()) for las in files] == [1, 255, 1] and len(told) == 1
    archive = Archive.open(tmp_path / "a.mcap")
    (path,) = to_laz(archive, iter([archive[0]]), tmp_path / "one")  # whichever scans are asked for
    assert laspy.read(path).intensity.max() == 1


def test_topics_have_units_of_their_own(tmp_path: Path) -> None:
    counts, fractions = np.arange(N).astype(np.uint8), ramp(0, 1)
    scans = [cloud_of(rows_of(counts), topic="/a"), cloud_of(rows_of(fractions), topic="/b", number=1)]
    files, told = written(scans, tmp_path)
    assert [int(las.intensity.max()) for las in files] == [255, 65535] and len(told) == 2


def test_every_field_comes_along(tmp_path: Path) -> None:
    more = {
        "ring": (np.arange(N) % 16).astype(np.uint16),
        "time": np.linspace(-0.1, 0, N),
        "gps_time": np.arange(N).astype(np.uint32),
        "a_name_that_is_longer_than_las_allows_1": np.full(N, -3, np.int8),
        "a_name_that_is_longer_than_las_allows_2": np.full(N, -4, np.int8),
    }
    (las,), _ = written([cloud_of(rows_of(ramp(0, 1), **more))], tmp_path)
    names = list(las.point_format.extra_dimension_names)
    assert names == [
        "recorded_intensity", "ring", "time", "recorded_gps_time", "a_name_that_is_longer_than_l_1",
        "a_name_that_is_longer_than_l_2",
    ]  # fmt: skip
    for name, values in zip(names[1:], more.values(), strict=True):
        assert las[name].dtype == values.dtype and las[name].tobytes() == values.tobytes()


def test_returns_classes_and_time(tmp_path: Path) -> None:
    classes = np.array([0, 1, 9, 13, 15, 20] * 5, np.uint8)
    scan = replace(cloud_of(rows_of(ramp(0, 1)[:30])), classes=classes)
    (las,), _ = written([scan], tmp_path)
    assert (las.return_number == 1).all() and (las.number_of_returns == 1).all()
    assert las.classification.tolist() == [1, 1, 2, 6, 5, 2] * 5
    assert las.user_data.tobytes() == classes.tobytes() and "15 vegetation" in text_of(las)
    assert las.header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    assert np.array_equal(las.gps_time, np.full(30, adjusted_gps_time(scan.time)))
    assert las.header.creation_date == date(2020, 9, 13)


def test_gps_time_is_ahead_of_utc_by_leap_seconds() -> None:
    def nanoseconds(*date: int) -> int:
        return int(datetime(*date, tzinfo=UTC).timestamp()) * 10**9  # type: ignore[misc]

    weeks = 7 * 86400 * 2086  # GPS week 2086 began on 29 December 2019
    assert adjusted_gps_time(nanoseconds(2019, 12, 28, 23, 59, 42)) == weeks - 1e9
    assert adjusted_gps_time(nanoseconds(2016, 12, 31, 23, 59, 59)) + 2 == adjusted_gps_time(
        nanoseconds(2017, 1, 1)
    )
    assert adjusted_gps_time(nanoseconds(2003, 1, 1)) == nanoseconds(2003, 1, 1) / 1e9 + 13 - 315964800 - 1e9


def test_scans_that_were_files_are_within_the_rounding(done: Path, tmp_path: Path) -> None:
    archive = Archive.open(done / "archives" / "01.mcap")
    (path, *_) = to_laz(archive, iter(archive), tmp_path)
    las = laspy.read(path)
    assert np.abs(np.asarray(las.xyz) - archive[0].points).max() <= SCALE / 2 + 1e-9
    assert las.recorded_intensity.tobytes() == archive[0].intensity.tobytes()
    assert las.header.global_encoding.gps_time_type == laspy.header.GpsTimeType.WEEK_TIME
    assert set(np.asarray(las.gps_time)) == {archive[0].time / 1e9}


def test_points_that_laz_cannot_hold_are_told(tmp_path: Path) -> None:
    rows = rows_of(ramp(0, 1))
    rows["y"][:3] = np.nan, np.inf, 3e38
    (las,), told = written([cloud_of(rows)], tmp_path)
    assert len(las) == N - 3 and las.recorded_intensity.tobytes() == rows["intensity"][3:].tobytes()
    assert told[1].startswith("3 points are left out")


def test_coordinates_of_a_country_keep_their_tenth_of_a_millimetre(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    rows = np.zeros(40, [("x", "f8"), ("y", "f8"), ("z", "f8")])
    rows["x"], rows["y"] = 458_000.1234 + np.arange(40), 5_428_000.5678
    (las,), _ = written([cloud_of(rows)], tmp_path, crs="EPSG:25832")
    for axis in "xyz":
        assert np.abs(np.asarray(las[axis]) - rows[axis]).max() <= SCALE / 2 + 1e-9
    assert las.header.parse_crs().to_epsg() == 25832 and las.header.global_encoding.wkt


def test_an_unknown_system_is_refused(done: Path, tmp_path: Path) -> None:
    archive = Archive.open(done / "archives" / "01.mcap")
    with pytest.raises(UsageError, match="--crs EPSG:1: not known"):
        list(to_laz(archive, iter(archive), tmp_path, crs="EPSG:1"))
    assert not list(tmp_path.iterdir())

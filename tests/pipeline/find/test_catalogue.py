"""The catalogue that runs leave, and finding scans in it."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from salpcc.pipeline import Archive
from salpcc.pipeline.cli.app import app
from salpcc.pipeline.find.catalogue import CATALOGUE, catalogue_of, read_catalogue
from salpcc.pipeline.find.find import find
from salpcc.pipeline.run import RunResult
from salpcc.pipeline.verify import verify
from salpcc.schemas.errors import UsageError
from salpcc.schemas.labels import CLASSES
from salpcc.stages.evaluate.report.schema import METRICS
from salpcc.stages.residual_code.archive.reader import ArchiveReader


def command(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    said = result.stderr + (str(result.exception) if isinstance(result.exception, UsageError) else "")
    return result.exit_code, result.stdout, said


@pytest.fixture(scope="module")
def out(toy_root: Path, tmp_path_factory: pytest.TempPathFactory, run: Callable[..., RunResult]) -> Path:
    """Output of two runs with given labels: 00 in two layers, then 01."""
    folder = tmp_path_factory.mktemp("catalogue")
    for sequence in ("00", "01"):
        options = {"labels": "given", "keep_movable": False, "effort": "fast"}
        assert not run(toy_root, folder, sequence, **options).failed
    return folder


def test_every_scan_has_a_row(out: Path, toy_root: Path) -> None:
    catalogue = read_catalogue(out)
    rows = catalogue.to_pylist()
    assert catalogue.schema.remove_metadata() == CATALOGUE
    assert [(r["sequence"], r["name"]) for r in rows] == [
        *(("00", f"{n:06d}") for n in range(5)),
        *(("01", f"{n:06d}") for n in (0, 1, 7)),
    ]
    readers = {s: ArchiveReader(out / "archives" / f"{s}.mcap") for s in ("00", "01")}
    labels = {10: "car", 40: "road", 50: "building", 70: "vegetation", 252: "car"}
    for row in rows:
        reader = readers[row["sequence"]]
        place = next(p for p in reader.payloads(row["gop"]) if p.entry.name == row["name"])
        moving = next(p for p in reader.movable_payloads(row["gop"]) if p.entry.name == row["name"])
        path = toy_root / "sequences" / row["sequence"] / "labels" / f"{row['name']}.label"
        given = [labels[int(n)] for n in np.fromfile(path, "<u4") & 0xFFFF]
        assert row["archive"] == f"archives/{row['sequence']}.mcap" and row["time"] == place.time
        assert row["points"] == len(given) == row["static"] + row["movable"]
        assert {n: row[n] for n in set(labels.values())} == {n: given.count(n) for n in set(labels.values())}
        assert (row["movable"], row["ground"]) == (row["car"], row["road"]) and row["person"] == 0
        assert row["other"] == row["building"] + row["vegetation"]
        assert row["bytes"] == len(place.data) + len(moving.data) and row["bit_exact"]
        assert row["bits"] == pytest.approx(8 * row["bytes"] / row["points"])
        assert row["bits"] == pytest.approx(
            sum(row[f"bits_{n}"] for n in ("geometry", "intensity", "classes", "side"))
        )
        crcs = [int.from_bytes(p.data[-4:], "little") for p in (place, moving)]
        assert row["checksum"] == "-".join(f"{crc:08x}" for crc in crcs)
        assert row["speed"] is None and row["dropped"] == 0 and row["fallback"] is not None


def test_speed_is_that_of_the_motion_over_a_turn() -> None:
    """Frames 0, 1 and 5, 0.1 s apart each: 1.2 m a turn are 12 m/s."""
    rows = [
        {"sequence": "00", "name": f"{n:06d}", "time": n * 10**8, "points_in": 10, "motion": motion}
        for n, motion in ((5, [0.0, 1.2, 0, 0, 0, 0.05]), (0, None), (1, [1.2, 0, 0, 0, 0, -0.01]))
    ]
    found = catalogue_of(pa.Table.from_pylist(rows, METRICS))
    assert found.column("speed").to_pylist() == pytest.approx([12.0, None, 12.0])
    assert found.column("yaw_rate").to_pylist() == pytest.approx([-0.5, None, 0.1])
    alone = catalogue_of(pa.Table.from_pylist(rows[:1], METRICS))
    assert alone.column("speed").to_pylist() == [None]  # nobody knows how long a turn is


def test_poses_of_side_files_are_in_the_catalogue(
    toy: Callable[[Path, str, list[int]], Path], tmp_path: Path, run: Callable[..., RunResult]
) -> None:
    """The camera looks ahead (z), x right, y down; frame 1 is 2 m ahead and 1 m left, turned by 0.1 to the left; 2 has none."""
    root = toy(tmp_path / "root", "03", [0, 1, 2])
    folder = root / "sequences" / "03"
    (folder / "calib.txt").write_text("P0: 0\nTr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n")
    cos, sin = np.cos(0.1), np.sin(0.1)
    turned = f"{cos} 0 {-sin} -1 0 1 0 0 {sin} 0 {cos} 2"
    (folder / "poses.txt").write_text(f"1 0 0 0 0 1 0 0 0 0 1 0\n{turned}\n")
    assert not run(root, tmp_path / "out", "03", effort="fast").failed
    rows = read_catalogue(tmp_path / "out").to_pylist()
    found = [[row[name] for name in ("x", "y", "z", "heading")] for row in rows]
    assert np.allclose(found[:2], [[0, 0, 0, 0], [2, 1, 0, 0.1]], atol=1e-9) and found[2] == [None] * 4
    assert [scan["name"] for scan in find(read_catalogue(tmp_path / "out"), "x > 1").to_pylist()] == [
        "000001"
    ]


def test_what_is_dropped_or_not_asked_for(
    toy_root: Path, tmp_path: Path, run: Callable[..., RunResult]
) -> None:
    given = {"labels": "given", "keep_movable": False, "drop_movable": True, "effort": "fast"}
    run(toy_root, tmp_path / "dropped", "01", **given)
    for row in read_catalogue(tmp_path / "dropped").to_pylist():
        assert row["dropped"] == row["movable"] == row["car"] > 0
    run(toy_root, tmp_path / "kept", "01", effort="fast")
    for row in read_catalogue(tmp_path / "kept").to_pylist():
        assert row["dropped"] == 0 and row["movable"] is row["car"] is row["static"] is None
    assert read_catalogue(tmp_path / "kept").num_rows == 3
    code, _, said = command("find", tmp_path / "kept", "person > 5 or points < 3")
    assert code == 0 and "0 of 3 scans" in said
    assert "note: person: not known of any scan; runs count classes that labels give" in said
    assert "points" not in said and "not known" not in command("find", tmp_path / "dropped", "car > 5")[2]


def made_up(n: int) -> pa.Table:
    rng = np.random.default_rng(0)
    counts = rng.integers(0, 200, (n, len(CLASSES)))
    return catalogue_of(
        pa.Table.from_pylist(
            [
                {
                    "sequence": f"{i % 11:02d}",
                    "name": f"{i // 11:06d}",
                    "time": i // 11 * 10**8,
                    "points_in": int(counts[i].sum()),
                    "class_counts": counts[i],
                    "motion": [float(i % 7) / 10, 0, 0, 0, 0, 0],
                    **{f"bytes_{name}": 100 for name in ("geometry", "intensity", "classes", "side")},
                }
                for i in range(n)
            ],
            METRICS,
        )
    )


def test_lasers_that_are_sick_are_found(out: Path) -> None:
    """Each laser of a run has a row's worth of returns; then one that is silent, and one that costs more than those beside it."""
    lasers = [(row["laser_returns"], row["laser_bits"]) for row in read_catalogue(out).to_pylist()]
    for row, (returns, bits) in zip(read_catalogue(out).to_pylist(), lasers, strict=True):
        assert len(returns) == len(bits) == 64 and row["points"] - row["fallback"] == sum(returns)
        assert all(
            (bit is None) == (n == 0) and (bit is None or 0 < bit < 20)
            for n, bit in zip(returns, bits, strict=True)
        )
        assert row["silent_lasers"] == returns.count(0)
    made = [
        {
            "sequence": "00",
            "name": name,
            "time": 0,
            "points_in": 9,
            "laser_returns": [2, 2, 0, 2, 2],
            "laser_bits": sums,
        }
        for name, sums in (("well", [4, 5, 0, 6, 6]), ("noisy", [4, 5, 0, 6, 22]))
    ]
    catalogue = catalogue_of(
        pa.Table.from_pylist([*made, {"sequence": "00", "name": "grid", "time": 0, "points_in": 9}], METRICS)
    )
    assert catalogue.column("laser_bits").to_pylist() == [[2, 2.5, None, 3, 3], [2, 2.5, None, 3, 11], None]
    assert catalogue.column("laser_excess").to_pylist() == [0.5, 8, None]
    assert find(catalogue, "silent_lasers > 0 and laser_excess > 3").column("name").to_pylist() == ["noisy"]
    assert find(catalogue, "json_extract(laser_bits, '$[4]') > 3").column("name").to_pylist() == ["noisy"]


def test_conditions_are_sql() -> None:
    catalogue = made_up(200)
    rows = catalogue.to_pylist()
    for condition, test in (
        ("person > 50 and speed < 1.5", lambda r: r["person"] > 50 and r["speed"] < 1.5),
        ("PERSON>50 AND NOT Speed<1.5 -- ours", lambda r: r["person"] > 50 and not r["speed"] < 1.5),
        ("car + truck between 100 and 200", lambda r: 100 <= r["car"] + r["truck"] <= 200),
        ("name = '000003' or sequence in ('01', '02')", lambda r: r["name"] == "000003" or r["sequence"] in ("01", "02")),
        ("bit_exact", lambda r: False),  # null: not known
        ("bits > (select avg(bits) from catalogue)", lambda r: r["bits"] > np.mean([q["bits"] for q in rows])),
    ):  # fmt: skip
        assert find(catalogue, condition).to_pylist() == [r for r in rows if test(r)], condition
    assert find(catalogue.slice(0, 0), "person > 50").num_rows == 0


def test_times_over_two_to_the_63_are_found() -> None:
    catalogue = made_up(3)
    late = pa.array([2**63 - 1, 2**63, 2**64 - 1], pa.uint64())
    catalogue = catalogue.set_column(catalogue.column_names.index("time"), "time", late)
    assert find(catalogue, "time > 9e18 and time < 1e19").column("time").to_pylist() == [2**63 - 1, 2**63]


@pytest.mark.parametrize(
    "condition",
    [
        "persn > 50",
        "person >",
        "",
        "name",
        "1) from catalogue; drop table catalogue; --",
        "1) from (select 1) --",
        "1) union all select (2",
        "load_extension('/tmp/evil.so')",
        "(select count(*) from sqlite_master, pragma_database_list)",
        "exists(with recursive r(n) as (select 1 union all select n + 1 from r) select max(n) from r)",
        "length(zeroblob(2000000000)) > 1",
        "__import__('os').system('true')",
    ],
)
def test_what_is_no_condition_is_refused(condition: str) -> None:
    with pytest.raises(UsageError, match="condition"):
        find(made_up(20), condition)


def test_find_on_the_command_line(out: Path, tmp_path: Path) -> None:
    code, printed, said = command("find", out, "sequence = '00' and time >= 300000000 and car > 0")
    lines = printed.splitlines()
    assert code == 0 and lines[0].split() == ["sequence", "name", "time", "points", "speed", "car"]
    assert [line.split()[:3] for line in lines[1:]] == [
        ["00", "000003", "0.300000000"],
        ["00", "000004", "0.400000000"],
    ]
    code, printed, _ = command("find", out / "catalogue.parquet", "points > 1", "--json")
    assert code == 0 and len(json.loads(printed)) == 8 and json.loads(printed)[0]["static"] > 0
    code, _, said = command("find", tmp_path, "points > 1")
    assert code == 1 and "catalogue.parquet: not there" in said
    code, printed, said = command("find", out, "points < 0", "--export", tmp_path / "none")
    assert code == 0 and not (tmp_path / "none").exists()


def test_what_is_found_becomes_archives(out: Path, toy_root: Path, tmp_path: Path) -> None:
    """From the middle of groups, of two sequences; every point is that of its source."""
    condition = "name in ('000001', '000002', '000003') or name = '000007'"
    assert command("find", out, condition, "--export", tmp_path / "some")[0] == 0
    names = {}
    for sequence in ("00", "01"):
        path = tmp_path / "some" / f"{sequence}.mcap"
        with Archive.open(path) as archive:
            names[sequence] = archive.names
            assert archive.movable == "layered"
        verdict = verify(path, toy_root)
        assert verdict.good and verdict.bit_exact_scans == len(names[sequence])
    assert names == {"00": ["000001", "000002", "000003"], "01": ["000001", "000007"]}
    one = tmp_path / "one.mcap"
    assert command("find", out, "name = '000007' or sequence = '00'", "--export", one)[0] == 0
    with Archive.open(one) as archive:
        assert (archive.sequence, archive.names[-2:]) == ("one", ["000004", "000007"])
    code, _, said = command("find", out, "name = '000001'", "--export", tmp_path / "two.mcap")
    assert code == 1 and f"000001 is in {out / 'archives'}" in said.replace("\n", "") and "folder" in said
    code, _, said = command("find", out, "name = '000001'", "--export", one)
    assert code == 1 and "exists" in said

"""What is said after a run, for every kind of run."""

from io import StringIO
from typing import Any

from rich.console import Console

from salpcc.pipeline.cli.described import show_archive
from salpcc.pipeline.cli.summary import summary


def figures(**changed: Any) -> dict[str, Any]:
    base = {
        "frames": 10, "points_in": 1_000_000, "points_dropped_movable": 0, "points_lost": 0, "bytes": {"total": 1_250_000},
        "bytes_source": 16_000_000,
        "max_error_m": 0.0, "bit_exact_scans": 10, "encode_ms_per_scan": 210.6, "decode_ms_per_scan": 219.1,
    }  # fmt: skip
    return base | changed


def test_exact_and_all_kept() -> None:
    assert list(summary([figures(), figures()], 8.0)) == [
        "12.8 : 1, 32.0 MB to 2.5 MB, 10.00 bits a point",
        "every bit of every point that is kept came back",
        "2,000,000 points, all kept",
        "20 scans in 8.0 s, 2.5 a second, with all that is around the codec",
        "the codec on one core: 211 ms to code a scan, 219 ms to decode it",
    ]


def test_an_error_and_what_was_dropped_and_lost() -> None:
    one = figures(max_error_m=0.00978, bit_exact_scans=0, points_dropped_movable=50_000, points_lost=200_000)
    _, error, kept, *_ = summary([one, figures()], 1.0)
    assert error == "no point came back farther than 9.78 mm from its source"
    assert kept == (
        "1,750,000 points kept, 50,000 that can move dropped (2.5 %), 200,000 lost in the grid (10.0 %)"
    )


def test_what_was_not_measured_is_not_told() -> None:
    lines = list(summary([figures(max_error_m=None, bit_exact_scans=9, encode_ms_per_scan=None)], 1.0))
    assert len(lines) == 3 and "codec on one core" not in lines[-1]
    assert list(summary([figures(points_in=0)], 1.0)) == ["10 scans without a point, 1.2 MB"]


def test_many_groups_are_cut_short() -> None:
    counts = {"n_points": 10, "kept": 10, "dropped_movable": 0, "strays": 0}
    streams = {"geometry": 7, "intensity": 5, "classes": 0, "side": 0}
    rows = [{"gop": n, "name": f"{n:06d}", **counts, **streams} for n in range(200)]
    found = {
        "path": "x.mcap", "sequence": "x", "source": "bag", "config": {}, "sensor": "s", "lasers": 16, "scans": 200,
        "seconds": 19.9, "topics": [], "bytes": 3000, "bytes_container": 600, "bytes_passing": 0, "bytes_labels": 0, "side_files": {},
        "movable": "one layer", "layers": None,
        "totals": {name: 200 * count for name, count in {**counts, **streams}.items()}, "rows": rows,
    }  # fmt: skip
    console = Console(width=80, record=True, file=StringIO())
    show_archive(found, console, scans=False)
    shown = console.export_text()
    assert "180 more groups" in shown and "000009" in shown and "000010" not in shown and "000190" in shown
    show_archive(found, console, scans=True)
    assert "000100" in console.export_text()

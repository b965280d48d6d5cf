"""The command line as users meet it: output, exit codes, one-line errors."""

import json
import re
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from salpcc.pipeline.cli.app import app
from salpcc.pipeline.cli.archives import _compared
from salpcc.pipeline.export import EXPORTS

Cli = Callable[..., "subprocess.CompletedProcess[str]"]


def error_of(result: "subprocess.CompletedProcess[str]") -> str:
    """The one line on stderr that starts with "error:"; there must be exactly one, and no traceback."""
    assert "Traceback" not in result.stderr
    lines = [line for line in result.stderr.splitlines() if line.startswith("error:")]
    assert len(lines) == 1, result.stderr
    return lines[0]


def test_run_prints_the_report_as_json_and_nothing_else(cli: Cli, toy_root: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = cli("run", "sequences", "00,01", "--root", toy_root, "--out", out, "--keep-movable", "--json",
                 "--workers", 0, "--gop", 2)  # fmt: skip
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout)
    assert report == json.loads((out / "report" / "report.json").read_text())
    assert [report["sequences"][name]["bit_exact_scans"] for name in ("00", "01")] == [5, 3]
    assert report["errors"] == []
    assert "dashboard http" in result.stderr


def test_run_says_what_it_came_to(cli: Cli, toy_root: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = cli("run", "sequences", "01", "--root", toy_root, "--out", out, "--keep-movable", "--workers", 0,
                 "--effort", "fast")  # fmt: skip
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    assert all(len(line) <= 80 for line in lines if str(out) not in line)
    ratio, exact, kept, layers, beside, speed, codec = lines[-9:-2]
    assert re.fullmatch(r"beside the points: labels of 3 scans, [\d.]+ kB; 1 side files, \d+ bytes", beside)
    assert layers == "kept: everything in one layer"
    assert re.fullmatch(r"\d+\.\d : 1, [\d.]+ kB to [\d.]+ kB, [\d.]+ bits a point", ratio)
    assert exact == "every bit of every point that is kept came back" and "points, all kept" in kept
    assert re.match(r"3 scans in [\d.]+ s, [\d.e-]+ a second", speed)
    assert re.fullmatch(r"the codec on one core: \d+ ms to code a scan, \d+ ms to decode it", codec)
    assert str(out / "archives") in lines[-2] and str(out / "report" / "index.html") in lines[-1]
    assert "6 of 6 scans coded or measured" in result.stderr


@pytest.mark.parametrize(
    ("golden", "words"),
    [
        ("fast_exact.mcap", ["bit-exact", "effort fast", "hdl64e, 64 lasers"]),
        ("default_10mm.mcap", ["no point farther than 10 mm"]),
        ("log/log.mcap", ["3 topics", "/organised, /texts, /wide", "other topics"]),
        ("nets/paper_ppmd_dropped.mcap", ["ranges in steps of 5 mm", "99 that can move dropped"]),
    ],
)
def test_inspect_fits_a_terminal(cli: Cli, golden: str, words: list[str]) -> None:
    path = Path(__file__).parents[2] / "golden" / golden
    for options in ([], ["--scans"]):
        result = cli("inspect", path, *options)
        assert result.returncode == 0, result.stderr
        shown = result.stdout
        assert all(len(line) <= 80 for line in shown.splitlines() if str(path.parent) not in line)
        assert all(word in " ".join(shown.split()) for word in words)
        assert "where the bits are" in shown and not set("{}[]") & set(shown)
        # How wide the points of a log were, its index does not say.
        assert "bits a point" in shown and (" : 1, " in shown) != golden.startswith("log/")
        groups = "each decodes alone" in shown
        assert groups != bool(options)


def test_run_decode_verify_give_the_files_back(cli: Cli, done: Path, toy_root: Path, tmp_path: Path) -> None:
    archive = done / "archives" / "01.mcap"
    result = cli("decode", archive, "--to", "kitti", "--out", tmp_path)
    assert result.returncode == 0, result.stderr
    there = toy_root / "sequences" / "01" / "velodyne"
    back = tmp_path / "sequences" / "01" / "velodyne"
    assert {p.name: p.read_bytes() for p in back.iterdir()} == {
        p.name: p.read_bytes() for p in there.iterdir()
    }
    result = cli("verify", archive, "--against", toy_root, "--json")
    verdict = json.loads(result.stdout)
    assert result.returncode == 0
    assert (verdict["good"], verdict["bit_exact_scans"], verdict["max_error_m"]) == (True, 3, 0.0)


def test_decode_tells_the_unit_of_intensity(cli: Cli, done: Path, tmp_path: Path) -> None:
    archive = done / "archives" / "01.mcap"
    result = cli("decode", archive, "--to", "laz", "--crs", "EPSG:25832", "--out", tmp_path)
    assert result.returncode == 0, result.stderr
    assert "float32 as recorded times 65535" in result.stderr and "3 files" in result.stdout
    for options, said in ((["--to", "laz", "--crs", "EPSG:1"], "not known to PROJ"),
                          (["--to", "ply", "--crs", "EPSG:25832"], "no place for it")):  # fmt: skip
        result = cli("decode", archive, *options, "--out", tmp_path)
        assert result.returncode == 2 and said in error_of(result)


def test_decode_takes_frame_numbers(cli: Cli, done: Path, tmp_path: Path) -> None:
    archive = done / "archives" / "01.mcap"  # frames 0, 1, 7
    assert cli("decode", archive, "--to", "kitti", "--out", tmp_path, "--frames", "1:8").returncode == 0
    assert sorted(p.stem for p in tmp_path.rglob("*.bin")) == ["000001", "000007"]
    result = cli("decode", archive, "--to", "kitti", "--out", tmp_path, "--frames", "2:7")
    assert result.returncode == 2 and "no scan" in error_of(result)


def test_errors_say_what_was_written(cli: Cli, tmp_path: Path) -> None:
    """No colon of it is an emoji, and options are named as they are."""
    run = "run", "sequences", "00", "--source", "simulated", "--out", tmp_path
    assert error_of(cli(*run, "--frames", "a:b")).startswith("error: --frames a:b: expected A:B")
    assert error_of(cli("verify", tmp_path / ":b:.mcap")).startswith(f"error: {tmp_path}/:b:.mcap")
    both = cli(*run, "--keep-movable", "--drop-movable")
    assert both.returncode == 2
    assert error_of(both) == "error: --keep-movable and --drop-movable ask for opposite things; choose one"
    none = cli(*run, "--keep-movable", "--max-error", "static=0.01,movable=0.02")
    assert error_of(none) == "error: --max-error movable=METRES is of a movable layer, and there is none"


def test_damaged_archive_fails_verification(cli: Cli, done: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.mcap"
    data = bytearray((done / "archives" / "00.mcap").read_bytes())
    data[len(data) // 2] ^= 4
    bad.write_bytes(data)
    result = cli("verify", bad)
    assert result.returncode == 1 and "PROBLEM" in result.stdout and "Traceback" not in result.stderr


def test_failed_scan_is_exit_code_1_and_the_others_are_done(cli: Cli, toy_root: Path, tmp_path: Path) -> None:
    shutil.copytree(toy_root / "sequences" / "01", tmp_path / "root" / "sequences" / "01")
    (tmp_path / "root/sequences/01/velodyne/000001.bin").write_bytes(bytes(33))
    result = cli(
        "run", "sequences", "01", "--root", tmp_path / "root", "--out", tmp_path / "out", "--workers", 0
    )
    assert result.returncode == 1
    assert "000001.bin: truncated" in result.stderr and "01" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["run", "sequences", "04", "--root", "nowhere"],
            ["nowhere not found", "cvlibs", "--source simulated"],
        ),
        (["run", "sequences", "04"], ["--root is missing", "--source simulated"]),
        (["run", "sequences", "4-2", "--root", "."], ["descends"]),
        (["run", "sequences", "04", "--source", "tape"], ["--source tape", "semantickitti"]),
        (["run", "sequences", "04", "--root", ".", "--max-error", "0"], ["--max-error"]),
        (["run", "sequences", "04", "--root", ".", "--frames", "5"], ["--frames 5", "A:B"]),
        (["run", "sequences", "04", "--root", ".", "--from", "cook"], ["--from cook", "ingest"]),
        (
            ["run", "sequences", "04", "--root", ".", "--from", "predict", "--to", "ingest"],
            ["other way round"],
        ),
        (["run", "sequences", "04", "--root", ".", "--baselines", "magic"], ["magic", "xz"]),
        (["run", "sequences", "04", "--root", ".", "--tmc3", "nowhere/tmc3"], ["--tmc3", "no program"]),
        (["run", "sequences", "04", "--root", ".", "--manifest", "no.yaml"], ["no.yaml"]),
        (["run", "log", "x.bag", "--topic", "/points"], ["x.bag: not found"]),
        (["map", "a.mcap", "--out", "m", "--voxel", "0"], ["--voxel"]),
        (["map", "a.mcap", "--out", "m", "--formats", "laz,obj"], ["--formats obj", "laz"]),
        (["map", "a.mcap", "--out", "m", "--within", "1,2,x"], ["--within 1,2,x", "six numbers"]),
        (["map", "a.mcap", "--out", "m", "--within", "0,0,0,-1,1,1"], ["--within", "the lower ones"]),
        (["map", "edit", "m", "--restore", "1,2"], ["--restore 1,2", "number of an object", "six numbers"]),
        (["map", "edit", "m", "--restore", "-1,0,0,1,1,1"], ["m: not the folder of a map"]),
        (["map", "diff", "m", "n", "--out", "d"], ["m: not the folder of a map"]),
        (["train", "coder", "--data", "nowhere"], ["nowhere: not found"]),
        (["train", "coder", "--data", ".", "--effort", "fast"], ["no scans to train on", "--data"]),
        (["report", "nowhere"], ["no report there"]),
        (["calibrate", "nowhere", "--out", "s.json"], ["nowhere"]),
        (["calibrate", "drive.mcap", "--out", "drive.mcap"], ["a sensor model is a file NAME.json"]),
        (["run", "sequences", "04", "--root", ".", "--columns", "6"], ["--columns"]),
        (["simulate", "--out", "file/sub", "--scans", "1"], ["file", "name another place"]),
        (
            ["run", "sequences", "04", "--source", "simulated", "--out", "file/sub"],
            ["file/sub", "cannot write"],
        ),
    ],
)
def test_wrong_use_is_one_line_and_exit_code_2(
    cli: Cli, arguments: list[str], words: list[str], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("no folder")
    result = cli(*arguments, cwd=tmp_path)
    line = error_of(result)
    assert result.returncode == 2 and all(word in line for word in words), line


def test_outputs_that_cannot_be_written_are_named(
    cli: Cli, done: Path, toy_root: Path, tmp_path: Path
) -> None:
    file, archive = tmp_path / "file", done / "archives" / "00.mcap"
    file.write_text("no folder")
    for form in EXPORTS:
        if form != "bag":  # there was no ROS 1 log
            result = cli("decode", archive, "--to", form, "--out", file)
            assert result.returncode == 2 and str(file) in error_of(result), form
    result = cli("calibrate", toy_root / "sequences" / "00", "--out", file / "s.json")
    assert result.returncode == 2 and str(file) in error_of(result)
    assert file.read_text() == "no folder"


def test_frames_that_are_there_are_told(cli: Cli, done: Path, toy_root: Path, tmp_path: Path) -> None:
    result = cli("run", "sequences", "00", "--root", toy_root, "--frames", "7:9", "--out", tmp_path / "out")
    assert result.returncode == 2 and "frames 0 to 4 are there" in error_of(result)
    result = cli("decode", done / "archives" / "00.mcap", "--to", "ply", "--frames", "7:9", "--out", tmp_path)
    assert result.returncode == 2 and "it holds 000000 to 000004" in error_of(result)


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (["--weights", "tiny", "--keep-movable"], ["segment_tiny", "small"]),  # not used, but wrong
        (["--sensor", "odd.json"], ["odd.json", "not a sensor model"]),
        (["--sensor", "no.json"], ["no.json", "hdl64e"]),
    ],
)
def test_files_that_an_option_names_are_named(
    cli: Cli, toy_root: Path, tmp_path: Path, option: list[str], said: list[str]
) -> None:
    (tmp_path / "odd.json").write_text('{"version": 1}')
    result = cli("run", "sequences", "00", "--root", toy_root, *option, cwd=tmp_path)
    assert result.returncode == 1 and all(word in error_of(result) for word in said), result.stderr
    assert not (tmp_path / "out").exists()


def test_too_little_memory_is_one_line(cli: Cli, done: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def limit() -> None:  # at 390 MB some library fails, at 480 one looks for memory for ever
        resource.setrlimit(resource.RLIMIT_AS, (480 << 20, 480 << 20))

    command = [sys.executable, "-m", "salpcc.pipeline.cli", "verify", str(done / "archives" / "00.mcap")]
    result = subprocess.run(
        command, preexec_fn=limit, capture_output=True, text=True, timeout=60, check=False
    )
    assert result.returncode == 1 and "480 MB" in error_of(result) and "ulimit -v" in error_of(result)

    def ends(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("salpcc.pipeline.verify.verify", ends)
    result = cli("verify", done / "archives" / "00.mcap")
    assert result.returncode == 1 and "out of memory" in error_of(result)


def test_wrong_options_are_told_before_a_sensor_is_sought(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def seek(*_: object) -> None:
        raise AssertionError("sought")

    monkeypatch.setattr("salpcc.pipeline.sensors.choose_sensor.choose_sensor", seek)
    (tmp_path / "drive.mcap").write_bytes(b"")
    for option in (["--max-error", "-1"], ["--gop", "0"], ["--frames", "5"]):
        result = cli("run", "log", tmp_path / "drive.mcap", *option)
        assert result.returncode == 2 and option[0] in error_of(result)


@pytest.mark.parametrize(("options", "network"), [([], True), (["--keep-movable"], False)])
def test_workers_load_while_a_log_is_looked_at(
    options: list[str], network: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = []
    monkeypatch.setattr(
        "salpcc.pipeline.cli.run_log.start_fork_server",
        lambda *which, network: begun.append((*which, network)),
    )
    CliRunner().invoke(app, ["run", "log", "nowhere.mcap", "--workers", "3", *options])
    assert begun == [(3, None, network)]


@pytest.mark.parametrize("content", [b"", b"not mcap at all" * 10])
def test_what_is_no_archive_is_one_line_and_exit_code_1(cli: Cli, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    result = cli("inspect", tmp_path / "x.mcap")
    assert result.returncode == 1 and "x.mcap" in error_of(result)


def test_what_is_damaged_can_be_recovered_and_that_is_said(cli: Cli, tmp_path: Path) -> None:
    whole = (Path(__file__).parents[2] / "golden" / "fast_exact.mcap").read_bytes()
    (tmp_path / "x.mcap").write_bytes(whole[:-20])
    result = cli("inspect", tmp_path / "x.mcap")
    assert result.returncode == 1 and "`salpcc-pipeline recover` saves what is whole" in error_of(result)


def test_names_are_shown_as_they_are(cli: Cli, toy_root: Path, tmp_path: Path) -> None:
    """Whatever is in brackets, which is markup elsewhere."""
    odd = tmp_path / "a [" / "b] [dim].mcap"
    odd.parent.mkdir()
    shutil.copy(Path(__file__).parents[2] / "golden" / "fast_exact.mcap", odd)
    assert "b] [dim].mcap" in cli("inspect", "b] [dim].mcap", cwd=odd.parent).stdout
    out = tmp_path / "[" / "b]"
    result = cli(
        "run",
        "sequences",
        "01",
        "--root",
        toy_root,
        "--keep-movable",
        "--to",
        "ingest",
        "--workers",
        0,
        "--out",
        out,
    )
    assert result.returncode == 0 and f"shards are in {out}" in result.stderr


@pytest.mark.parametrize(
    "command",
    [
        ["run"],
        ["run", "sequences"],
        ["decode"],
        ["verify"],
        ["inspect"],
        ["calibrate"],
        ["simulate"],
        ["map"],
        ["map", "edit"],
        ["map", "diff"],
        ["localise"],
        ["report"],
        ["train", "coder"],
    ],
)
def test_every_command_has_help_and_an_example(cli: Cli, command: list[str]) -> None:
    result = cli(*command, "--help")
    assert result.returncode == 0
    assert command == ["run"] or f"salpcc-pipeline {' '.join(command)}" in " ".join(result.stdout.split())


def test_inspect_shows_archives_and_shards(cli: Cli, done: Path) -> None:
    archive = json.loads(cli("inspect", done / "archives" / "00.mcap", "--json").stdout)
    assert archive["scans"] == 5 and archive["totals"]["strays"] == 0
    assert archive["totals"]["n_points"] == archive["totals"]["kept"] > 10000
    shard = next((done / "shards").rglob("*.arrow"))
    assert json.loads(cli("inspect", shard, "--json").stdout)["facts"]["stage"] == "evaluate"


def test_calibrate_recovers_the_model(cli: Cli, toy_root: Path, tmp_path: Path) -> None:
    result = cli("calibrate", toy_root, "--out", tmp_path / "mine.json")
    assert result.returncode == 0, result.stderr
    assert json.loads((tmp_path / "mine.json").read_text())["name"] == "mine"
    assert "64 lasers" in result.stdout and "from 8 scans (0 left out)" in result.stdout
    assert "range step: 2 mm" in result.stdout and "of the points back to the millimetre" in result.stdout


def test_calibrate_says_what_is_no_sensor(cli: Cli, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for name, rows in (("blob", rng.normal(0, 20, (5000, 4))), ("few", rng.normal(0, 20, (50, 4)))):
        rows.astype("<f4").tofile(tmp_path / f"{name}.bin")
        result = cli("calibrate", tmp_path / f"{name}.bin", "--out", tmp_path / "s.json")
        assert result.returncode == 1 and f"{name}.bin" in error_of(result)
    assert not (tmp_path / "s.json").exists()


@pytest.mark.parametrize("kind", ["text", "link"])
def test_calibrate_takes_the_place_of_sensor_models_only(
    cli: Cli, toy_root: Path, tmp_path: Path, kind: str
) -> None:
    out = tmp_path / "package.json"
    if kind == "link":
        out.symlink_to(tmp_path / "not" / "mounted.json")
    else:
        out.write_text('{"name": "mine"}')
    result = cli("calibrate", toy_root / "sequences" / "00", "--out", out)
    assert result.returncode == 2 and "is no sensor model; name another --out" in error_of(result)
    assert out.is_symlink() if kind == "link" else out.read_text() == '{"name": "mine"}'


def test_report_is_rebuilt(cli: Cli, done: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(done, out)
    (out / "report" / "report.json").unlink()
    assert cli("report", out).returncode == 0
    rebuilt = json.loads((out / "report" / "report.json").read_text())
    assert rebuilt["sequences"] == json.loads((done / "report" / "report.json").read_text())["sequences"]


def test_verify_says_what_it_compared(cli: Cli) -> None:
    result = cli("verify", Path(__file__).parents[2] / "golden" / "fast_exact.mcap")
    assert result.returncode == 0
    assert "; every checksum holds (--against compares with the source)" in result.stdout
    told = {"against": "ROOT", "bit_exact_scans": 1200, "points_dropped": 34_567, "scans_elsewhere": []}
    assert _compared(told | {"max_error_m": 0.0197, "passed_messages": 1234}) == (
        "against ROOT: 1,200 scans bit-exact, 34,567 points dropped, largest error 19.70 mm, "
        "1,234 messages of other topics unchanged"
    )
    exact = _compared(told | {"max_error_m": 0.0, "passed_messages": None})
    assert exact.endswith("points dropped")
    less = told | {"max_error_m": 0.0, "passed_messages": None, "scans_elsewhere": ["000007", "000009"]}
    assert _compared(less).endswith("; not in the archive: 2 of its scans, 000007 to 000009")


def test_help_begins_with_the_main_job(cli: Cli) -> None:
    names = re.findall(r"^│ (\w+) ", cli("--help").stdout.partition("Commands")[2], re.MULTILINE)
    assert names[0] == "run" and len(names) > 15

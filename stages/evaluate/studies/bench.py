"""Race our codec against Draco and LASzip on the same scans: ``python -m salpcc.stages.evaluate.studies.bench``.

Codecs take turns (A B A B …), so that a machine that slows down slows all of them, and CPU time is counted. Freed memory
stays with the process, as in a run's workers; all codecs have that.
Ours codes a group of consecutive scans, as a run does; the others know single scans only. A first round
warms everything up and is thrown away. ``--profile-stages`` shows where the time of ours goes, file by file.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np

from salpcc.schemas.config import Effort
from salpcc.schemas.errors import SalpccError
from salpcc.schemas.scan import Scan
from salpcc.stages.evaluate.baselines import BASELINES
from salpcc.stages.evaluate.baselines.baseline import FLOAT32_SLACK, Baseline
from salpcc.stages.evaluate.baselines.ours import Coded, decode_group, encode_group, encode_static_layer
from salpcc.stages.evaluate.measures.metrics import point_errors, same_bits
from salpcc.stages.evaluate.report.machine import describe_machine
from salpcc.stages.evaluate.studies.profile import profile
from salpcc.stages.ingest.sources import SOURCES
from salpcc.stages.ingest.sources.simulated import Simulated
from salpcc.stages.memory import keep_memory

RIVALS = ("draco", "draco_sequential", "laszip")
REFERENCE = "draco"


@dataclass
class Runner:
    """One codec at one asked error, and what its rounds gave."""

    name: str
    max_error: float
    encode: Callable[[], list[Coded]]
    decode: Callable[[list[bytes]], list[Scan]]
    bound: float  # 3-D, metres; what it promises
    keeps_order: bool = True
    coded: list[Coded] = field(default_factory=list)
    encode_ms: list[float] = field(default_factory=list)
    decode_ms: list[float] = field(default_factory=list)
    worst: float = 0.0
    exact: bool = False


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the race and print its table; exit code 1 where a codec breaks its promise."""
    parser = argparse.ArgumentParser(prog="bench", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--root", type=Path, help="SemanticKITTI root; without it two scans are simulated")
    parser.add_argument("--sequence", default="00")
    parser.add_argument("--scans", type=int, default=2, help="consecutive scans to code")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--errors", default="0,0.001,0.01", help="asked errors in metres; 0 is bit-exact")
    parser.add_argument("--efforts", default="fast,default", help="ours, of " + ", ".join(get_args(Effort)))
    parser.add_argument("--threads", type=int, default=1, help="decode groups on so many at once, beside one")
    parser.add_argument("--profile-stages", action="store_true", help="show which files the time goes to")
    parser.add_argument("--json", type=Path, help="write the figures there, too")
    asked = parser.parse_args(arguments)
    keep_memory()
    errors = [float(value) for value in asked.errors.split(",")]
    try:
        scans = _scans(asked.root, asked.sequence, asked.scans)
        failed = False
        rows: list[dict[str, Any]] = []
        efforts = [effort for effort in get_args(Effort) if effort in asked.efforts.split(",")]
        for error in errors:
            runners = list(_runners(scans, error, efforts))
            race(runners, scans, asked.rounds)
            print(table(runners, scans), end="\n\n", flush=True)
            rows += [_row(runner, scans) for runner in runners]
            failed |= any(runner.keeps_order and runner.worst > runner.bound for runner in runners)
        for effort in efforts:
            if asked.threads > 1:
                gain = threads_gain(encode_group(scans, errors[0], effort), asked.threads, asked.rounds)
                print(
                    f"salpcc {effort}: groups decode {gain:.2f} times as fast on {asked.threads} threads as on one"
                )
            if asked.profile_stages:
                print(_profile(scans, errors[0], effort))
    except SalpccError as error_:
        print(f"bench: {error_}", file=sys.stderr)
        return 1
    if asked.json is not None:
        asked.json.write_text(json.dumps(_document(arguments, scans, asked.rounds, rows), indent=1) + "\n")
    return int(failed)


def threads_gain(group: Sequence[Coded], threads: int, rounds: int) -> float:
    """How many times as fast groups are decoded on several threads as on one, wall time, median of rounds in turns."""
    data = [coded.data for coded in group]

    def seconds(at_once: int) -> float:
        start = time.perf_counter()
        with ThreadPoolExecutor(at_once) as pool:
            for _ in pool.map(lambda _: list(decode_group(data)), range(2 * threads)):
                pass
        return time.perf_counter() - start

    seconds(threads)
    return float(np.median([seconds(1) / seconds(threads) for _ in range(rounds)]))


def _profile(scans: Sequence[Scan], error: float, effort: Effort) -> str:
    """CPU ms a scan by file, encoder and decoder, of what takes more than a hundredth of either."""
    data = [coded.data for coded in encode_group(scans, error, effort)]
    parts = profile(lambda: encode_group(scans, error, effort)), profile(lambda: list(decode_group(data)))
    ms = [{name: 1e3 * s / len(scans) for name, s in part.items()} for part in parts]
    whole = [sum(part.values()) for part in ms]
    large = {name for part, of in zip(ms, whole, strict=True) for name, s in part.items() if s > of / 100}
    rows = [(name, *(part.get(name, 0.0) for part in ms)) for name in sorted(large)]
    rows.append(
        ("others", *(of - sum(part.get(n, 0.0) for n in large) for part, of in zip(ms, whole, strict=True)))
    )
    rows.append(("all", *whole))
    lines = [f"{'CPU ms a scan, salpcc ' + effort:62}{'encode':>9}{'decode':>9}"]
    return "\n".join(lines + [f"  {name:60}{encode:9.2f}{decode:9.2f}" for name, encode, decode in rows])


def race(runners: Sequence[Runner], scans: Sequence[Scan], rounds: int) -> None:
    """Let the runners take turns; the first round only warms up and checks what comes back."""
    for number in range(rounds + 1):
        for runner in runners:
            start = time.process_time()
            coded = runner.encode()
            middle = time.process_time()
            decoded = runner.decode([c.data for c in coded])
            end = time.process_time()
            if number == 0:
                runner.coded = coded
                runner.exact = all(_same(a, b) for a, b in zip(scans, decoded, strict=True))
                if runner.keeps_order:
                    pairs = zip(scans, decoded, strict=True)
                    runner.worst = max(point_errors(a.points, b.points).maximum for a, b in pairs)
            else:
                runner.encode_ms.append(1e3 * (middle - start) / len(scans))
                runner.decode_ms.append(1e3 * (end - middle) / len(scans))


def table(runners: Sequence[Runner], scans: Sequence[Scan]) -> str:
    """Lay out the results of one asked error, ratios against Draco where it ran."""
    points = sum(len(scan) for scan in scans)
    error = runners[0].max_error
    title = f"error {1e3 * error:g} mm" if error else "bit-exact"
    head = (
        f"{'codec':20}{'geometry':>10}{'total bpp':>11}{'max error mm':>14}{'encode ms':>11}{'decode ms':>11}"
    )
    lines = [f"{title}, {len(scans)} scans, {points:,} points", head]
    reference = next((_figures(r, points) for r in runners if r.name == REFERENCE), None)
    if reference is not None:
        lines[1] += f"{'size':>7}{'encode':>8}{'decode':>8}  (of {REFERENCE})"
    for runner in runners:
        geometry, total, encode, decode = _figures(runner, points)
        worst = (
            "bit-exact" if runner.exact else f"{1e3 * runner.worst:.3f}" if runner.keeps_order else "no order"
        )
        line = f"{runner.name:20}{geometry:10.2f}{total:11.2f}{worst:>14}{encode:11.1f}{decode:11.1f}"
        if reference is not None:
            line += f"{geometry / reference[0]:7.2f}{encode / reference[2]:8.2f}{decode / reference[3]:8.2f}"
        lines.append(line)
    return "\n".join(lines)


def _row(runner: Runner, scans: Sequence[Scan]) -> dict[str, Any]:
    """The figures of one runner for ``--json``; the error is None where the order is gone."""
    geometry, total, encode, decode = _figures(runner, sum(len(scan) for scan in scans))
    return {
        "codec": runner.name,
        "max_error": runner.max_error,
        "bpp_geometry": geometry,
        "bpp_total": total,
        "max_error_m": runner.worst if runner.keeps_order else None,
        "bit_exact": runner.exact,
        "encode_ms": encode,
        "decode_ms": decode,
    }


def _document(
    arguments: Sequence[str] | None, scans: Sequence[Scan], rounds: int, rows: list[dict[str, Any]]
) -> dict[str, Any]:
    words = list(sys.argv[1:] if arguments is None else arguments)
    return {
        "command": ["python", "-m", "salpcc.stages.evaluate.studies.bench", *words],
        "machine": describe_machine(),
        "scans": len(scans),
        "points": sum(len(scan) for scan in scans),
        "rounds": rounds,
        "rows": rows,
    }


def _figures(runner: Runner, points: int) -> tuple[float, float, float, float]:
    """Geometry and total bits per point, median encode and decode CPU ms a scan."""
    geometry = 8.0 * sum(c.geometry for c in runner.coded) / points
    total = 8.0 * sum(len(c.data) for c in runner.coded) / points
    return geometry, total, float(np.median(runner.encode_ms)), float(np.median(runner.decode_ms))


def _runners(scans: Sequence[Scan], error: float, efforts: Sequence[Effort]) -> Iterator[Runner]:
    """Ours at each effort, all in one layer, then the static layer of two alone; then the rivals that can do what is asked."""
    for effort in efforts:
        encode = _ours(scans, error, effort)
        yield Runner(f"salpcc {effort}", error, encode, _decode, error)
    if all(scan.classes is not None for scan in scans):
        for effort in efforts:
            yield Runner(
                f"salpcc {effort}, static layer", error, _static(scans, error, effort), _decode, error, False
            )
    for name in RIVALS if error > 0 else ("xz", "zstd"):
        yield _rival(name, BASELINES[name], scans, error)


def _decode(data: list[bytes]) -> list[Scan]:
    return list(decode_group(data))


def _static(scans: Sequence[Scan], error: float, effort: Effort) -> Callable[[], list[Coded]]:
    return lambda: encode_static_layer(scans, error, effort)


def _ours(scans: Sequence[Scan], error: float, effort: Effort) -> Callable[[], list[Coded]]:
    return lambda: encode_group(scans, error, effort)


def _rival(name: str, baseline: Baseline, scans: Sequence[Scan], error: float) -> Runner:
    geometry = [len(baseline.encode(np.ascontiguousarray(scan.points), error)) for scan in scans]
    whole = [np.column_stack([scan.points, scan.intensity]) for scan in scans]

    def encode() -> list[Coded]:
        data = [baseline.encode(points, error) for points in whole]
        return [Coded(d, g, len(d) - g, 0) for d, g in zip(data, geometry, strict=True)]

    def decode(data: list[bytes]) -> list[Scan]:
        clouds = [baseline.decode(d) for d in data]
        pairs = zip(scans, clouds, strict=True)
        return [Scan(s.name, np.ascontiguousarray(c[:, :3]), np.ascontiguousarray(c[:, 3])) for s, c in pairs]

    bound = 3**0.5 * (error + FLOAT32_SLACK) if error else 0.0  # its own promise is per axis
    return Runner(name, error, encode, decode, bound, keeps_order=baseline.promise.order)


def _same(source: Scan, decoded: Scan) -> bool:
    return same_bits(source.points, decoded.points) and same_bits(source.intensity, decoded.intensity)


def _scans(root: Path | None, sequence: str, number: int) -> list[Scan]:
    """Read the first scans of a sequence, or simulate them."""
    source = SOURCES["semantickitti"]
    if root is not None:
        refs = source.scans(root, sequence)[:number]
        return [source.read(ref, with_labels=ref.labels is not None) for ref in refs]
    with tempfile.TemporaryDirectory() as folder:
        refs = Simulated().make(Path(folder), sequence, number)
        return [source.read(ref, with_labels=True) for ref in refs]


if __name__ == "__main__":
    raise SystemExit(main())

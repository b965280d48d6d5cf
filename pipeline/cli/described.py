"""What ``inspect`` found, in 80 columns: what it is, how small, bits by stream, groups, scans where asked."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.filesize import decimal
from rich.table import Table

from salpcc.pipeline.cli.summary import layers_in_words, smaller

STREAMS = ("geometry", "intensity", "classes", "side")
_MOST_NAMES = 12  # of side files
_MOST_GOPS = 20  # shown without --scans: the first and the last of them


def show_archive(found: dict[str, Any], console: Console, scans: bool) -> None:
    """Print what :func:`~salpcc.pipeline.inspect.inspect_archive` found, with a row a scan where asked."""
    facts = Table.grid(padding=(0, 2))
    facts.add_column(style="bold", no_wrap=True)
    facts.add_column(overflow="fold")
    for name, value in _facts(found):
        facts.add_row(name, value)
    console.print(facts, highlight=False)
    console.print(_streams(found))
    console.print(_rows("scans", found["rows"], ["gop", "name"]) if scans else _gops(found["rows"]))


def show_shard(found: dict[str, Any], console: Console) -> None:
    """Print what :func:`~salpcc.pipeline.inspect.inspect_shard` found."""
    facts = Table.grid(padding=(0, 2))
    facts.add_column(style="bold", no_wrap=True)
    facts.add_column(overflow="fold")
    facts.add_row("shard", found["path"])
    for name, value in found["facts"].items():
        facts.add_row(name, str(value))
    console.print(facts, highlight=False)
    columns = Table("column", "type", box=SIMPLE_HEAD)
    for name, kind in found["columns"].items():
        columns.add_row(name, kind)
    console.print(columns)
    rows = Table("row", *(["values"] if found["rows"] else []), box=SIMPLE_HEAD)
    for place, row in enumerate(found["rows"]):
        rows.add_row(str(place), ", ".join(f"{name} {value}" for name, value in row.items()))
    console.print(rows)


def _facts(found: dict[str, Any]) -> Iterator[tuple[str, str]]:
    # It needs NumPy, which no help does.
    from salpcc.stages.evaluate.measures.metrics import SOURCE_BYTES_PER_POINT

    config, totals = found["config"], found["totals"]
    yield "archive", found["path"]
    yield "of", f"sequence {found['sequence']} ({found['source']}), {_span(found)}"
    yield "sensor", f"{found['sensor']}, {found['lasers']} lasers"
    if found["topics"]:
        yield (
            "log",
            f"{len(found['topics'])} topics, {decimal(found['bytes_passing'])} of other topics: "
            + ", ".join(found["topics"]),
        )
    how = [f"{key} {config[key]}" for key in ("profile", "effort") if key in config]
    how += [f"groups of {config['gop']} scans"] if "gop" in config else []
    yield "coded", ", ".join([*how, _promise(config)])
    points, kept, dropped = totals["n_points"], totals["kept"], totals["dropped_movable"]
    said = f"{points:,}, all kept" if kept == points else f"{points:,}, {kept:,} kept"
    said += f", {dropped:,} that can move dropped" if dropped else ""
    yield "points", said + (f", {totals['strays']:,} in the order of their list" if totals["strays"] else "")
    if found["side_files"]:
        names = list(found["side_files"])
        more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        yield "files", f"{decimal(sum(found['side_files'].values()))}: {', '.join(names[:_MOST_NAMES])}{more}"
    yield "layers", layers_in_words(found["movable"], found["layers"])
    if points:
        beside = found["bytes_passing"] + found["bytes_labels"] + sum(found["side_files"].values())
        coded = found["bytes"] - beside
        # Points of a log have any number of fields, which the index does not say.
        size = decimal(coded) if found["topics"] else smaller(SOURCE_BYTES_PER_POINT * points, coded)
        yield "size", f"{size}, {8 * coded / points:.2f} bits a point"
    else:
        yield "size", decimal(found["bytes"])


def _span(found: dict[str, Any]) -> str:
    scans = f"{found['scans']:,} scan{'' if found['scans'] == 1 else 's'}"
    return f"{scans} over {found['seconds']:.1f} s" if found["scans"] > 1 else scans


def _promise(config: dict[str, Any]) -> str:
    error = config.get("max_error")
    if config.get("profile") == "paper":
        return f"ranges in steps of {1e3 * (error or 0.001):g} mm"
    return f"no point farther than {1e3 * error:g} mm" if error else "bit-exact"


def _streams(found: dict[str, Any]) -> Table:
    """Bytes, bits a point and share of each stream, and of what is around them."""
    table = Table(title="where the bits are", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("stream")
    for name in ("bytes", "bits a point", "share"):
        table.add_column(name, justify="right")
    points = found["totals"]["n_points"]
    parts = {name: found["totals"][name] for name in STREAMS}
    parts |= {"labels": found["bytes_labels"], "side files": sum(found["side_files"].values())}
    parts |= {"other topics": found["bytes_passing"], "index, sensor": found["bytes_container"]}
    for name, count in {**parts, "all": found["bytes"]}.items():
        if count:
            bits = f"{8 * count / points:.2f}" if points else "-"
            table.add_row(name, f"{count:,}", bits, f"{100 * count / found['bytes']:.1f} %")
    return table


def _gops(scans: list[dict[str, Any]]) -> Table:
    """A row a group of scans; of many, the first and the last."""
    groups: dict[int, list[dict[str, Any]]] = {}
    for scan in scans:
        groups.setdefault(scan["gop"], []).append(scan)
    rows = [
        {
            "gop": str(number),
            "scans": f"{group[0]['name']} to {group[-1]['name']}" if len(group) > 1 else group[0]["name"],
            **{key: sum(scan[key] for scan in group) for key in ("n_points", "kept", "strays", *STREAMS)},
        }
        for number, group in groups.items()
    ]
    left_out = len(rows) - _MOST_GOPS
    if left_out > 1:
        rows[_MOST_GOPS // 2 : -_MOST_GOPS // 2] = [{"gop": "…", "scans": f"{left_out} more groups"}]
    return _rows("groups, each decodes alone (--scans shows every scan)", rows, ["gop", "scans"])


def _rows(title: str, rows: list[dict[str, Any]], names: list[str]) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in names:
        table.add_column("group" if name == "gop" else name, overflow="fold")
    for name in ("points", "kept", "off rings", "bytes", "bits a point"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        cells = [str(row[name]) for name in names]
        if "kept" in row:
            count = sum(row[stream] for stream in STREAMS)
            cells += [f"{n:,}" for n in (row["n_points"], row["kept"], row["strays"], count)]
            cells.append(f"{8 * count / row['n_points']:.2f}" if row["n_points"] else "-")
        table.add_row(*cells)
    return table

"""The house: arrows between rooms point down, and no files go round in a circle."""

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
# From the ground up. A room may import from itself and from those before it.
ROOMS = (
    "schemas",
    "stages.memory",
    "stages.vectors",
    "stages.entropy",
    "stages.lattice",
    "stages.lists",
    "stages.ingest",
    "stages.segment",
    "stages.ground_fit",
    "stages.predict",
    "stages.residual_code",
    "stages.coding",
    "stages.mapping",
    "stages.evaluate",
    "pipeline.schedule",
    "pipeline.plan",
    "pipeline.decode",
    "pipeline.decoded_groups",
    "pipeline.archive",
    "pipeline.held_poses",
    "pipeline.sensors",
    "pipeline.files",
    "pipeline.export",
    "pipeline.edit",
    "pipeline.find",
    "pipeline.against",
    "pipeline.verify",
    "pipeline.checked",
    "pipeline.encode",
    "pipeline.inspect",
    "pipeline.view",
    "pipeline.graph",
    "pipeline.run",
    "pipeline.mapping",
    "pipeline.cli",
    "pipeline",
)


def modules() -> dict[str, Path]:
    """All modules by name, without ``salpcc.``; a package has the name of its folder."""
    found = {}
    for top in ("schemas", "stages", "pipeline"):
        for path in (ROOT / top).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


def imports(name: str) -> Iterator[str]:
    """Modules of ours that a module names, wherever in it."""
    for node in ast.walk(ast.parse(MODULES[name].read_text())):
        if isinstance(node, ast.Import):
            named = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            named = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for whole in (n.removeprefix("salpcc.") for n in named if n.startswith("salpcc.")):
            yield whole if whole in MODULES else whole.rsplit(".", 1)[0]


def room_of(name: str) -> str:
    return next((room for room in ROOMS if name == room or name.startswith(f"{room}.")), name)


def test_every_module_has_a_room() -> None:
    assert {room_of(name) for name in MODULES} - set(ROOMS) == {"stages"}  # the door of all stages


def test_arrows_point_down() -> None:
    height = {room: at for at, room in enumerate(ROOMS)}
    up = [
        f"{name} -> {other}"
        for name in MODULES
        for other in imports(name)
        if height.get(room_of(other), -1) > height.get(room_of(name), -1)
    ]
    assert not up


def test_no_files_go_round_in_a_circle() -> None:
    TopologicalSorter({name: set(imports(name)) - {name} for name in MODULES}).prepare()


def test_what_codes_knows_its_libraries() -> None:
    """torch trains and segments, Dask schedules, MCAP is that of archives and logs: nothing else imports them."""
    allowed = {
        "torch": (
            "stages.segment",
            "stages.predict",
            "pipeline.schedule.cluster",
            "pipeline.cli.train_networks",
        ),
        "distributed": ("pipeline",),
        "dask": ("pipeline",),
        "open3d": ("stages.mapping.open3d_library", "stages.mapping.drive.registration"),
    }
    for name, path in MODULES.items():
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            for library in {n.partition(".")[0] for n in names} & allowed.keys():
                assert name.startswith(allowed[library]), f"{name} imports {library}"


def test_what_only_unix_has_is_imported_where_it_is_used() -> None:
    """So every module loads on Windows, too."""
    unix = {"fcntl", "grp", "pwd", "resource", "termios"}
    for name, path in MODULES.items():
        for node in ast.parse(path.read_text()).body:
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not unix & set(names), f"{name} imports {unix & set(names)}"

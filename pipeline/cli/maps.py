"""``map`` and ``localise``: what one does with archives of a drive."""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from typer.core import TyperGroup

from salpcc.pipeline.cli import map_edits as cli_edit
from salpcc.pipeline.cli.options import BOX, Json, Scheduler, Workers, command_line, config_of, parse_box
from salpcc.pipeline.schedule.fork_server import start_fork_server
from salpcc.schemas.errors import UsageError
from salpcc.schemas.extras import require
from salpcc.stages.mapping.open3d_library import load_open3d

if TYPE_CHECKING:
    from salpcc.pipeline.mapping.localise_in_map import InMapRequest

Archives = Annotated[
    list[Path], typer.Argument(metavar="ARCHIVE", help="The archives of one drive, in order.")
]


class _MapGroup(TyperGroup):
    """``map ARCHIVE…`` makes a map; ``map edit`` and the like are of maps that are there."""

    MAKE = "make"

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments of the command that is meant."""
        return super().parse_args(ctx, args if args and args[0] in self.commands else [self.MAKE, *args])

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that is meant; that which makes maps needs no name."""
        name, command, rest = super().resolve_command(ctx, args)
        return "" if name == self.MAKE else name, command, rest


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    maps = typer.Typer(cls=_MapGroup, help="Build a clean map from decoded scans, edit maps, compare them.")
    maps.command(
        name=_MapGroup.MAKE,
        epilog="Example:  `salpcc-pipeline map out/archives/04.mcap --poses DIR/sequences/04/poses.txt --out map`  ·  "
        "of maps that are there:  `salpcc-pipeline map edit --help`",
    )(map_)
    cli_edit.register(maps)
    app.add_typer(maps, name="map")
    app.command(
        epilog="Example:  `salpcc-pipeline localise exact/04.mcap 1cm/04.mcap --against DIR --rivals draco --out loc`"
    )(localise)


def map_(
    archives: Archives,
    out: Annotated[Path, typer.Option(help="Tiles, pictures and map.json go here.")],
    poses: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE|TOPIC|odometry",
            help="Where the scans were, for each archive: a file of poses (KITTI's with calib.txt beside it, poses.txt of a map, "
            "or the sensor's with times as TUM and EuRoC write them), a topic of its log (/tf, odometry, poses), or odometry, "
            "which registers them. [default: odometry]",
        ),
    ] = None,
    labels: Annotated[
        Literal["given", "network"],
        typer.Option(
            help="Who says what can move: the archive, or the network where the archive does not; it takes as long as encoding."
        ),
    ] = "given",
    layers: Annotated[
        Literal["static", "all"],
        typer.Option(
            help="What to read of an archive in layers. With all, what may move is taken out here: more of what a network missed of "
            "it goes, too, and --explain keeps it, so that it can be put back."
        ),
    ] = "static",
    refine_poses: Annotated[
        Literal["auto", "no"],
        typer.Option(
            help="Refine given poses by registration where the scans fit one another better so; poses.txt beside the map has "
            "those that it was made with."
        ),
    ] = "auto",
    voxel: Annotated[
        float, typer.Option(metavar="METRES", help="Points in one voxel of this size are fused.")
    ] = 0.1,
    max_range: Annotated[
        float, typer.Option(metavar="METRES", help="Points farther than this from the sensor are left out.")
    ] = 80.0,
    keep_movable: Annotated[
        bool, typer.Option("--keep-movable", help="Keep what can move by its class, such as parked cars.")
    ] = False,
    carve: Annotated[
        bool, typer.Option("--carve/--no-carve", help="Take out what other scans look through.")
    ] = True,
    tune: Annotated[
        bool,
        typer.Option(
            "--tune",
            help="Choose how it is carved on your own scans: movers are pasted into a stretch of them, and the settings taken that "
            "remove most of those and least of the rest.",
        ),
    ] = False,
    fill_ground: Annotated[
        bool,
        typer.Option(
            "--fill-ground", help="Close small holes in the ground by a plane; its points are marked."
        ),
    ] = False,
    tile: Annotated[
        float, typer.Option(metavar="METRES", help="The side of a tile; a tile is held in memory.")
    ] = 50.0,
    formats: Annotated[
        str,
        typer.Option(
            metavar="NAME,NAME",
            help="What to write: tiles as laz, copc (LAZ that viewers read in parts), ply, pcd, and the whole as mcap; "
            "map.vpc is an index of LAZ tiles for QGIS and PDAL.",
        ),
    ] = "laz,ply,pcd,mcap",
    crs: Annotated[
        str | None,
        typer.Option(metavar="EPSG:…", help="The coordinate system of the poses; it is written into LAZ."),
    ] = None,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Write what was removed, too: tiles with reason, witnesses and score, a picture.",
        ),
    ] = False,
    within: Annotated[
        str | None,
        typer.Option(
            metavar=BOX,
            help="Make only what lies in this box, metres in the frame of the poses, as LAZ has it.",
        ),
    ] = None,
    against: Annotated[
        Path | None, typer.Option(help="Score the map by the labels of the data that lie here.")
    ] = None,
    rivals: Annotated[
        str, typer.Option(metavar="NAME,NAME", help="Score public cleaners of maps, too: dufomap, octomap.")
    ] = "none",
    workers: Workers = None,
    scheduler: Scheduler = None,
    keep_shards: Annotated[
        bool, typer.Option("--keep-shards", help="Keep what the steps hand to each other.")
    ] = False,
    view: Annotated[bool, typer.Option("--view", help="Open the map in Rerun or Open3D.")] = False,
    json_: Json = False,
) -> None:
    """Build a clean map from decoded scans."""
    require("map", "map")
    if labels == "network":
        require("segment", "map --labels network")
    start_fork_server(workers, scheduler, network=labels == "network")
    from salpcc.pipeline.mapping.make_map import make_map
    from salpcc.pipeline.mapping.map_export import FORMATS
    from salpcc.pipeline.mapping.map_request import MapRequest
    from salpcc.stages.mapping.config import MapConfig

    wanted = [form.strip() for form in formats.split(",") if form.strip()]
    for form in wanted:
        if form not in FORMATS:
            raise UsageError(f"--formats {form}: choose from {', '.join(FORMATS)}")
    config = config_of(
        MapConfig,
        voxel=voxel,
        max_range=max_range,
        labels=labels,
        layers=layers,
        refine_poses=refine_poses == "auto",
        keep_movable=keep_movable,
        carve=carve,
        fill=fill_ground,
        tile=tile,
        within=parse_box("--within", within) if within else None,
    )
    if tune and not carve:
        raise UsageError("--tune chooses how a map is carved; it goes without --no-carve")
    if rivals != "none" and against is None:
        raise UsageError("--rivals needs --against, the root with the source scans and their labels")
    request = MapRequest(
        archives=archives,
        out=out,
        config=config,
        poses=poses or [],
        formats=wanted,
        against=against,
        crs=crs,
        explain=explain,
        tune=tune,
        rivals=[] if rivals == "none" else [name.strip() for name in rivals.split(",")],
        workers=workers,
        scheduler=scheduler,
        keep_shards=keep_shards,
        command=command_line(),
    )
    summary = make_map(request)
    if json_:
        typer.echo(json.dumps(summary, indent=1))
    else:
        voxels = summary["voxels"]
        unknown = len(summary.get("archives_without_classes", [])) == len(archives)
        typer.echo(
            f"{summary['scans']} scans, {summary['points_in']} points: {voxels['kept']} voxels in "
            f"{len(summary['tiles'])} tiles; taken out: {voxels['carved']} seen through, "
            + ("movable classes are not known" if unknown else f"{voxels['dropped']} of movable classes")
        )
        if summary["tuning"]:
            _show_trials(summary["tuning"], summary["config"]["carving"])
        if summary["quality"]:
            _show(summary["quality"])
        typer.echo(f"map: {out / 'tiles'}\npictures: {out / 'pictures'}\nsummary: {out / 'map.json'}")
    if view:
        show(out)


def localise(
    archives: Annotated[
        list[Path], typer.Argument(metavar="ARCHIVE", help="The same sequences, coded in different ways.")
    ],
    out: Annotated[Path, typer.Option(help="The record for the report goes here.")],
    against: Annotated[
        Path | None, typer.Option(metavar="DIR", help="The data lie here: source scans, labels, poses.txt.")
    ] = None,
    map_: Annotated[
        list[Path] | None,
        typer.Option(
            "--map",
            metavar="MAP",
            help="Localise in this map, instead of by the scan before; may be repeated: a clean one, a raw one, another codec's.",
        ),
    ] = None,
    poses: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|TOPIC",
            help="Where the scans were, in the frame of --map, as map takes it. [default: poses.txt of the map]",
        ),
    ] = None,
    rivals: Annotated[
        str, typer.Option(metavar="NAME,NAME", help="Compare these codecs at the same bits a point.")
    ] = "none",
    every: Annotated[int, typer.Option(min=1, metavar="N", help="Register every n-th pair only.")] = 1,
    thin: Annotated[
        int, typer.Option(min=1, metavar="N", help="Take every n-th point of the scan that is moved.")
    ] = 1,
    workers: Workers = None,
    scheduler: Scheduler = None,
    json_: Json = False,
) -> None:
    """Register consecutive decoded scans by ICP, or localise them in a map, and measure the error, with movable things and without."""
    require("map", "localise")
    if map_:
        if rivals != "none" or against is not None:
            raise UsageError(
                "--map takes --poses, and neither --against nor --rivals; a map of another codec is another --map"
            )
        from salpcc.pipeline.mapping.localise_in_map import InMapRequest

        _in_maps(InMapRequest(archives, map_, out, poses, every, workers, scheduler), json_)
        return
    if against is None:
        raise UsageError("localise takes --against, the root with source scans and poses.txt, or --map")
    start_fork_server(workers, scheduler)
    from salpcc.pipeline.mapping.localise import LocaliseRequest
    from salpcc.pipeline.mapping.localise import localise as run
    from salpcc.stages.evaluate.baselines import names as baseline_names
    from salpcc.stages.evaluate.report.downstream import registration_figures

    chosen = tuple(baseline_names(rivals))
    rows = registration_figures(
        run(LocaliseRequest(archives, against, out, chosen, every, thin, workers, scheduler))
    )
    if json_:
        typer.echo(json.dumps(rows, indent=1))
        return
    wide = max([8, *(len(row["cloud"]) for row in rows)])
    typer.echo(
        f"seq {'cloud':{wide + 3}} error   bpp movables ICP             pairs  rotation, deg    translation, m"
    )
    for row in rows:
        error = "-" if row["max_error"] is None else f"{1e3 * row['max_error']:.1f} mm"
        bits = "-" if row["bpp"] is None else f"{row['bpp']:.2f}"
        typer.echo(
            f"{row['sequence']:3} {row['cloud']:{wide}} {error:>8} {bits:>5} {'with' if row['movable'] else 'without':8} "
            f"{row['method']:15} {row['pairs']:5}  {_errors_of_pose(row)}"
        )
    typer.echo(f"mean ± standard deviation; the record for `report` is in {out / 'report'}")


def _in_maps(request: InMapRequest, json_: bool) -> None:
    from salpcc.pipeline.mapping.localise_in_map import localise_in_maps
    from salpcc.stages.evaluate.report.downstream import localisation_figures

    rows = localisation_figures(localise_in_maps(request))
    if json_:
        typer.echo(json.dumps(rows, indent=1))
        return
    typer.echo("seq map          error movables ICP             scans lost  rotation, deg    translation, m")
    for row in rows:
        typer.echo(
            f"{row['sequence']:3} {row['map']:10} {1e3 * row['max_error']:4.1f} mm "
            f"{'with' if row['movable'] else 'without':8} {row['method']:15} {row['scans']:5} {row['lost']:4}  {_errors_of_pose(row)}"
        )
    typer.echo(f"mean ± standard deviation; the record for `report` is in {request.out / 'report'}")


def _errors_of_pose(row: dict[str, Any]) -> str:
    return "  ".join(
        "-" if row[f"{k}_mean"] is None else f"{row[f'{k}_mean']:.4f} ± {row[f'{k}_std']:.4f}"
        for k in ("rotation_deg", "translation_m")
    )


def _show_trials(trials: list[dict[str, Any]], chosen: dict[str, Any]) -> None:
    """The best settings, and the one that was taken."""
    shown = trials[:5] + [trial for trial in trials[5:] if chosen.items() <= trial.items()]
    table = Table(title="tuned on movers pasted into the scans", box=SIMPLE_HEAD, title_justify="left")
    for column in ("views", "per meeting", "margin, m", "SA", "DA", "AA", ""):
        table.add_column(column)
    for trial in shown:
        figures = [f"{trial[m]:.4f}" for m in ("sa", "da", "aa")]
        taken = "taken" if chosen.items() <= trial.items() else ""
        table.add_row(
            str(trial["views"]), f"{trial['per_meeting']:g}", f"{trial['margin']:g}", *figures, taken
        )
    Console(emoji=False, markup=False).print(table)


def _show(rows: list[dict[str, object]]) -> None:
    table = Table(title="map against labels", box=SIMPLE_HEAD, title_justify="left")
    measures = ("sa", "da", "aa", "pr", "rr", "f1")
    for column in ("truth", "cleaner", *(m.upper() for m in measures)):
        table.add_column(column)
    for row in rows:
        figures = [row[m] for m in measures]
        cells = ["-" if v is None else f"{float(str(v)):.4f}" for v in figures]
        table.add_row(str(row["truth"]), str(row["cleaner"]), *cells)
    Console(emoji=False, markup=False).print(table)


def show(out: Path) -> None:
    """Open a map's PLY tiles in Rerun where it is installed, else in Open3D.

    Raises:
        UsageError: no PLY tiles, no screen, or nothing to open them with.
    """
    import os

    import numpy as np
    from plyfile import PlyData

    tiles = sorted((out / "tiles").glob("*.ply"))
    if not tiles:
        raise UsageError(f"--view: no PLY tiles in {out / 'tiles'}; add ply to --formats")
    vertices = [PlyData.read(tile)["vertex"] for tile in tiles]
    points = [np.column_stack([vertex[axis] for axis in "xyz"]).astype(np.float64) for vertex in vertices]
    if find_spec("rerun") is not None:
        import rerun

        rerun.init("salpcc-pipeline map", spawn=True)
        for tile, xyz in zip(tiles, points, strict=True):
            rerun.log(f"map/{tile.stem}", rerun.Points3D(xyz))
        return
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise UsageError(
            "--view: no screen here (DISPLAY is not set); the pictures are in " + str(out / "pictures")
        )
    open3d = load_open3d()
    clouds = [open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz)) for xyz in points]
    open3d.visualization.draw_geometries(clouds, window_name=str(out))

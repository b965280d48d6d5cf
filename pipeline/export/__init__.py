"""Write decoded scans in the formats of others: KITTI folders, MCAP PointCloud2, ROS 1 bags, PLY, LAZ."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.export.beside import tell_what_stays
from salpcc.pipeline.export.kitti import to_kitti
from salpcc.pipeline.export.laz import to_laz
from salpcc.pipeline.export.log import to_bag, to_mcap
from salpcc.pipeline.export.new_files import write_new
from salpcc.pipeline.export.ply import ply_of
from salpcc.pipeline.export.tell import Tell, in_silence
from salpcc.schemas.extras import require
from salpcc.schemas.scan import Scan
from salpcc.stages.ingest.point_cloud import add_column, scan_columns


class Export(Protocol):
    """Write scans of an archive below a folder, one path after the other; tell what is left behind."""

    def __call__(
        self, archive: Archive, scans: Iterator[Scan], out: Path, tell: Tell = ...
    ) -> Iterator[Path]: ...


def to_ply(archive: Archive, scans: Iterator[Scan], out: Path, tell: Tell = in_silence) -> Iterator[Path]:
    """Write ``out/SEQ/NAME.ply`` (binary): every field under its own name and with its type.

    The class of each point comes beside them as ``class``, or as ``class_1`` where a field has that name; its label, class
    and instance as annotated, as ``label``.

    Raises:
        UsageError: other points are there, that these must not replace, or the extra ``map`` is missing.
    """
    require("map", "--to ply")
    for scan in scans:
        path = out / archive.sequence / f"{scan.name}.ply"
        columns = scan_columns(scan)
        if scan.classes is not None:
            add_column(columns, "class", scan.classes)
        if scan.labels is not None:
            add_column(columns, "label", scan.labels)
        write_new(path, ply_of(columns), "points are")
        yield path
    tell_what_stays(archive, "ply", tell)


EXPORTS: dict[str, Export] = {
    "kitti": to_kitti,
    "mcap": to_mcap,
    "bag": to_bag,
    "ply": to_ply,
    "laz": to_laz,
}

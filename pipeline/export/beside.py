"""What an archive holds beside its scans, and a format has no place for."""

from __future__ import annotations

from collections.abc import Iterator

from salpcc.pipeline.archive import Archive
from salpcc.pipeline.export.tell import Tell

_NAMED = 5  # of many topics or files


def tell_what_stays(archive: Archive, form: str, tell: Tell) -> None:
    """Tell what of an archive does not get into files of a format (a key of EXPORTS), and which one has it."""
    for what, has in _beside(archive):
        if form not in has:
            tell(f"{what} stay behind: --to {form} has no place for them, --to {has[0]} has")


def _beside(archive: Archive) -> Iterator[tuple[str, tuple[str, ...]]]:
    """What there is besides points and their fields, and the formats that have it, the best one first."""
    if topics := archive.passing_topics:
        log = ("bag", "mcap") if all(c.encoding == "ros1" for c in archive.log.values()) else ("mcap",)
        yield f"messages of {_some(topics)}", log
    if next(archive.enclosed(), None) is not None:
        yield "attachments and metadata of the log", ("mcap",)
    if archive.side:
        yield _some(archive.side), ("kitti",)
    if archive.has_classes:
        yield "classes and labels", ("ply", "laz", "kitti")


def _some(names: list[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")

"""What an output folder holds of a sequence already: a good archive is replaced only when somebody says so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from salpcc.pipeline.plan.plan import SequencePlan
from salpcc.schemas.config import RunConfig
from salpcc.schemas.errors import ArchiveError, UsageError
from salpcc.stages.residual_code.archive.reader import ArchiveReader

_OPTIONS = {
    "sensor_digest": "sensor",
    "weights_digest": "weights",
    "layers": "drop_movable",
    "movable_max_error": "max_error",
}  # what the others are called by


def held_scans(archive: Path) -> list[str]:
    """Names of the scans of an archive; none where there is none, or a damaged one."""
    try:
        return ArchiveReader(archive).names
    except ArchiveError:
        return []


def check_replaceable(
    archive: Path, plan: SequencePlan, inputs: str, record: dict[str, Any], config: RunConfig
) -> None:
    """Refuse to replace a good archive by one of other options, frames or files.

    One that is damaged, or that scans are missing from which failed then, is made again.

    Args:
        inputs: digest of what the new archive would be made of.
        record: of the run that made the old one.

    Raises:
        UsageError: it is another archive; the message says how it differs.
    """
    try:
        reader = ArchiveReader(archive)
    except ArchiveError:
        return
    facts = reader.facts
    if facts.inputs == inputs:
        return
    asked: dict[str, object] = config.coding
    options = sorted(
        {
            f"--{_OPTIONS.get(key, key).replace('_', '-')}"
            for key in asked.keys() | facts.config.keys()
            if asked.get(key) != facts.config.get(key)
        }
    )
    if "--keep-movable" in options and "--drop-movable" in options:
        options.remove("--drop-movable")  # it follows
    here, wanted = set(reader.names), {ref.name for gop in plan.gops for ref in gop.scans}
    if options:
        how = f"with another {', '.join(options)}"
    elif facts.source != config.source:
        how = f"from --source {facts.source}"
    elif record.get("errors") and here <= wanted:
        return
    elif here != wanted:
        how = f"of {len(here)} scans, not of these {len(wanted)} (--frames?)"
    else:
        how = "from files of other content, or by another version of this tool"
    raise UsageError(
        f"{archive} is there already, made {how}; add --overwrite to replace it, or choose another --out"
    )

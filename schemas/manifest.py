"""The data manifest: which data there are, and how they are split."""

from __future__ import annotations

import re
from pathlib import Path

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from salpcc.schemas.errors import UsageError
from salpcc.schemas.files import location

_MOST = 10_000  # sequences of a range


class SourceEntry(BaseModel):
    """One source: what it is, where it comes from, where it lies here."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    description: str
    url: str = ""
    licence: str = ""
    root: str = ""
    sequences: dict[str, int | None] = {}
    splits: dict[str, str] = {}


class Manifest(BaseModel):
    """All sources by name. ``sequences`` give scan counts (None: not known beforehand)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    version: int = 1
    sources: dict[str, SourceEntry] = {}


def load_manifest(path: Path) -> Manifest:
    """Read a manifest; relative roots are taken from the folder of the file.

    Raises:
        UsageError: not there, or not a manifest.
    """
    try:
        manifest = Manifest.model_validate(yaml.safe_load(path.read_text()))
    except (OSError, yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError(f"{path}: cannot be read as a manifest ({str(error).splitlines()[0]})") from error
    except ValidationError as error:
        first = error.errors()[0]
        raise UsageError(f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    sources = {
        name: entry.model_copy(update={"root": str(_from(path.parent, entry.root))}) if entry.root else entry
        for name, entry in manifest.sources.items()
    }
    return manifest.model_copy(update={"sources": sources})


def _from(folder: Path, root: str) -> Path:
    return location(root) if "://" in root else folder / root


def expand_sequences(text: str, splits: dict[str, str] | None = None) -> list[str]:
    """Expand ``04``, ``00,04,07``, ``11-21`` or the name of a split to sequence names, in order.

    Numbers keep the width of the first: ``08-11`` is 08, 09, 10, 11.

    Raises:
        UsageError: an empty or descending item.
    """
    names: list[str] = []
    for item in (part.strip() for part in text.split(",")):
        if splits and item in splits:
            names += expand_sequences(splits[item])
        elif match := re.fullmatch(r"(\d+)-(\d+)", item):
            first, last = int(match[1]), int(match[2])
            if last < first:
                raise UsageError(f"sequences {item!r}: the range descends")
            if last - first > _MOST:
                raise UsageError(f"sequences {item!r}: more than {_MOST} of them")
            names += [f"{n:0{len(match[1])}d}" for n in range(first, last + 1)]
        elif re.fullmatch(r"[\w.]+", item) and item.strip("."):
            names.append(item)
        else:
            raise UsageError(f"sequences {text!r}: expected names like 04, 00,04,07 or 11-21")
    return list(dict.fromkeys(names))

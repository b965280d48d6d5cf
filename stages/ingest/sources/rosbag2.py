"""The folder of a ROS 2 bag: its files, and what ``metadata.yaml`` says of them.

What is in a bag is what its files hold. ``metadata.yaml`` gives their order; where it says something else about
what is in them (recorders are killed, people edit it), the files are right and the difference is told.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from salpcc.schemas.errors import SourceError
from salpcc.schemas.files import why
from salpcc.stages.ingest.sources.sqlite_log import OF_SQLITE, qos_text
from salpcc.stages.ingest.sources.unpack import COMPRESSED, plain_name

METADATA = "metadata.yaml"
_QOS = "offered_qos_profiles"
_SUFFIXES = {"mcap": ".mcap", "sqlite3": ".db3"}


@dataclass(frozen=True)
class Rosbag2:
    """A bag's folder.

    Attributes:
        storage: ``mcap`` or ``sqlite3``.
        files: that hold messages, in order; those that ``metadata.yaml`` does not list stand at the end.
        counts: messages by topic, as ``metadata.yaml`` says.
        qos: QoS profiles by topic, as it says.
        differences: what else it says that the folder does not bear out, and what of the folder is not read.
    """

    path: Path
    storage: str
    files: tuple[Path, ...]
    counts: Counter[str] = field(default_factory=Counter)
    qos: dict[str, str] = field(default_factory=dict)
    differences: tuple[str, ...] = ()


def is_rosbag2(path: Path) -> bool:
    """Tell whether a folder is a ROS 2 bag."""
    return (path / METADATA).is_file()


def read_rosbag2(path: Path) -> Rosbag2:
    """Read the folder of a bag.

    Raises:
        SourceError: ``metadata.yaml`` cannot be read, a file that it lists is not there, or it is of an unknown kind.
    """
    where = f"{path / METADATA}"
    try:
        about: dict[str, Any] = yaml.safe_load((path / METADATA).read_text())["rosbag2_bagfile_information"]
        storage = str(about["storage_identifier"])
        # A name leads into the bag's folder and nowhere else.
        listed = [Path(str(name)).name for name in about["relative_file_paths"]]
        topics = [
            (t["topic_metadata"], int(t["message_count"])) for t in about["topics_with_message_count"] or ()
        ]
        counts: Counter[str] = Counter()
        for topic, count in topics:
            counts[str(topic["name"])] += count
        qos = {str(t["name"]): qos_text(t[_QOS]) for t, _ in topics if _QOS in t}
        compression = str(about.get("compression_format") or "zstd")
    except OSError as error:
        raise SourceError(f"{where}: {why(error)}") from error
    except (yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise SourceError(
            f"{where}: cannot be read ({type(error).__name__}); `ros2 bag reindex {path.name}` writes a new one"
        ) from error
    if storage not in _SUFFIXES:
        raise SourceError(f"{where}: storage {storage} is not read; mcap and sqlite3 are")
    if compression != "zstd":
        raise SourceError(
            f"{where}: compression {compression} is not read; `ros2 bag convert` writes another"
        )
    files, differences = _find(path, _SUFFIXES[storage], listed)
    if about.get("custom_data"):
        differences.append(f"stays behind: custom_data in {METADATA}")
    return Rosbag2(path, storage, tuple(files), counts, qos, tuple(differences))


def _find(path: Path, suffix: str, listed: list[str]) -> tuple[list[Path], list[str]]:
    """Find the files of a bag in its folder; also say what of it is another than listed."""
    try:
        there = {file.name: file for file in sorted(path.iterdir()) if file.is_file() and file.name[0] != "."}
    except OSError as error:
        raise SourceError(f"{path}: {why(error)}") from error
    files: dict[str, Path] = {}  # by name before compression
    for name in listed:
        # Players leave the decompressed file beside the other: the same messages, to be read once.
        names = [name, plain_name(name), *(plain_name(name) + end for end in COMPRESSED)]
        found = next((there[other] for other in names if other in there), None)
        if found is None:
            raise SourceError(
                f"{path / METADATA}: lists {name}, which is not in the folder; put it back or `ros2 bag reindex`"
            )
        files.setdefault(plain_name(name), found)
    differences = []
    known = {plain_name(name) for name in listed}
    for name, file in there.items():
        if plain_name(name).endswith(suffix) and plain_name(name) not in known:
            files.setdefault(plain_name(name), file)
            differences.append(f"{name} is not listed in {METADATA}, and is read all the same")
    of_bag = {name for name in there if plain_name(name) in files} | {METADATA}
    of_bag |= {name for name in there if name.endswith(OF_SQLITE) and name.rpartition("-")[0] in of_bag}
    differences += [f"stays behind: {name} beside the bag" for name in there if name not in of_bag]
    if not files:
        raise SourceError(f"{path / METADATA}: lists no files, and there are none")
    return list(files.values()), differences

"""ROS 1 messages in ROS 2's words (through rosbags): the same values, but for the sequence number of headers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v8
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from salpcc.schemas.log import LogChannel

_HEADER = "std_msgs/msg/Header"
_EVER = QosTime(2147483647, 4294967295)
# What a latched topic of ROS 1 is in ROS 2: late subscribers get the last message.
_LATCHED = Qos(
    QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, _EVER, _EVER,
    QosLiveliness.AUTOMATIC, _EVER, False,
)  # fmt: skip

_NOTHING = "d41d8cd98f00b204e9800998ecf8427e"  # the md5sum of a type without fields and constants

Translate = Callable[[bytes], bytes | None]  # None: the bytes are no message of that type


def ros2_channel(channel: LogChannel) -> tuple[LogChannel, Translate]:
    """Return a channel as ROS 2 has it, and what its messages become.

    Channels of other encodings stay as they are; so do those of ROS 1 whose definition is missing or cannot be
    understood. Where it is missing and the type is one of ROS's own, its definition is known.
    """
    if channel.encoding != "ros1":
        return channel, bytes
    kind = channel.type.replace("/", "/msg/")
    store = get_typestore(Stores.EMPTY)
    try:
        types = get_types_from_msg(_definition(channel, kind), kind)
        if _HEADER in types:
            types[_HEADER] = get_typestore(Stores.ROS2_HUMBLE).fielddefs[_HEADER]
        needed = {
            name: fields
            for name, fields in get_typestore(Stores.ROS2_HUMBLE).fielddefs.items()
            if name.startswith("builtin_interfaces/")
        }
        store.register({**needed, **types})
        text, _ = store.generate_msgdef(kind, ros_version=2)
    except Exception:  # noqa: BLE001 (a definition of anybody's; Foxglove reads the channel as it is)
        if _is_empty(channel):  # MCAP has another word for that, which readers of ROS 2 know
            return replace(channel, schema_encoding="", schema=b""), bytes
        return channel, bytes
    latched = dict(channel.metadata).get("latching") == "1"
    metadata = (("offered_qos_profiles", dump_qos_v8([_LATCHED]) if latched else ""),)

    def translate(data: bytes) -> bytes | None:
        try:
            return bytes(store.ros1_to_cdr(data, kind))
        except Exception:  # noqa: BLE001 (bytes of anybody's)
            return None

    told = replace(
        channel, type=kind, encoding="cdr", schema_encoding="ros2msg", schema=text.encode(), metadata=metadata
    )
    return told, translate


def _definition(channel: LogChannel, kind: str) -> str:
    """The definition of a channel's type. One without a field is that of an empty type only where its md5sum says so.

    Raises:
        Exception: it is missing and not known.
    """
    md5sum = dict(channel.metadata).get("md5sum", "*")
    if md5sum == _NOTHING or not _is_empty(channel):
        return channel.schema.decode()
    known, known_sum = get_typestore(Stores.ROS1_NOETIC).generate_msgdef(kind)
    if md5sum not in ("*", known_sum):
        raise ValueError(f"not the {kind} that is known")
    return str(known)


def _is_empty(channel: LogChannel) -> bool:
    """Tell whether a definition has no fields; comments are none."""
    return not any(line.partition(b"#")[0].strip() for line in channel.schema.splitlines())

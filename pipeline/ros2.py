"""ROS 1 messages in ROS 2's words (through rosbags): the same values, but for the sequence number of headers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v8
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from salpcc.schemas.errors import SourceError
from salpcc.schemas.log import LogChannel

_HEADER = "std_msgs/msg/Header"
_EVER = QosTime(2147483647, 4294967295)
# What a latched topic of ROS 1 is in ROS 2: late subscribers get the last message.
_LATCHED = Qos(
    QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, _EVER, _EVER,
    QosLiveliness.AUTOMATIC, _EVER, False,
)  # fmt: skip

Translate = Callable[[bytes], bytes]


def ros2_channel(channel: LogChannel) -> tuple[LogChannel, Translate]:
    """Return a channel as ROS 2 has it, and what its messages become.

    Channels of other encodings stay as they are; so do those of ROS 1 whose definition cannot be understood.
    """
    if channel.encoding != "ros1":
        return channel, bytes
    kind = channel.type.replace("/", "/msg/")
    store = get_typestore(Stores.EMPTY)
    try:
        types = get_types_from_msg(channel.schema.decode(), kind)
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
        return channel, bytes
    latched = dict(channel.metadata).get("latching") == "1"
    metadata = (("offered_qos_profiles", dump_qos_v8([_LATCHED]) if latched else ""),)

    def translate(data: bytes) -> bytes:
        try:
            return bytes(store.ros1_to_cdr(data, kind))
        except Exception as error:
            raise SourceError(f"{channel.topic}: a message is no {channel.type} ({error})") from error

    told = replace(
        channel, type=kind, encoding="cdr", schema_encoding="ros2msg", schema=text.encode(), metadata=metadata
    )
    return told, translate

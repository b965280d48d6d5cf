"""Make the dictionary that documents of archives are compressed with; another one is another format (schemas/ARCHIVE.md, section 2.11).

python scripts/archive_dictionary.py
"""

import json

from salpcc.schemas.config import RunConfig
from salpcc.schemas.labels import CLASSES, GROUPS
from salpcc.schemas.log import LogChannel
from salpcc.schemas.messages import PLAIN, SCHEMA_TEXT
from salpcc.stages.lattice.sensor_model import load_sensor
from salpcc.stages.residual_code.archive import documents
from salpcc.stages.residual_code.archive.passing import channel_document

_SENSORS = ("hdl64e", "vls128", "qt64", "pandar64", "vlp32c", "xt32", "xt32m", "pandar40p", "hdl32e", "vlp16")
_TEXT = SCHEMA_TEXT[PLAIN].encode()
_ROS1 = ("ros1", PLAIN.replace("/msg", ""), "ros1msg")
_ROS1_FACTS = (("callerid", ""), ("latching", "0"), ("md5sum", "1158d486dd51d683ce2f1be655c3c181"))


def main() -> None:
    """Write it: what is likelier stands nearer to its end, where zlib finds it by shorter numbers."""
    channels = [
        LogChannel(1, "/velodyne_points", *_ROS1, _TEXT.replace(b"std_msgs/Header", b"Header"), _ROS1_FACTS),
        LogChannel(1, "/points", "cdr", PLAIN, "ros2msg", _TEXT, (("offered_qos_profiles", ""),)),
    ]
    contents = [
        *(json.loads(load_sensor(name).to_json()) for name in _SENSORS),
        {
            "classes": [{"name": c.name, "group": GROUPS[c.group], "colour": list(c.colour)} for c in CLASSES],
            "config": RunConfig(keep_movable=True).coding,
            "inputs": "",
            "log": [channel_document(channel) for channel in channels],
            "sensor": {
                "bit_identical_share": 1.0, "count": 0.001,
                "driver": {"formula": "ouster", "lasers": [[0, 0, 15806, 36180], [1, 1]], "sine": "rounded", "single": False, "steps": 1024},
                "name": "calibrated", "shift": [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0], "ticks_per_turn": 1024, "version": 2,
            },
            "source": "mcap",
        },
        {"movable": [[]], "scans": [[["000000", 1, 1, 0, 0]]]},
        {"gop": 0, "scans": ["000000", "000001", "000002", "000003", "000004", "000005", "000006", "000007"], "sequence": "00"},
    ]  # fmt: skip
    text = json.dumps(contents, sort_keys=True, separators=(",", ":"))
    documents.DICTIONARY_FILE.write_text(text + "\n")
    print(f"{documents.DICTIONARY_FILE}: {len(text) + 1} bytes")


if __name__ == "__main__":
    main()

"""The fuzz of every reader (``make fuzz``), for a moment only, and what no chance finds: bombs and paths."""

import importlib.util
import json
import struct
import sys
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from salpcc.schemas.errors import SalpccError
from salpcc.schemas.manifest import Manifest, expand_sequences, load_manifest
from salpcc.schemas.messages import PLAIN, SCHEMA_TEXT
from salpcc.stages.ingest.sources.bag import Bag
from salpcc.stages.lattice.sensor_model import SensorModel, load_sensor

FUZZ = Path(__file__).parent / "fuzz"
READERS = (
    "payload", "payload of another sensor", "payload of a movable layer", "labels", "strays that are told",
    "payload of the paper profile",
    "archive", "archive, recovered", "shard",
    ".bin", ".pcd.bin", ".label",
    "times.txt", "timestamps.txt", "poses.txt", "calib.txt", "manifest", "sensor model", "MCAP log", "ROS 1 bag",
    "ROS 2 bag", "weights, segment", "weights, st_lstm", "weights, coder", "weights, tables",
)  # fmt: skip
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
SENSOR = json.loads(load_sensor("hdl64e").to_json())


@pytest.fixture(scope="module")
def fuzz() -> ModuleType:
    sys.path.insert(0, str(FUZZ))
    spec = importlib.util.spec_from_file_location("fuzz_main", FUZZ / "__main__.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_all_readers_are_fuzzed(fuzz: ModuleType) -> None:
    assert set(fuzz.targets()) == set(READERS)


@pytest.mark.parametrize("name", READERS)
def test_damaged_input_is_refused(name: str, fuzz: ModuleType) -> None:
    assert fuzz.fuzz(name, 5 if "segment" in name else 50, seed=7, memory=None) is None


def test_a_reader_that_takes_anything_is_found_out(fuzz: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("salpcc.pipeline.schedule.store.content_crc", lambda table: 0)
    wrong = fuzz.fuzz("shard", 200, seed=7, memory=None)
    assert wrong is not None and "a damaged shard gave another table" in wrong


@given(document=JSON, key=st.sampled_from(sorted(SENSOR)))
@settings(max_examples=150)
def test_any_json_is_a_sensor_model_or_refused(document: object, key: str) -> None:
    for text in (json.dumps(document), json.dumps(SENSOR | {key: document})):
        try:
            model = SensorModel.from_json(text)
        except SalpccError:
            continue
        assert len(model.theta) == len(model.shift) <= 256


@given(document=JSON, key=st.sampled_from(["version", "sources"]))
@settings(max_examples=100)
def test_any_yaml_is_a_manifest_or_refused(
    document: object, key: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "manifest.yaml"
    for content in (document, {key: document}, {"sources": {"a": document}}):
        path.write_text(yaml.safe_dump(content), "utf-8", "surrogatepass")
        try:
            assert isinstance(load_manifest(path), Manifest)
        except SalpccError:
            continue


@given(st.text(alphabet="0123456789-,. ab/", max_size=24))
def test_sequences_are_few_and_name_no_folder_above(text: str) -> None:
    try:
        names = expand_sequences(text)
    except SalpccError:
        return
    assert len(names) <= 30_000 and all("/" not in name and name.strip(".") for name in names)


def test_deep_yaml_and_aliases_are_refused(tmp_path: Path) -> None:
    laughs = "a: &a [x]\n" + "".join(
        f"{c}: &{c} [{','.join(f'*{p}' * 1 for _ in range(9))}]\n"
        for p, c in zip("abcdefgh", "bcdefghi", strict=True)
    )
    for text in ("[" * 100_000, laughs):
        (tmp_path / "m.yaml").write_text(text)
        with pytest.raises(SalpccError, match=r"m\.yaml"):
            load_manifest(tmp_path / "m.yaml")


def mcap_with_chunk(compression: str, data: bytes, claimed: int) -> bytes:
    """An MCAP file of one chunk that claims to hold so many bytes."""

    def record(opcode: int, content: bytes) -> bytes:
        return struct.pack("<BQ", opcode, len(content)) + content

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    schema = SCHEMA_TEXT[PLAIN].encode()
    out = b"\x89MCAP0\r\n" + record(1, text("ros2") + text(""))
    out += record(
        3, struct.pack("<H", 1) + text(PLAIN) + text("ros2msg") + struct.pack("<I", len(schema)) + schema
    )
    out += record(4, struct.pack("<HH", 1, 1) + text("/p") + text("cdr") + struct.pack("<I", 0))
    out += record(
        6, struct.pack("<QQQI", 0, 0, claimed, 0) + text(compression) + struct.pack("<Q", len(data)) + data
    )
    return (
        out + record(0x0F, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0)) + b"\x89MCAP0\r\n"
    )


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("claimed", [0, 1000, 1 << 34, (1 << 63) - 1])
def test_decompression_bombs_are_refused(compression: str, claimed: int, tmp_path: Path) -> None:
    """A gigabyte and more from some kilobytes, whatever size the chunk claims."""
    import lz4.frame
    import zstandard

    plain = bytes(1 << 24)
    if compression == "zstd":
        block = zstandard.compress(plain)
        compressor = zstandard.ZstdCompressor().compressobj()
        bomb = b"".join(compressor.compress(plain) for _ in range(80)) + compressor.flush()
        assert len(block) < len(bomb) < 1 << 20
    else:
        context = lz4.frame.LZ4FrameCompressor()
        bomb = context.begin() + b"".join(context.compress(plain) for _ in range(80)) + context.flush()
    (tmp_path / "log.mcap").write_bytes(mcap_with_chunk(compression, bomb, claimed))
    before = Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]
    with suppress(SalpccError):
        assert Bag().scans(tmp_path, "log") == [] and not claimed
    after = Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]
    assert int(after) - int(before) < 700_000  # kB


@pytest.mark.parametrize("name", ["../../", "/tmp/x", "a/../b"])
def test_an_archive_whose_names_lead_out_decodes_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Names are checked where an archive is opened; so no export sees them."""
    from salpcc.pipeline import Archive, Scan, encode_scans
    from salpcc.stages.residual_code.archive import writer

    honest = writer.pack_document
    monkeypatch.setattr(
        writer, "pack_document", lambda said: honest(json.loads(json.dumps(said).replace("000000", name)))
    )
    scan = Scan("000000", np.zeros((5, 3), np.float32), np.zeros(5, np.float32))
    encode_scans([scan], tmp_path / "odd.mcap", effort="fast")
    with pytest.raises(SalpccError, match="cannot name a file"):
        Archive(tmp_path / "odd.mcap")

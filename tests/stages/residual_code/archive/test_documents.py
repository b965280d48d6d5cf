"""Documents of an archive: what is written is read, and nothing that is damaged or endless is."""

import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salpcc.stages.lattice.sensor_model import SENSORS, load_sensor
from salpcc.stages.residual_code.archive import documents
from salpcc.stages.residual_code.archive.documents import DICTIONARY, MARK, pack_document, unpack_document

JSON = st.recursive(
    st.none() | st.integers() | st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)
)


@given(JSON)
def test_what_is_packed_comes_back(content: object) -> None:
    data = pack_document(content)
    assert data.startswith(MARK) and unpack_document(data) == content


def test_the_dictionary_is_that_of_the_format() -> None:
    assert bytes.fromhex("78f9123040fe") == MARK  # zlib's head, and the Adler-32 that ARCHIVE.md names
    assert zlib.adler32(DICTIONARY).to_bytes(4, "big") == MARK[2:]


@pytest.mark.parametrize("name", [path.stem for path in SENSORS.glob("*.json")])
def test_a_shipped_sensor_costs_next_to_nothing(name: str) -> None:
    text = load_sensor(name).to_json()
    assert len(pack_document(documents.json.loads(text))) < 80


def test_what_is_damaged_or_endless_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    data = pack_document(["a", "b"] * 100)
    for bad in (b"", data[:-1], data + b"x", bytes([data[0] ^ 1]) + data[1:], data[:10] + b"\0" + data[11:]):
        with pytest.raises(ValueError):
            unpack_document(bad)
    monkeypatch.setattr(documents, "MOST_BYTES", 100)
    with pytest.raises(ValueError, match="more than 100"):
        unpack_document(data)

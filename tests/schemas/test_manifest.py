"""The manifest, and the names of sequences."""

from pathlib import Path

import pytest

from salpcc.schemas.errors import UsageError
from salpcc.schemas.manifest import expand_sequences, load_manifest

MANIFEST = Path(__file__).parents[2] / "data_manifest.yaml"


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("04", ["04"]),
        ("00,04,07", ["00", "04", "07"]),
        ("11-13", ["11", "12", "13"]),
        ("00-02,09", ["00", "01", "02", "09"]),
        ("04,04", ["04"]),
        ("2011_09_26_drive_0005_sync,rtst_5", ["2011_09_26_drive_0005_sync", "rtst_5"]),
        ("validation", ["06"]),
    ],
)
def test_names_expand(text: str, names: list[str]) -> None:
    assert expand_sequences(text, {"validation": "06"}) == names


@pytest.mark.parametrize("text", ["", "04,", "9-3", "../x", "a/b", "..", "04;05"])
def test_wrong_names_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="sequences"):
        expand_sequences(text)


def test_shipped_manifest_has_the_splits_of_the_paper() -> None:
    entry = load_manifest(MANIFEST).sources["semantickitti"]
    split = {name: expand_sequences(text) for name, text in entry.splits.items()}
    assert split["train"] == ["00", "01", "02", "03", "04", "05", "07", "08", "09", "10"]
    assert split["validation"] == ["06"]
    assert sum(entry.sequences[name] or 0 for name in split["test"]) == 20351
    assert not set(split["train"]) & set(split["validation"] + split["test"])


def test_root_is_relative_to_the_manifest(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    for root, found in (
        ("data", str(tmp_path / "data")),
        ("memory://data", "memory://data"),
        ("/data", "/data"),
    ):
        path.write_text(f"sources: {{semantickitti: {{description: d, root: '{root}'}}}}")
        assert load_manifest(path).sources["semantickitti"].root == found


@pytest.mark.parametrize("text", ["[1, 2", "sources: 3", "unknown: 1", "\x00"])
def test_damaged_manifest_names_the_file(tmp_path: Path, text: str) -> None:
    path = tmp_path / "m.yaml"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"m\.yaml"):
        load_manifest(path)

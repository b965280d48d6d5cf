"""Configuration: what decides bytes is in the digest, what does not is not."""

import pytest
from pydantic import ValidationError

from salpcc.schemas.config import RunConfig


@pytest.mark.parametrize(
    "change",
    [
        {"max_error": 0.01},
        {"keep_movable": True},
        {"labels": "given"},
        {"effort": "max"},
        {"gop": 4},
        {"profile": "paper"},
        {"sensor_digest": "x"},
    ],
)
def test_what_decides_bytes_changes_the_digest(change: dict[str, object]) -> None:
    assert RunConfig.model_validate(change).digest != RunConfig().digest


@pytest.mark.parametrize(
    "change", [{"frames": (0, 5)}, {"baselines": ("xz",)}, {"device": "cuda"}, {"source": "kitti_raw"}]
)
def test_what_does_not_leaves_it(change: dict[str, object]) -> None:
    assert RunConfig.model_validate(change).digest == RunConfig().digest


@pytest.mark.parametrize(
    "wrong", [{"max_error": 0}, {"max_error": -1}, {"frames": (3, 3)}, {"gop": 0}, {"colour": "red"}]
)
def test_nonsense_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        RunConfig.model_validate(wrong)

"""The network: shapes, folding, what its output may depend on, and its checkpoint."""

from pathlib import Path

import numpy as np
import pytest
import torch

from salpcc.stages.segment.network.checkpoint import load_cached, load_weights, save_weights
from salpcc.stages.segment.network.inputs import network_input, stack
from salpcc.stages.segment.network.multimodal import (
    WIDTHS,
    NetworkConfig,
    SegmentNetwork,
    fold_columns,
    unfold_columns,
)
from salpcc.stages.segment.network.point_branch import PointBranch
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.weights_file import WeightsError, weights_digest, weights_path

TINY = NetworkConfig("tiny", 2, 8, 4, 1, (8, 8, 8), 64, 8, (8, 8), 1)


@pytest.fixture(scope="module")
def tiny() -> SegmentNetwork:
    torch.manual_seed(0)
    return SegmentNetwork(TINY).eval()


@pytest.mark.parametrize("config", [TINY, WIDTHS["small"], WIDTHS["paper"]])
def test_every_pixel_gets_a_score_of_every_class(config: NetworkConfig, make_scan) -> None:
    planes = project(make_scan().points, make_scan().intensity).planes[:, :, :128].copy()
    network = SegmentNetwork(config).eval()
    batch = stack([network_input(planes, config.fold, 64, circular=False)] * 2)
    with torch.inference_mode():
        logits = network(*batch)
    assert logits.shape == (2, 19, 64, 128) and torch.isfinite(logits).all()
    assert torch.equal(logits[0], logits[1])


def test_folding_and_back() -> None:
    image = torch.arange(2 * 3 * 4 * 8).reshape(2, 3, 4, 8)
    folded = fold_columns(image, 4)
    assert folded.shape == (2, 12, 4, 2)
    assert folded[0, 1 * 4 + 3, 2, 1] == image[0, 1, 2, 7]
    assert torch.equal(unfold_columns(folded, 4), image)


def test_points_have_no_order_within_a_group(make_scan) -> None:
    planes = project(make_scan().points, make_scan().intensity).planes[:, :, :128].copy()
    _, sets = stack([network_input(planes, 2, 64, circular=False)])
    branch = PointBranch((8, 8, 8)).eval()
    shuffled = sets._replace(groups=[g[..., torch.randperm(g.shape[-1])] for g in sets.groups])
    with torch.inference_mode():
        assert torch.allclose(branch(sets), branch(shuffled), atol=1e-6)


def test_weights_come_back(tiny: SegmentNetwork, tmp_path: Path) -> None:
    path = tmp_path / "segment_tiny.safetensors"
    save_weights(path, tiny.state_dict(), TINY, {"sequences": ["00"], "steps": 3})
    network, facts = load_weights(path)
    assert network.config == TINY and not network.training and facts == {"sequences": ["00"], "steps": 3}
    for name, value in tiny.state_dict().items():
        if value.is_floating_point():
            assert torch.equal(network.state_dict()[name], value.half().float())
    assert weights_path(str(path)) == path and len(weights_digest(path)) == 64


def test_wrong_weights_are_refused(tiny: SegmentNetwork, tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "w.safetensors"
    with pytest.raises(WeightsError, match=r"w\.safetensors.*--labels given"):
        load_weights(path)
    with pytest.raises(WeightsError, match="segment_giant"):
        weights_digest(weights_path("giant"))
    path.write_bytes(b"weights of something else")
    with pytest.raises(WeightsError, match="not weights"):
        load_weights(path)
    save_weights(path, tiny.state_dict(), TINY, {})
    whole = path.read_bytes()
    path.write_bytes(whole[:-50])
    with pytest.raises(WeightsError, match="do not fit"):
        load_weights(path)
    save_weights(path, {k: v for k, v in tiny.state_dict().items() if "head" not in k}, TINY, {})
    with pytest.raises(WeightsError, match="head"):
        load_weights(path)
    monkeypatch.setattr("salpcc.stages.segment.network.checkpoint.VERSION", 2)
    save_weights(path, tiny.state_dict(), TINY, {})
    monkeypatch.setattr("salpcc.stages.segment.network.checkpoint.VERSION", 1)
    with pytest.raises(WeightsError, match="version 2 is newer"):
        load_weights(path)


def test_half_a_millimetre_of_noise_changes_little(make_scan) -> None:
    from salpcc.stages.segment.segmenter import label_points

    network = load_cached(weights_path("small"))
    scan = make_scan()
    noise = np.random.default_rng(0).uniform(-5e-4, 5e-4, scan.points.shape).astype(np.float32)
    first = label_points(network, scan.points, scan.intensity)
    assert (first == label_points(network, scan.points, scan.intensity)).all()
    assert (first == label_points(network, scan.points + noise, scan.intensity)).mean() > 0.9

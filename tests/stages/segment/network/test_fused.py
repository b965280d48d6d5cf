"""The fused network says what the trained one says."""

import pytest
import torch

from salpcc.stages.segment.network.fused import SEAM, FusedNetwork
from salpcc.stages.segment.network.inputs import network_input, stack
from salpcc.stages.segment.network.multimodal import NetworkConfig, SegmentNetwork
from salpcc.stages.segment.network.point_branch import PointTensors
from salpcc.stages.segment.network.projection import project

FOLDED = NetworkConfig("folded", 4, 16, 8, 2, (8, 8, 8), 64, 8, (8, 12, 16), 2)
PLAIN = NetworkConfig("plain", 1, 8, 4, 1, (8, 12, 8), 64, 8, (8, 8), 1)


def _trained(config: NetworkConfig) -> SegmentNetwork:
    """A network whose batch norms have seen something."""
    torch.manual_seed(1)
    network = SegmentNetwork(config)
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.3)
            module.running_var.uniform_(0.5, 2)
            torch.nn.init.normal_(module.weight, 1, 0.2)
            torch.nn.init.normal_(module.bias, 0, 0.2)
    return network.eval()


def _round(features: torch.Tensor, sets: PointTensors, fold: int) -> tuple[torch.Tensor, PointTensors]:
    """Repeat the columns at both ends, as the trained network must be shown a whole turn."""
    _, _, height, width = features.shape
    columns = torch.arange(-SEAM, width + SEAM) % width
    folded = columns[::fold] // fold
    pixels = (torch.arange(height)[:, None] * (width // fold) + folded).ravel()
    return features[..., columns], sets._replace(
        pixel_parents=sets.pixel_parents[:, pixels], pixel_weights=sets.pixel_weights[:, pixels]
    )


@pytest.mark.parametrize("config", [FOLDED, PLAIN], ids=lambda config: config.width)
def test_fused_is_the_same_network(config: NetworkConfig, make_scan) -> None:
    planes = project(make_scan().points, make_scan().intensity).planes[:, :, :256].copy()
    features, sets = stack([network_input(planes, config.fold, 64, circular=True)])
    network = _trained(config)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    with torch.inference_mode():
        wanted = network(*_round(features, sets, config.fold))[0, :, :, SEAM:-SEAM].permute(1, 2, 0)
        found = FusedNetwork(network)(features, sets)
        again = FusedNetwork(network).logits(planes)
    assert found.shape == (64, 256, 19) and found.is_contiguous()
    assert torch.allclose(found, wanted, atol=1e-4)
    assert (found.numpy() == again).all()
    assert all(torch.equal(value, before[name]) for name, value in network.state_dict().items())

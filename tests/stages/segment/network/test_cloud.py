"""The 3-D branch of labelling against the trained one."""

import numpy as np
import torch

from salpcc.stages.segment.network.cloud import Cloud
from salpcc.stages.segment.network.fused import FusedNetwork
from salpcc.stages.segment.network.inputs import as_tensors, cloud_input
from salpcc.stages.segment.network.multimodal import NetworkConfig, SegmentNetwork
from salpcc.stages.segment.network.projection import project


def test_against_the_trained_one(make_scan) -> None:
    config = NetworkConfig("folded", 4, 16, 8, 2, (8, 12, 16), 256, 8, (8, 12), 2)
    torch.manual_seed(1)
    network = SegmentNetwork(config)
    for module in network.points.modules():
        if isinstance(module, torch.nn.BatchNorm1d):
            module.running_mean.normal_(0, 0.3)
            module.running_var.uniform_(0.5, 2)
            torch.nn.init.normal_(module.bias, 0, 0.2)
    points, sets = cloud_input(project(make_scan().points, make_scan().intensity).planes, 4, 256)
    with torch.inference_mode():
        wanted = network.eval().points.first_level(as_tensors(points, sets))[0].numpy()
        found = Cloud(FusedNetwork(network).points).first_level(points, sets).numpy()
    assert found.shape == wanted.shape == (256, 8)
    assert np.allclose(found, wanted, atol=1e-4) and (found > 0).any()

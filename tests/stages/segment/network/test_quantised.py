"""The network in whole numbers says nearly what the trained one says, whatever its weights."""

import numpy as np
import pytest
import torch

from salpcc.stages.segment.network.fused import FusedNetwork
from salpcc.stages.segment.network.inputs import network_input, stack
from salpcc.stages.segment.network.multimodal import NetworkConfig, SegmentNetwork
from salpcc.stages.segment.network.projection import project
from salpcc.stages.segment.network.quantised import QuantisedNetwork, _Bytes, _Spread, _Sums, for_labelling
from salpcc.stages.segment.network.range_image import INTENSITY

SMALL = NetworkConfig("folded", 4, 16, 8, 2, (8, 8, 8), 64, 16, (16, 24, 32), 2)


def _able() -> bool:
    return isinstance(for_labelling(SegmentNetwork(SMALL)), QuantisedNetwork)


needs_vnni = pytest.mark.skipif(not _able(), reason="this CPU adds up no products of bytes: float32 labels")


@pytest.fixture
def seen(make_scan) -> tuple[SegmentNetwork, np.ndarray]:
    """A network whose batch norms know what comes, as training leaves them, and planes."""
    scan = make_scan(stride=1)
    planes = project(scan.points, scan.intensity).planes[:, :, :256].copy()
    planes[:, :, np.arange(256) % 4 > 0] = 0
    torch.manual_seed(1)
    network = SegmentNetwork(SMALL)
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d):
            module.momentum = None
            torch.nn.init.normal_(module.weight, 1, 0.2)
            torch.nn.init.normal_(module.bias, 0, 0.2)
    with torch.inference_mode():
        network.train()(*stack([network_input(planes, SMALL.fold, SMALL.n_points, circular=True)]))
    return network.eval(), planes


@needs_vnni
def test_it_says_what_the_trained_one_says(seen) -> None:
    network, planes = seen
    before = {name: value.clone() for name, value in network.state_dict().items()}
    with torch.inference_mode():
        wanted = FusedNetwork(network).logits(planes)
        found = QuantisedNetwork(network).logits(planes)
    assert found.shape == wanted.shape == (64, 256, 19) and found.dtype == np.float32
    assert np.abs(found - wanted).mean() < 0.1 * wanted.std()
    assert abs((found - wanted).mean()) < 0.02 * wanted.std()
    assert all(torch.equal(value, before[name]) for name, value in network.state_dict().items())


@needs_vnni
@pytest.mark.parametrize("kind", ["avx512_bf16", ""])
def test_the_levels_see_what_shines(seen, monkeypatch, kind: str) -> None:
    """Batch norms know dull surfaces; a bright one, far above what they lead to expect, is not cut off on its way."""
    network, planes = seen
    planes[INTENSITY, :, 64:96] *= 8
    able = torch.cpu.get_capabilities() | {"avx512_bf16": bool(kind), "amx_bf16": False}
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: able)
    features, sets = stack([network_input(planes, SMALL.fold, SMALL.n_points, circular=True)])
    fused, quantised = FusedNetwork(network), QuantisedNetwork(network)
    with torch.inference_mode():
        wanted = fused.fusion(fused.shown(features, sets))
        found = quantised.fusion(quantised.shown(planes)).float()
    steps = wanted.sum((0, 2, 3)) / found.sum((0, 2, 3))
    off = (found * steps[:, None, None] - wanted).abs().amax((0, 2, 3))
    assert (off < 0.05 * wanted.amax((0, 2, 3))).all()


@needs_vnni
@pytest.mark.parametrize("kind", ["avx512_bf16", ""])
def test_it_is_shown_what_the_trained_one_is(seen, monkeypatch, kind: str) -> None:
    """Features and what the points say, folded and laid out at once, in float32 or bfloat16."""
    network, planes = seen
    able = torch.cpu.get_capabilities() | {"avx512_bf16": bool(kind), "amx_bf16": False}
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: able)
    inputs = stack([network_input(planes, SMALL.fold, SMALL.n_points, circular=True)])
    with torch.inference_mode():
        wanted = FusedNetwork(network).shown(*inputs)
        found = QuantisedNetwork(network).shown(planes)
    dtype = torch.bfloat16 if kind else torch.float32
    assert [one.dtype for one in found] == [dtype] * 4
    assert all(torch.equal(one, other.to(dtype)) for one, other in zip(found[:3], wanted[:3], strict=True))
    assert torch.allclose(found[3].float(), wanted[3], rtol=0.01 if kind else 1e-5, atol=1e-5)


@needs_vnni
@pytest.mark.parametrize("side", [1, 3])
@pytest.mark.parametrize("zero", [0, 96])
def test_sums_of_bytes(side: int, zero: int) -> None:
    """A convolution of bytes is that of the numbers they mean, but for rounding; and adds its input."""
    torch.manual_seed(side)
    channels = 8
    image = torch.randint(0, 256, (1, channels, 6, 7), dtype=torch.uint8).to(
        memory_format=torch.channels_last
    )
    step = torch.rand(channels) * 0.1 + 0.01
    source = _Bytes(step, (image.float() - zero).mean((0, 2, 3)) * step, zero)
    numbers = (image.float() - zero) * step[:, None, None]
    weight, bias = torch.randn(channels, channels, side, side) / side, torch.randn(channels)
    wanted = torch.nn.functional.conv2d(numbers, weight, bias, padding=side // 2)
    close = 0.03 * wanted.std()
    target = 4 * step
    each, room = target[:, None, None], 255 * target[:, None, None]
    signed = (_Sums(weight, bias, source, target, 128)(image).float() - 128) * each
    assert ((signed - wanted.maximum(-128 * each).minimum(127 * each)).abs() < close + target.max()).all()
    found = _Sums(weight, bias, source, target)(image).float() * each
    assert ((found - wanted.clamp_min(0).minimum(room)).abs() < close + target.max()).all()
    found = _Sums(weight, bias, source, target).beside(image, 0.25).float() * each
    assert ((found - (wanted + numbers).clamp_min(0).minimum(room)).abs() < close + target.max()).all()


def test_rectified_normal_numbers() -> None:
    torch.manual_seed(0)
    spread = _Spread(torch.tensor([-2.0, 0.0, 1.0]), torch.tensor([1.0, 0.5, 2.0]))
    drawn = (torch.randn(200_000, 3) * spread.deviation + spread.mean).clamp_min(0)
    mean, deviation = spread.rectified()
    assert torch.allclose(mean, drawn.mean(0), atol=0.01)
    assert torch.allclose(deviation, drawn.std(0), atol=0.01)


def test_a_processor_without_products_of_bytes_computes_in_float32(monkeypatch) -> None:
    network = SegmentNetwork(SMALL)
    monkeypatch.delattr(torch.cpu, "get_capabilities", raising=False)  # as in older versions
    assert isinstance(for_labelling(network), FusedNetwork)
    able = {"avx512_vnni": False, "avx_vnni": False, "amx_int8": False}
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: able, raising=False)
    assert isinstance(for_labelling(network), FusedNetwork)

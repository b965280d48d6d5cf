"""Weights of the prediction network in whole numbers, as safetensors."""

from __future__ import annotations

import json
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import cast

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from salpcc.schemas.errors import SalpccError
from salpcc.stages.predict.paper.st_lstm.arithmetic import LARGEST_WEIGHT, ONE, Layer, Trainable
from salpcc.stages.predict.paper.st_lstm.network import Shape

SHIPPED = Path(__file__).parent / "weights" / "st_lstm.safetensors"


def export(numbers: Trainable) -> dict[str, Layer]:
    """Round a trained network to whole numbers, the ones that its rounded form had."""
    layers = {}
    for name in numbers.layers:
        scale = 2.0 ** numbers.bits[name]
        weight = torch.floor(numbers.layer(name).weight.detach().cpu().double() * scale + 0.5)
        bias = torch.floor(cast(Tensor, numbers.layer(name).bias).detach().cpu().double() * scale * ONE + 0.5)
        weight = weight.clamp(-LARGEST_WEIGHT, LARGEST_WEIGHT)
        layers[name] = Layer(weight.float(), bias.float(), numbers.bits[name])
        layers[name].check(name)
    return layers


def save(path: Path, layers: dict[str, Layer], shape: Shape) -> None:
    """Write weights (int16) and biases (int32); sizes and powers of two stand in the metadata."""
    tensors = {}
    for name, layer in layers.items():
        tensors[f"{name}.weight"] = layer.weight.to(torch.int16).contiguous()
        tensors[f"{name}.bias"] = layer.bias.to(torch.int32).contiguous()
    bits = {name: layer.bits for name, layer in layers.items()}
    metadata = {"format": "1", "shape": json.dumps(asdict(shape)), "bits": json.dumps(bits)}
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file(tensors, path, metadata)


def load(path: Path = SHIPPED) -> tuple[dict[str, Layer], Shape]:
    """Read weights; inverse of :func:`save`.

    Raises:
        SalpccError: not a file of this format, or of another network.
    """
    try:
        with safe_open(path, "pt") as stored:
            metadata = stored.metadata() or {}
            if metadata.get("format") != "1":
                raise SalpccError(f"{path}: not weights of this version's prediction network")
            shape = Shape(**json.loads(metadata["shape"]))
            bits = json.loads(metadata["bits"])
            layers = {
                name: Layer(
                    stored.get_tensor(f"{name}.weight").float(),
                    stored.get_tensor(f"{name}.bias").float(),
                    int(bits[name]),
                )
                for name in shape.layers()
            }
    except SalpccError:
        raise
    except Exception as error:
        raise SalpccError(f"{path}: weights of the prediction network cannot be read: {error}") from error
    for name, (outputs, inputs, size) in shape.layers().items():
        if layers[name].weight.shape != (outputs, inputs, size, size):
            raise SalpccError(f"{path}: layer {name} has another size than the network")
    return layers, shape


def digest(layers: dict[str, Layer]) -> bytes:
    """SHA-256 of the whole numbers, whatever file they came from."""
    total = sha256()
    for name, layer in sorted(layers.items()):
        total.update(f"{name}{tuple(layer.weight.shape)}{layer.bits}".encode())
        total.update(layer.weight.to(torch.int16).numpy().tobytes())
        total.update(layer.bias.to(torch.int32).numpy().tobytes())
    return total.digest()

"""Weights of the segmentation network: safetensors whose metadata name the configuration and the data seen."""

from __future__ import annotations

import json
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load as from_bytes
from safetensors.torch import save as to_bytes

from salpcc.schemas.files import atomic
from salpcc.stages.segment.network.multimodal import NetworkConfig, SegmentNetwork
from salpcc.stages.segment.network.quantised import LabellingNetwork, for_labelling
from salpcc.stages.segment.weights_file import WeightsError, read_weights

VERSION = 1
_TUPLES = ("points", "stages")
_LENGTH_BYTES = 8  # a safetensors file starts with the length of its JSON header


def save_weights(
    path: Path, state: dict[str, torch.Tensor], config: NetworkConfig, facts: dict[str, object]
) -> None:
    """Write weights in half precision (counters are left out) with the configuration and ``facts`` beside them."""
    half = {k: v.detach().half().contiguous() for k, v in state.items() if v.is_floating_point()}
    metadata = {
        "version": str(VERSION),
        "config": json.dumps(asdict(config), sort_keys=True),
        "facts": json.dumps(facts, sort_keys=True),
    }
    with atomic(path) as stream:
        stream.write(to_bytes(half, metadata))


def load_weights(path: Path) -> tuple[SegmentNetwork, dict[str, object]]:
    """Read a network and the facts about its training; inverse of :func:`save_weights`.

    Raises:
        WeightsError: missing, damaged, newer than this tool, or not this network's.
    """
    data = read_weights(path)
    try:
        header = json.loads(
            data[_LENGTH_BYTES : _LENGTH_BYTES + int.from_bytes(data[:_LENGTH_BYTES], "little")]
        )
        metadata = header["__metadata__"]
        version, sizes = int(metadata["version"]), json.loads(metadata["config"])
        facts: dict[str, object] = json.loads(metadata["facts"])
    except (KeyError, ValueError, TypeError) as error:
        raise WeightsError(f"{path}: not weights of the segmentation network ({error})") from error
    if version > VERSION:
        raise WeightsError(
            f"{path}: weights version {version} is newer than this tool reads ({VERSION}); update the tool"
        )
    try:
        state = {name: value.float() for name, value in from_bytes(data).items()}
        values: dict[str, Any] = {k: tuple(v) if k in _TUPLES else v for k, v in sizes.items()}
        config = NetworkConfig(**values)
        network = SegmentNetwork(config)
        missing, unexpected = network.load_state_dict(state, strict=False)
    except (SafetensorError, TypeError, RuntimeError) as error:
        raise WeightsError(f"{path}: weights do not fit the network of this version ({error})") from error
    lost = [name for name in missing if not name.endswith("num_batches_tracked")]
    if lost or unexpected:
        odd = (lost + unexpected)[0]
        raise WeightsError(f"{path}: weights do not fit the network of this version ({odd})")
    return network.eval(), facts


@lru_cache(maxsize=2)
def load_cached(path: Path, device: str = "cpu") -> LabellingNetwork:
    """Read a network for labelling, once per process."""
    return for_labelling(load_weights(path)[0], device)

"""The two networks in torch, for training only."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from salpcc.stages.predict.learned.mixture import BITS, SHARED
from salpcc.stages.predict.learned.range_features import LIMIT, SCALE
from salpcc.stages.predict.learned.value_intervals import OUTPUTS, VALUES

if TYPE_CHECKING:
    from salpcc.stages.predict.learned.recipe import Recipe, Rows

_CAP = (LIMIT + 1) / SCALE
_LEVEL_FLOOR = 2.0**-BITS  # every level keeps at least this share of the interval


class _Perceptron(nn.Module):
    """Hidden layers with clipped ReLU; tables of biases for the first layer, one for the last."""

    def __init__(self, sizes: list[int], rows: tuple[int, ...], spread: float) -> None:
        super().__init__()
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        self.tables = nn.ModuleList(nn.Embedding(n, sizes[1]) for n in rows)
        last = f"layers.{len(sizes) - 2}"
        for name, value in self.named_parameters():
            if name.startswith("tables."):
                nn.init.normal_(value, 0.0, 0.02)
            elif name == f"{last}.weight":
                value.data *= spread
            elif name == f"{last}.bias":
                nn.init.zeros_(value)

    def outputs(self, x: Tensor, index: tuple[Tensor, ...]) -> Tensor:
        h: Tensor = self.layers[0](x)
        for table, rows in zip(self.tables, index, strict=True):
            h = h + table(rows)
        for layer in self.layers[1:]:
            h = layer(h.clamp(0, _CAP))
        return h


class RangeNet(_Perceptron):
    """Components of the mixture of :mod:`.mixture` from the features of :mod:`.range_features`."""

    def __init__(self, width: int, layers: int, inputs: int, predictors: int) -> None:
        self.components = predictors + len(SHARED)
        outputs = (3 * self.components + 3) // 4 * 4
        super().__init__([inputs, *[width] * layers, outputs], (64,), 0.1)

    def bits(self, rows: dict[str, Tensor]) -> Tensor:
        """Mean code length in bits."""
        out = self.outputs(rows["x"], (rows["laser"],))
        n = self.components
        logits = functional.log_softmax(out[:, :n], 1)
        offset = out[:, n : 2 * n].clamp(-8, 8)
        inverse = torch.exp(-(out[:, 2 * n : 3 * n] + 2).clamp(-2, 9))
        mu = rows["mu"][:, [*range(n - len(SHARED)), *SHARED]]
        centre = (rows["y"][:, None] - mu) * inverse - offset
        half = rows["step"][:, None] * 0.5 * inverse
        # log(F(c + h) - F(c - h)) without cancellation
        log_mass = (
            functional.logsigmoid(centre + half)
            + functional.logsigmoid(half - centre)
            + torch.log(-torch.expm1(-2 * half))
        )
        probability = torch.exp(torch.logsumexp(logits + log_mass, 1)) + _LEVEL_FLOOR * rows["step"]
        return -torch.log2(probability).mean()


class IntensityNet(_Perceptron):
    """Logits of the 101 values from the features of :mod:`.intensity_features`."""

    def __init__(self, width: int, inputs: int, sides: int) -> None:
        super().__init__([inputs, width, width, OUTPUTS], (64, *[VALUES + 1] * sides), 0.3)
        self.last_table = nn.Embedding(64, OUTPUTS)
        nn.init.zeros_(self.last_table.weight)

    def bits(self, rows: dict[str, Tensor]) -> Tensor:
        """Mean code length in bits; the link is that of ``value_intervals.frequencies``."""
        index = (rows["laser"], *rows["side"].unbind(1))
        out = self.outputs(rows["x"], index) + self.last_table(rows["laser"])
        out = out[:, :VALUES]
        out = out - out.amax(1, keepdim=True).detach()
        frequency = (1 + out / 16).clamp(min=0).pow(16) * 16384 + 1
        chosen = frequency.gather(1, rows["y"][:, None])[:, 0]
        return (torch.log2(frequency.sum(1)) - torch.log2(chosen)).mean()


def _batch(rows: Rows, chosen: np.ndarray) -> dict[str, Tensor]:
    out = {}
    for name, values in rows.items():
        part = torch.from_numpy(np.ascontiguousarray(values[chosen]))
        out[name] = part.float() / SCALE if name == "x" else part
    for name in ("laser", "side"):
        if name in out:
            out[name] = out[name].long()
    out["y"] = out["y"].long() if "side" in out else out["y"].float()
    return out


def fit(kind: str, rows: Rows, recipe: Recipe, log: Callable[[str], None]) -> nn.Module:
    """Train a network of ``kind`` ("ranges" or "intensity") on rows and return it."""
    torch.manual_seed(recipe.seed)
    rng = np.random.default_rng(recipe.seed)
    net: RangeNet | IntensityNet
    if kind == "ranges":
        net, steps, batch, rate = (
            RangeNet(recipe.range_width, recipe.range_layers, rows["x"].shape[1], rows["mu"].shape[1]),
            recipe.optimiser_steps,
            recipe.batch,
            recipe.rate,
        )
    else:
        net, steps, batch, rate = (
            IntensityNet(recipe.intensity_width, rows["x"].shape[1], rows["side"].shape[1]),
            recipe.intensity_steps,
            recipe.intensity_batch,
            recipe.intensity_rate,
        )
    optimiser = torch.optim.AdamW(net.parameters(), lr=rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps, pct_start=0.1)
    running = math.nan
    for step in range(steps):
        loss = net.bits(_batch(rows, rng.integers(0, len(rows["y"]), batch)))
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        value = float(loss.detach())
        running = value if math.isnan(running) else 0.99 * running + 0.01 * value
        if (step + 1) % 500 == 0:
            log(f"{kind}: step {step + 1} of {steps}, {running:.3f} bits")
    return net

"""The runs that a report shows: its own, and those that ``--beside`` adds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

_CODERS = {"ppmd": "PPMd", "context": "context coder"}


@dataclass(frozen=True)
class Run:
    """One run: its configuration (empty where unknown) and figures by sequence and in total."""

    config: Mapping[str, Any]
    sequences: Mapping[str, Mapping[str, Any]]
    total: Mapping[str, Any]

    @property
    def of_paper(self) -> bool:
        """Tell whether it ran the paper's profile."""
        return self.config.get("profile") == "paper"

    @property
    def accuracy(self) -> float:
        """Asked error in metres, 0 for bit-exact; the paper's profile always quantises, to 1 mm if not told."""
        return float(self.config.get("max_error") or (0.001 if self.of_paper else 0.0))

    @property
    def system(self) -> str:
        """Name what coded it."""
        if self.of_paper:
            coder = self.config.get("coder", "ppmd")
            return f"paper grid, {_CODERS.get(coder, coder)}"
        effort = self.config.get("effort", "default")
        return "sensor profile" if effort == "default" else f"sensor profile, {effort}"

    @property
    def label(self) -> str:
        """Name the system and what was asked of it."""
        config = self.config
        # Runs before there were layers dropped what they did not keep, and said nothing of it.
        layered = not self.of_paper and config.get("drop_movable", True) is False
        kept = ", movables kept" if config.get("keep_movable") else ", both layers" if layered else ""
        return f"{self.system}, {accuracy_label(self.accuracy)}{kept}"


def all_runs(report: Mapping[str, Any]) -> list[Run]:
    """The report's own run, then the others; those that measured nothing are left out."""
    own = {"config": report["run"].get("config", {}), **{k: report[k] for k in ("sequences", "total")}}
    found = [own, *report["beside"]]
    return [Run(r["config"], r["sequences"], r["total"]) for r in found if r["total"]["frames"]]


def accuracy_label(metres: float) -> str:
    """Write an asked error."""
    return f"{1e3 * metres:.3g} mm" if metres else "bit-exact"

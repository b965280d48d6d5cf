"""Draw plots as inline SVG: text stays text, so that they are sharp on paper and on a phone."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLOURS = ("#2b5c94", "#e0902f", "#4f9d69", "#8d93a1", "#b5526a", "#6f5aa8", "#3fa7b5", "#a98a3a")
ACCENT = "#c22f3f"
_WIDTH = 5.6  # inches; narrow enough that the text is readable on a phone
_LEGEND_CHARACTERS = 62  # that fit in a line of that width, handles included
_STYLE: Any = {  # rc_context wants its keys as literals
    "svg.fonttype": "none",
    "svg.hashsalt": "salpcc",
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e8ec",
    "axes.axisbelow": True,
    "axes.edgecolor": "#9aa0aa",
    "legend.frameon": False,
}


@dataclass(frozen=True)
class Plot:
    """One drawing: its title, a sentence that says what to see, and the SVG."""

    title: str
    caption: str
    svg: str


@contextmanager
def drawing(height: float) -> Iterator[tuple[Axes, list[str]]]:
    """Give axes of ``height`` inches to draw on; the list holds the SVG once the block is left."""
    svg: list[str] = []
    with rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH, height), layout="constrained")
        yield figure.add_subplot(), svg
        svg.append(_to_svg(figure))


def legend(axes: Axes) -> None:
    """Set the legend above the axes, where it covers nothing, in as many columns as fit."""
    handles, labels = axes.get_legend_handles_labels()
    figure = axes.get_figure()
    if not handles or not isinstance(figure, Figure):
        return
    columns = max(1, _LEGEND_CHARACTERS // (6 + max(map(len, labels))))
    figure.legend(handles, labels, loc="outside upper left", ncols=min(columns, len(labels)), fontsize=9)


def _to_svg(figure: Figure) -> str:
    """Give the SVG element alone, without a fixed size, so that the page scales it."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    return re.sub(r'(<svg[^>]*?) width="[^"]*"| height="[^"]*pt"', r"\1", svg, count=2)

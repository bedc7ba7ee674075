"""Common style of all figures: colours, font sizes, creation and saving.

Figures do not use pyplot. They therefore need no display, share no state and never open a window.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axis import Tick
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import ScalarFormatter

from hdsp.base.files import replacing, writable_file
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.palette import (  # noqa: F401, figures take their colours from here
    BLACK,
    BLUE,
    FEET,
    GOAL,
    GREEN,
    GREY,
    HEIGHT_COLORS,
    ORANGE,
    PURPLE,
    SKY,
    START,
    UNKNOWN,
    VERMILLION,
    YELLOW,
)

METHODS = {
    "trained": BLUE,
    "shipped": GREEN,
    "shipped-klamt2019": PURPLE,
    "manual": ORANGE,
    "flat": GREY,
    "geometric": BLACK,
}
NAMES = {
    "trained": "trained",
    "shipped": "shipped",
    "shipped-klamt2019": "paper's network",
    "manual": "manually tuned",
    "flat": "flat ground",
    "geometric": "geometric",
}
HEIGHTS = LinearSegmentedColormap.from_list("heights", list(HEIGHT_COLORS)).with_extremes(bad=UNKNOWN)

_DPI = 130
_TYPE = 9
_FLOOR = -0.5, 1.5  # m; the median height of ground whose floor is at 0


class PlainFigure(Figure):
    """A figure whose texts are no formulas: names of files and tasks may have a ``$``.

    Numbers at the axes stay as they are, because those of a logarithmic axis are formulas.
    """

    def draw(self, renderer: Any) -> None:
        numbers = {label for tick in self.findobj(Tick) for label in (tick.label1, tick.label2)}
        for text in self.findobj(Text):
            if text not in numbers:
                text.set_parse_math(False)
        super().draw(renderer)


def figure(width: float, height: float) -> Figure:
    """Makes an empty figure; width and height in inches."""
    made = PlainFigure(figsize=(width, height), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(made)
    return made


def save(made: Figure, path: str | os.PathLike) -> Path:
    """Writes the figure as PNG, whole or not at all.

    Raises:
        InputError: if the path is not writable, or has another suffix than .png.
    """
    writable_file(path, "picture", (".png",))
    with replacing(path) as temporary:
        made.savefig(temporary, format="png", facecolor="white")
    return Path(path)


def quiet(axes, grid: str | None = "y") -> None:
    """Removes visual noise: upper and right frame, strong grid lines, large font."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=_TYPE - 1)
    axes.xaxis.label.set_size(_TYPE)
    axes.yaxis.label.set_size(_TYPE)
    axes.title.set_size(_TYPE + 1)
    if grid:
        axes.grid(axis=grid, color="#DDDDDD", linewidth=0.6)
        axes.set_axisbelow(True)


def ground_level(heights: np.ndarray) -> float:
    """Returns the height (m) that pictures of patches and scans count as floor: 0, or the lowest ground far from 0."""
    known = heights[np.isfinite(heights)]
    if not known.size or _FLOOR[0] <= np.median(known) <= _FLOOR[1]:
        return 0.0
    return float(np.quantile(known, 0.01))


def draw_terrain(axes, terrain: HeightMap, lowest: float | None = None, highest: float | None = None):
    """Draws heights in metres with darkened edges; returns the image for a colour bar.

    Convention: x to the right, y up, equal scales, world coordinates of the map. Unknown cells are pink.
    """
    (x, y), (length, width) = terrain.origin, terrain.size
    known = terrain.heights[np.isfinite(terrain.heights)]
    ground = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    lowest = ground[0] if lowest is None else lowest
    highest = max(ground[1] if highest is None else highest, lowest + 0.1)
    placed = {"origin": "lower", "extent": (x, x + length, y, y + width), "interpolation": "nearest"}
    image = axes.imshow(terrain.heights.T, cmap=HEIGHTS, vmin=lowest, vmax=highest, **placed)
    # All edges are darkened, in every direction. Low edges matter to the robot, but their height alone is not visible.
    heights = np.nan_to_num(terrain.heights.T, nan=ground[0])
    rise = np.hypot(*np.gradient(heights)) if min(terrain.shape) > 1 else np.zeros((1, 1))
    darker = np.zeros((*rise.shape, 4))
    darker[..., 3] = 0.5 * (1 - np.exp(-rise / 0.03))
    axes.imshow(darker, **placed)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=_TYPE - 1)
    for axis in (axes.xaxis, axes.yaxis):
        numbers = axis.get_major_formatter()
        if isinstance(numbers, ScalarFormatter):  # whole projected coordinates, no offset at the end of the axis
            numbers.set_useOffset(False)
            numbers.set_scientific(False)
    return image

"""Figures of arenas: rendering, true and scanned height map; and of the courses behind the simulated patches."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.robot.lattice import PATCH_CELLS, metres
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.robot_drawing import draw_pose
from hdsp.viz.style import BLACK, BLUE, GOAL, GREEN, ORANGE, PURPLE, SKY, START, VERMILLION, draw_terrain, figure, save

_PLACES = {
    "door": VERMILLION, "stairs": BLUE, "ramp": GREEN, "platform": PURPLE, "clutter": ORANGE, "open": SKY,
}  # fmt: skip


def save_arena(
    picture: np.ndarray | None,
    scanned: HeightMap,
    true: HeightMap,
    tasks: Mapping[str, tuple],
    path: str | os.PathLike,
) -> Path:
    """Draws an arena: rendering, scanned map with start and goals, and map error.

    Args:
        picture: uint8 [height, width, 3]; None = no rendering.
        scanned, true: height maps with the same cells.
        tasks: (start, goal) by name; poses (x, y, theta) in m and rad.
        path: PNG path.
    """
    panels = 3 if picture is not None else 2
    made = figure(5.2 * panels, 5.0)
    axes = list(made.subplots(1, panels))
    if picture is not None:
        first = axes.pop(0)
        first.imshow(picture)
        first.axis("off")
        first.set_title("the arena", fontsize=10)
    _draw_tasks(made, axes[0], scanned, tasks)
    axes[0].set_title("scanned height map, start and goals", fontsize=10)
    _draw_error(made, axes[1], scanned, true)
    axes[1].set_title("scanned minus true", fontsize=10)
    return save(made, path)


def save_courses(
    maps: Sequence[HeightMap],
    starts: Sequence[Sequence[tuple[str, float, float, float]]],
    path: str | os.PathLike,
    columns: int = 5,
) -> Path:
    """Draws scanned courses with the outlines of their patches.

    Args:
        maps: one height map per course.
        starts: for each course and patch: kind, and start pose (x, y, theta); m, m, rad.
        path: PNG path.
        columns: number of columns in the figure.
    """
    rows = max(math.ceil(len(maps) / columns), 1)
    made = figure(3.0 * columns, 3.0 * rows + 0.4)
    shown: dict[str, Any] = {}
    for number, axes in enumerate(np.ravel(made.subplots(rows, columns, squeeze=False))):
        axes.axis("off")
        if number >= len(maps):
            continue
        draw_terrain(axes, maps[number], 0.0, 1.2)
        axes.set_xlim(maps[number].origin[0], maps[number].origin[0] + maps[number].size[0])
        axes.set_ylim(maps[number].origin[1], maps[number].origin[1] + maps[number].size[1])
        for kind, x, y, theta in starts[number]:
            shown[kind] = _draw_patch(axes, x, y, theta, _PLACES.get(kind, BLACK))
    made.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    return save(made, path)


def save_note(text: str, path: str | os.PathLike) -> Path:
    """Saves a text in place of a figure, for example the reason why there is none."""
    made = figure(6.0, 1.5)
    made.text(0.5, 0.5, text, ha="center", va="center", fontsize=9, wrap=True)
    return save(made, path)


def _draw_tasks(made, axes, scanned: HeightMap, tasks: Mapping[str, tuple]) -> None:
    image = draw_terrain(axes, scanned)
    for name, (start, goal) in tasks.items():
        draw_pose(axes, start, START)
        draw_pose(axes, goal, GOAL)
        axes.annotate(name, goal[:2], (6, -9), textcoords="offset points", color=GOAL, fontsize=9, fontweight="bold")
    made.colorbar(image, ax=axes, shrink=0.7, pad=0.02).set_label("height (m)", fontsize=9)


def _draw_error(made, axes, scanned: HeightMap, true: HeightMap) -> None:
    (x, y), (length, width) = true.origin, true.size
    image = axes.imshow(
        1000 * (scanned.heights - true.heights).T, cmap="RdBu_r", vmin=-30, vmax=30, origin="lower",
        extent=(x, x + length, y, y + width), interpolation="nearest",
    )  # fmt: skip
    axes.set_facecolor(BLACK)
    axes.tick_params(labelsize=8)
    bar = made.colorbar(image, ax=axes, shrink=0.7, pad=0.02, extend="both")
    bar.set_label("error (mm); unknown cells are black", fontsize=9)


def _draw_patch(axes, x: float, y: float, theta: float, color: str):
    """Outlines the patch around a start and marks the heading; returns the line for a legend."""
    c, s = math.cos(theta), math.sin(theta)
    half = metres(PATCH_CELLS) / 2
    corners = half * np.array([(1, 1), (1, -1), (-1, -1), (-1, 1), (1, 1)])
    (line,) = axes.plot(x + corners @ (c, -s), y + corners @ (s, c), color=color, linewidth=0.8)
    axes.annotate(
        "", (x + 0.3 * c, y + 0.3 * s), (x - 0.3 * c, y - 0.3 * s),
        arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.4, "mutation_scale": 8},
    )  # fmt: skip
    return line

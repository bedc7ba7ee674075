"""The robot from above: base, heading and feet for a detailed state."""

from __future__ import annotations

import numpy as np
from matplotlib.patches import Polygon

from hdsp.robot.lattice import rotation
from hdsp.robot.robot import Robot
from hdsp.viz.style import BLACK, FEET


def draw_robot(axes, state, robot: Robot, color: str = BLACK, alpha: float = 1.0, feet: bool = True) -> None:
    """Draws the base as an outline with a pointed front, and the feet in their colours.

    Args:
        axes: matplotlib axes in world metres.
        state: detailed state [7].
        robot: the robot.
        color: colour of the base.
        alpha: opacity.
        feet: whether to draw the feet.
    """
    state = np.asarray(state, float)
    boxes = robot.body.boxes
    x_min, x_max = min(box.x_min for box in boxes), max(box.x_max for box in boxes)
    half = 0.7 * robot.feet.neutral_y
    outline = np.array(
        [(x_min, -half), (x_max * 0.75, -half), (x_max, 0), (x_max * 0.75, half), (x_min, half)]
    )  # pointed front
    turned = outline @ rotation(float(state[2])).T + state[:2]
    axes.add_patch(Polygon(turned, closed=True, fill=False, edgecolor=color, linewidth=1.2, alpha=alpha, zorder=5))
    if feet:
        places = robot.foot_positions(state)
        look = {"s": 16, "c": FEET, "marker": "s", "edgecolors": color, "linewidths": 0.6, "alpha": alpha}
        axes.scatter(*places.T, zorder=6, **look)


def draw_body(axes, state, robot: Robot, color: str, alpha: float = 0.15) -> None:
    """Draws the areas under the boxes of the body for a detailed state [7], in full size."""
    state = np.asarray(state, float)
    for box in robot.body.boxes:
        low, high, half = box.x_min, box.x_max, box.half_width
        corners = np.array([(low, -half), (high, -half), (high, half), (low, half)])
        turned = corners @ rotation(float(state[2])).T + state[:2]
        axes.add_patch(Polygon(turned, closed=True, facecolor=color, edgecolor="none", alpha=alpha, zorder=4))


def draw_pose(axes, pose, color: str, length: float = 0.45, label: str | None = None) -> None:
    """Draws a pose (x, y, theta) as an arrow from its position."""
    x, y, theta = (float(value) for value in pose[:3])
    tip = (x + length * np.cos(theta), y + length * np.sin(theta))
    arrow = {"arrowstyle": "-|>", "color": color, "linewidth": 2.2, "mutation_scale": 14, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, (x, y), arrowprops=arrow, zorder=8)
    axes.plot(x, y, "o", color=color, markersize=5, zorder=8, label=label)

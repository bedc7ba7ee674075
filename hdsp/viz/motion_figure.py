"""A motion from the side: ground profile, robot at several moments, and foot trajectories."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.messages import shown
from hdsp.base.scalars import integer
from hdsp.detailed.motion.motion import Motion
from hdsp.robot.robot import FEET as FOOT_NAMES
from hdsp.viz.style import BLACK, FEET, GREY, VERMILLION, figure, quiet, save

_DEPTH = 0.12  # m; drawn thickness of the ground
_MOST_MOMENTS = 30
_BODY = 0.22  # m; drawn height of the base above the hips


def save_motion(motion: Motion, path: str | os.PathLike, moments: int = 6, title: str | None = None) -> Path:
    """Draws a motion as a strip: base and feet over the ground, seen from the right of the start pose.

    The upper panel shows the trajectories of the feet and the base. The panels below show the robot at several moments;
    the legs on its left side are thinner.

    Args:
        motion: the motion.
        path: PNG path.
        moments: number of moments, 2 to 30.
        title: figure title.

    Raises:
        InputError: another number of moments, or a path that cannot be written.
    """
    if (count := integer(moments)) is None or not 2 <= count <= _MOST_MOMENTS:
        raise InputError(f"moments {shown(moments)}; need a whole number from 2 to {_MOST_MOMENTS}")
    moments = count
    along = _along(motion)
    made = figure(9.0, 1.9 + 1.7 * -(-moments // 3))
    grid = made.add_gridspec(1 + -(-moments // 3), 3)
    chosen = _moments(motion, moments)
    _ways(made.add_subplot(grid[0, :]), motion, along, chosen)
    for number, row in enumerate(chosen):
        _moment(made.add_subplot(grid[1 + number // 3, number % 3]), motion, along, row, number + 1)
    made.suptitle(title or "", fontsize=10)
    handles, labels = made.axes[0].get_legend_handles_labels()
    made.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    return save(made, path)


def motion_profile(motion: Motion):
    """Draws the trajectories of base and feet over the ground, from the side, as a matplotlib figure."""
    made = figure(7.0, 3.0)
    axes = made.subplots()
    _ways(axes, motion, _along(motion), _moments(motion, 2))
    made.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return made


def _along(motion: Motion) -> np.ndarray:
    """Horizontal axis of the figure, a unit vector [2]: from the start to the base's farthest position."""
    way = motion.base[:, :2] - motion.base[0, :2]
    farthest = way[np.argmax(np.hypot(*way.T))]
    length = np.hypot(*farthest)
    return farthest / length if length > 0 else np.array([1.0, 0.0])


def _ground(axes, motion: Motion, along: np.ndarray) -> tuple[float, float]:
    """Draws the ground under the base's straight line; returns its range (m along the horizontal axis)."""
    at = (motion.feet[..., :2] @ along).ravel()
    low, high = at.min() - 0.4, at.max() + 0.4
    s = np.linspace(low, high, int((high - low) / motion.terrain.resolution * 4))
    aside = np.array([-along[1], along[0]])
    places = s[:, None] * along + (motion.base[0, :2] @ aside) * aside
    heights = np.asarray(motion.terrain.height_at(places[:, 0], places[:, 1]), float)
    known = np.isfinite(heights)
    heights = np.interp(s, s[known], heights[known]) if known.any() else np.full(len(s), motion.feet[..., 2].min())
    axes.fill_between(s, heights, heights.min() - _DEPTH, color="#CFCBBE", step="mid", zorder=1, linewidth=0)
    axes.plot(s, heights, color="#6B6455", linewidth=1.0, zorder=2)
    return low, high


def _ways(axes, motion: Motion, along: np.ndarray, chosen: np.ndarray) -> None:
    low, high = _ground(axes, motion, along)
    axes.plot(motion.base[:, :2] @ along, motion.base[:, 2], color=BLACK, linewidth=1.4, label="base", zorder=4)
    for foot, color in enumerate(FEET):
        s, z = motion.feet[:, foot, :2] @ along, motion.feet[:, foot, 2]
        axes.plot(s, z, color=color, linewidth=1.6, zorder=5 + foot, label=FOOT_NAMES[foot].replace("_", " ") + " foot")
    for number, row in enumerate(chosen, start=1):
        at = motion.base[row, :2] @ along, motion.base[row, 2] + 0.06
        axes.text(*at, str(number), fontsize=8, ha="center", va="bottom", zorder=9)
    axes.set_xlim(low, high)
    axes.set_ylim(top=motion.base[:, 2].max() + 0.3)
    axes.set_aspect("equal")
    axes.set_ylabel("height (m)")
    axes.set_xlabel("along the way (m)")
    quiet(axes)


def _moments(motion: Motion, count: int) -> np.ndarray:
    """Rows of the drawn configurations: start, goal, and evenly spread step middles."""
    swinging = np.flatnonzero((~motion.carries).any(axis=1) & (motion.phase == 3))
    if not len(swinging):
        return np.linspace(0, len(motion) - 1, count).astype(int)
    steps = np.split(swinging, np.flatnonzero(np.diff(swinging) > 1) + 1)
    picked = np.unique(np.linspace(0, len(steps) - 1, count - 2).astype(int))
    middles = [int(steps[k][len(steps[k]) // 2]) for k in picked]
    return np.array([0, *middles, len(motion) - 1])


def _moment(axes, motion: Motion, along: np.ndarray, row: int, number: int) -> None:
    _ground(axes, motion, along)
    base, feet = motion.base[row], motion.feet[row]
    turned = motion.rotations()[row]
    hips = base[:3] + motion.robot.hips() @ turned.T
    for foot in (0, 1, 3, 2):  # the right side is nearer to the viewer
        s, z = [hips[foot, :2] @ along, feet[foot, :2] @ along], [hips[foot, 2], feet[foot, 2]]
        right = foot in (2, 3)
        lifted = not motion.carries[row, foot]
        axes.plot(s, z, color=BLACK if right else GREY, linewidth=2.2 if right else 1.2, zorder=5 + right)
        edge = VERMILLION if lifted else BLACK
        axes.plot(
            s[1], z[1], "o", color=FEET[foot], markersize=8, zorder=7 + right, markeredgecolor=edge,
            markeredgewidth=1.8 if lifted else 0.8,
        )  # fmt: skip
    box = motion.robot.body.boxes[-1]
    nose = motion.robot.body.boxes[0].x_max
    outline = np.array([(-nose, 0, 0), (nose, 0, 0), (box.x_max, 0, _BODY / 2), (nose, 0, _BODY), (-nose, 0, _BODY)])
    corners = base[:3] + outline @ turned.T
    axes.fill(corners[:, :2] @ along, corners[:, 2], facecolor="#E4E4E4", edgecolor=BLACK, linewidth=1.2, zorder=4)
    mass = motion.centers_of_mass()[row]
    axes.plot(mass[:2] @ along, mass[2], "+", color=BLACK, markersize=7, zorder=9)
    middle = base[:2] @ along
    axes.set_xlim(middle - 0.95, middle + 0.95)
    axes.set_ylim(base[2] - 1.15, base[2] + 0.35)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    swinging = [FOOT_NAMES[i].replace("_", " ") for i in np.flatnonzero(~motion.carries[row])]
    axes.set_title(f"{number}: " + (f"{swinging[0]} foot swings" if swinging else "on four feet"), fontsize=8)

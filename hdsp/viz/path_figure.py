"""Planned paths on their height map."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.patheffects import withStroke

from hdsp.base.errors import InputError
from hdsp.detailed.actions.action import Action
from hdsp.robot.robot import FEET as FOOT_NAMES
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.failure_marks import Failure
from hdsp.viz.robot_drawing import draw_body, draw_pose, draw_robot
from hdsp.viz.style import (
    BLACK,
    BLUE,
    FEET,
    GOAL,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    START,
    UNKNOWN,
    VERMILLION,
    draw_terrain,
    figure,
    save,
)

_TRACKS = (VERMILLION, BLUE, GREEN, PURPLE, ORANGE, SKY, BLACK)


class DrawnPath(NamedTuple):
    """A path to draw.

    Attributes:
        states: float [n, 7] in world coordinates; [0, 7] without a path.
        actions: the n - 1 actions between the states.
        cost: cost, unitless.
    """

    states: np.ndarray
    actions: Sequence[Action]
    cost: float


def save_planned_path(
    terrain: HeightMap,
    states: np.ndarray,
    actions: Sequence[Action],
    robot: Robot,
    path: str | os.PathLike,
    title: str | None = None,
    start=None,
    goal=None,
    failure: Failure | None = None,
) -> Path:
    """Draws a plan: base and foot tracks, the robot at intervals, steps, start and goal.

    Args:
        terrain: the map of the plan.
        states: float [n, 7] in world coordinates. Without states (no plan was found), only map, start and goal are
            drawn.
        actions: the n - 1 actions between the states.
        robot: the plan's robot.
        path: PNG path.
        title: figure title.
        start: pose (x, y, theta) in m and rad; default: the plan's first state.
        goal: pose (x, y, theta) in m and rad; default: the plan's last state.
        failure: causes and the area in reach, if no plan was found.

    Raises:
        InputError: if there is neither a path nor a start to draw.
    """
    return save(planned_path_figure(terrain, states, actions, robot, title, start, goal, failure), path)


def planned_path_figure(
    terrain: HeightMap,
    states: np.ndarray,
    actions: Sequence[Action],
    robot: Robot,
    title: str | None = None,
    start=None,
    goal=None,
    failure: Failure | None = None,
):
    """Draws a plan as a matplotlib figure; see `save_planned_path` for the arguments."""
    start = states[0] if start is None and len(states) else start
    goal = states[-1] if goal is None and len(states) else goal
    if start is None:
        raise InputError("picture of a path: the plan has no states; give start and goal to draw the map with these")
    length, width = terrain.size
    wide, high = _page(length, width)
    # Each cause takes a line in the legend.
    made = figure(max(wide, 6.5) if failure else wide, high + 0.18 * (len(failure.marks) + 5 if failure else 0))
    axes = made.subplots()
    image = draw_terrain(axes, terrain)
    if failure is not None:
        _draw_failure(axes, terrain, robot, failure)
    if len(states):
        draw_path(axes, states, actions, robot)
    draw_pose(axes, start, START, label="start")
    if goal is not None:
        draw_pose(axes, goal, GOAL, label="goal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_title(title or "", fontsize=10)
    bar = made.colorbar(image, ax=axes, shrink=0.6, pad=0.02)
    bar.set_label("height (m)", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    columns = 1 if failure else 4
    made.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=columns, fontsize=8, frameon=False)
    return made


def _draw_failure(axes, terrain: HeightMap, robot: Robot, failure: Failure) -> None:
    """Draws the area in reach, numbered causes and the nearest pose in reach; the legend has the words."""
    (x, y), (length, width) = terrain.origin, terrain.size
    if failure.reached is not None:
        shade = np.zeros((*failure.reached.T.shape, 4))
        shade[failure.reached.T] = to_rgba(SKY, 0.45)
        axes.imshow(shade, origin="lower", extent=(x, x + length, y, y + width), interpolation="nearest", zorder=2)
        axes.plot([], [], "s", color=SKY, alpha=0.45, markersize=9, label="base positions in reach")
    if np.isnan(terrain.heights).any():
        axes.plot([], [], "s", color=UNKNOWN, markersize=9, label="unknown ground")
    if failure.nearest is not None:
        draw_robot(axes, failure.nearest, robot, GREEN)
        away = f"nearest pose reached, {failure.distance:.2f} m from the goal"
        axes.plot(*failure.nearest[:2], "^", color=GREEN, markersize=7, zorder=8, label=away)
    poses = list(dict.fromkeys(mark.pose for mark in failure.marks if mark.pose is not None))
    for pose in poses:
        draw_robot(axes, pose, robot, VERMILLION)
        draw_body(axes, pose, robot, VERMILLION)
    if poses:
        axes.plot([], [], "s", color=VERMILLION, alpha=0.35, markersize=9, label="pose that is not possible")
    halo = [withStroke(linewidth=2.5, foreground="white")]
    for number, mark in enumerate(failure.marks, 1):
        look = {"color": "none", "markeredgecolor": BLACK, "markersize": 11, "markeredgewidth": 1.8, "zorder": 10}
        label = f"{number}  {mark.label} at ({mark.place[0]:.2f}, {mark.place[1]:.2f}) m"
        axes.plot(*mark.place, marker="o", linestyle="none", label=label, path_effects=halo, **look)
        # Causes are often neighbours; the numbers go around them.
        angle = np.pi / 4 + (number - 1) * 2 * np.pi / max(len(failure.marks), 4)
        axes.annotate(
            str(number), mark.place, (13 * np.cos(angle), 13 * np.sin(angle)), textcoords="offset points", fontsize=11,
            fontweight="bold", ha="center", va="center", zorder=11, path_effects=halo,
        )  # fmt: skip


def save_planned_paths(
    terrain: HeightMap,
    paths: Mapping[str, DrawnPath],
    tasks: Mapping[str, tuple],
    robot: Robot,
    path: str | os.PathLike,
    title: str | None = None,
) -> Path:
    """Draws the plans for several tasks on one map, each in its own colour: base tracks, step landings, goals.

    Args:
        terrain: the map of the plans.
        paths: paths by task name; the legend names tasks without a path.
        tasks: (start, goal) by name; poses (x, y, theta) in m and rad.
        robot: the plans' robot.
        path: PNG path.
        title: figure title.

    Raises:
        InputError: if there is no task.
    """
    if not tasks:
        raise InputError("picture of paths: there is no task")
    made = figure(*_page(*terrain.size))
    axes = made.subplots()
    image = draw_terrain(axes, terrain)
    for number, (name, (start, goal)) in enumerate(tasks.items()):
        color = _TRACKS[number % len(_TRACKS)]
        states, actions, cost = paths[name]
        label = f"{name}: cost {cost:.2f}" if len(states) else f"{name}: no path"
        # A small offset separates paths over the same ground.
        axes.plot(*(states[:, :2].T + 0.012 * (number % 3 - 1)), color=color, linewidth=1.8, zorder=4, label=label)
        feet = robot.foot_positions(states)
        for index, action in enumerate(actions):
            if (foot := action.stepping_foot) is not None:
                axes.plot(*feet[index + 1, foot], "*", color=color, markersize=6, markeredgewidth=0, zorder=7)
        if len(states):
            draw_robot(axes, states[-1], robot, color)
        draw_pose(axes, start, START)
        draw_pose(axes, goal, color)
        axes.annotate(
            name, goal[:2], (22, -8), textcoords="offset points", color=color, fontsize=10, fontweight="bold", zorder=9
        )
    axes.plot([], [], "*", color=BLACK, label="landing of a step", linestyle="none")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_title(title or "", fontsize=10)
    made.colorbar(image, ax=axes, shrink=0.6, pad=0.02).set_label("height (m)", fontsize=9)
    made.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return save(made, path)


def draw_path(axes, states: np.ndarray, actions: Sequence[Action], robot: Robot, spacing: float = 0.6) -> None:
    """Draws a path, detailed states [n, 7] with n - 1 actions, on axes in world metres.

    The robot is drawn about every `spacing` metres of the path and before each group of steps. A half turn counts like
    `spacing` metres.
    """
    feet = robot.foot_positions(states)
    for foot, (color, name) in enumerate(zip(FEET, FOOT_NAMES, strict=True)):
        axes.plot(*feet[:, foot].T, color=color, linewidth=0.8, zorder=3, label=name.replace("_", " ") + " foot")
    axes.plot(states[:, 0], states[:, 1], color=BLACK, linewidth=1.8, zorder=4, label="base")
    for index in _shown(states, actions, spacing):
        draw_robot(axes, states[index], robot, GREY)
    draw_robot(axes, states[-1], robot)

    stepped = False
    for index, action in enumerate(actions):
        stepping = action.stepping_foot
        if stepping is None:
            continue
        (x0, y0), (x1, y1) = feet[index, stepping], feet[index + 1, stepping]
        axes.annotate(
            "", (x1, y1), (x0, y0), zorder=7,
            arrowprops={"arrowstyle": "-|>", "color": VERMILLION, "linewidth": 1.2, "mutation_scale": 8,
                        "shrinkA": 0, "shrinkB": 0, "connectionstyle": "arc3,rad=-0.3"},
        )  # fmt: skip
        look = {"color": VERMILLION, "markersize": 8, "markeredgewidth": 0, "linestyle": "none", "zorder": 7}
        axes.plot(x1, y1, "*", label=None if stepped else "step (landing)", **look)
        stepped = True


def _shown(states: np.ndarray, actions: Sequence[Action], spacing: float) -> list[int]:
    """Indices of states at which the robot is drawn."""
    moved = np.hypot(*np.diff(states[:, :2], axis=0).T)
    turned = np.abs(np.angle(np.exp(1j * np.diff(states[:, 2])))) * (spacing / np.pi)
    way = np.concatenate([[0.0], np.cumsum(moved + turned)])
    chosen, last, since_step = [0], 0.0, np.inf
    for index in range(1, len(states) - 1):
        is_step = actions[index].stepping_foot is not None
        begins = is_step and since_step > spacing / 2
        since_step = 0.0 if is_step else since_step + way[index] - way[index - 1]
        if (begins or way[index] - last >= spacing) and way[-1] - way[index] > spacing / 2:
            chosen.append(index)
            last = way[index]
    return chosen


def _page(length: float, width: float) -> tuple[float, float]:
    """Figure size in inches for a map size in metres: 7 in for the longer side, plus space for bar and legend."""
    scale = 7 / max(length, width)
    return max(length * scale, 3.5) + 1.4, max(width * scale, 2.5) + 1.2

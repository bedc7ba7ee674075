"""Example patches with task labels and predictions."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Patch, Rectangle

from hdsp.base.errors import InputError
from hdsp.labels.tasks import TaskSet
from hdsp.robot.lattice import PATCH_CENTER, abstract_steps_to_world
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.robot_drawing import draw_pose, draw_robot
from hdsp.viz.style import GOAL, GREY, SKY, START, UNKNOWN, VERMILLION, YELLOW, draw_terrain, figure, ground_level, save

#: Colour and meaning of a task by (feasible by label, feasible by prediction).
JUDGEMENTS = {
    (True, True): (SKY, "both feasible"),
    (False, False): ("#DDDDDD", "both infeasible"),
    (False, True): (VERMILLION, "wrongly judged feasible"),
    (True, False): (YELLOW, "wrongly judged infeasible"),
}


def save_example_patches(
    tasks: TaskSet,
    judged: tuple[np.ndarray, np.ndarray],
    path: str | os.PathLike,
    count: int = 6,
    robot: Robot | str = "momaro",
) -> Path:
    """Draws patches with labels and predictions for their 22 tasks.

    Each example has two panels. The first panel shows the patch, the robot at its start, and dots at the goals. The
    second panel has one field per task at its goal position, with the label's cost above the predicted cost.

    Args:
        tasks: labelled tasks.
        judged: predictions, feasible bool [n, 22] and cost [n, 22], as from `hdsp.labels.evaluation.predict`.
        path: PNG path.
        count: number of examples, spread over the set.
        robot: the robot to draw, or an argument for `Robot.load`.

    Raises:
        InputError: if there are no tasks, or count is not positive.
    """
    if len(tasks) == 0 or count < 1:
        raise InputError(f"example patches: {count} of {len(tasks)} maps asked for, need at least 1 of 1")
    robot = Robot.load(robot)
    chosen = spread(tasks, count)
    columns = min(2, len(chosen))
    lines = -(-len(chosen) // columns)
    made = figure(6.9 * columns, 3.5 * lines + 0.5)
    grid = made.subplots(lines, 2 * columns, squeeze=False).reshape(-1, 2)
    images = []
    patches = [_above_floor(tasks.heights[index]) for index in chosen]
    highest = max(float(np.nanmax(patches, initial=0.0)), 0.1)
    for (left, right), index, heights in zip(grid, chosen, patches, strict=False):
        images.append(_draw_patch(left, heights, tasks.goals[index], robot, min(highest, 1.5)))
        left.set_title(f"{tasks.category[index]}, no. {tasks.index[index]}", fontsize=9)
        _draw_tasks(right, tasks, judged, index)
    for unused in grid[len(chosen) :].flat:
        unused.set_axis_off()
    layout = made.get_layout_engine()
    assert isinstance(layout, ConstrainedLayoutEngine)
    layout.set(h_pad=0.12, w_pad=0.08)
    bar = made.colorbar(images[-1], ax=grid.ravel().tolist(), shrink=0.5, pad=0.01, extend="max")
    bar.set_label("height (m)", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    legend = [Patch(facecolor=color, edgecolor=GREY, label=meaning) for color, meaning in JUDGEMENTS.values()]
    if np.isnan(tasks.heights[chosen]).any():
        legend.append(Patch(facecolor=UNKNOWN, edgecolor=GREY, label="unknown ground"))
    made.legend(handles=legend, loc="outside lower center", ncols=5, fontsize=9, frameon=False)
    return save(made, path)


def label_figure(tasks: TaskSet, count: int = 4):
    """Draws patches in the robot frame as a matplotlib figure; dots mark goals ahead, aside and behind by their label.

    Args:
        tasks: labelled tasks; without any, the figure says so.
        count: largest number of patches.
    """
    chosen = spread(tasks, count) if len(tasks) else np.empty(0, int)
    made = figure(0.4 + 1.6 * max(len(chosen), 2), 2.3)
    if not len(chosen):
        made.text(0.5, 0.5, "no maps", ha="center", color=GREY)
        return made
    patches = [_above_floor(tasks.heights[index]) for index in chosen]
    highest = min(max(float(np.nanmax(patches, initial=0.0)), 0.1), 1.5)
    for axes, index, heights in zip(made.subplots(1, len(chosen), squeeze=False)[0], chosen, patches, strict=True):
        draw_terrain(axes, HeightMap(heights).crop_cells(PATCH_CENTER, PATCH_CENTER, 0), 0.0, highest)
        draw_pose(axes, (0, 0, 0), START, length=0.3)
        goals = tasks.goals[index]
        moves, places = goals[:, 2] == 0, abstract_steps_to_world(goals)[:, :2]
        for feasible, color, label in ((True, SKY, "feasible"), (False, VERMILLION, "infeasible")):
            shown = moves & (tasks.feasible[index] == feasible)
            axes.plot(*places[shown].T, ".", color=color, markersize=5, zorder=9, label=label)
        axes.set_title(f"{tasks.category[index]}, no. {tasks.index[index]}", fontsize=8)
        axes.set_xticks([])
        axes.set_yticks([])
    handles, labels = made.axes[0].get_legend_handles_labels()
    made.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    return made


def spread(tasks: TaskSet, count: int) -> np.ndarray:
    """Selects `count` maps (or all maps if there are fewer); returns ascending indices.

    The maps come from as many categories as possible. Within a category, maps with both feasible and infeasible tasks
    come first, because they are the most informative.
    """
    share = tasks.feasible.mean(axis=1)
    one_sided = (share < 0.15) | (share > 0.85)
    # Maps are ranked within their category. The order has all first ranks, then all second ranks, and so on.
    ranks, categories = np.empty(len(tasks), int), np.unique(tasks.category, return_inverse=True)[1]
    for category in np.unique(categories):
        members = np.flatnonzero(categories == category)
        ranks[members[np.argsort(one_sided[members], kind="stable")]] = np.arange(len(members))
    order = np.lexsort((categories, ranks))
    firsts = min(len(np.unique(categories)), len(order))
    if firsts > count:  # spread over the alphabet instead of its first categories
        order = order[np.linspace(0, firsts - 1, count).round().astype(int)]
    return np.sort(order[:count])


def _above_floor(heights: np.ndarray) -> np.ndarray:
    return heights - ground_level(heights)


def _draw_patch(axes, heights: np.ndarray, goals: np.ndarray, robot: Robot, highest: float):
    in_robot_frame = HeightMap(heights).crop_cells(PATCH_CENTER, PATCH_CENTER, 0)
    image = draw_terrain(axes, in_robot_frame, 0.0, highest)
    draw_robot(axes, np.zeros(7), robot, START)
    draw_pose(axes, (0, 0, 0), START, length=0.3)
    moves = abstract_steps_to_world(goals[goals[:, 2] == 0])[:, :2]
    axes.plot(*moves.T, ".", color=GOAL, markersize=3, zorder=9)
    axes.set_xlabel("x (m), ahead", fontsize=8)
    axes.set_ylabel("y (m), left", fontsize=8)
    return image


def _draw_tasks(axes, tasks: TaskSet, judged: tuple[np.ndarray, np.ndarray], index: int) -> None:
    said, costs = judged[0][index], judged[1][index]
    side = 0.92
    for goal, feasible, cost, judged_feasible, judged_cost in zip(
        tasks.goals[index], tasks.feasible[index], tasks.cost[index], said, costs, strict=True
    ):
        # Turns have no goal position: the left turn is drawn above the moves, the right turn below them.
        x, y = goal[:2] if goal[2] == 0 else (0.0, 3.15 * np.sign(goal[2]))
        color, _ = JUDGEMENTS[bool(feasible), bool(judged_feasible)]
        axes.add_patch(Rectangle((x - side / 2, y - side / 2), side, side, facecolor=color))
        lines = [f"{cost:.2f}" if feasible else "–", f"{judged_cost:.2f}" if judged_feasible else "–"]
        axes.text(x, y, "\n".join(lines), ha="center", va="center", fontsize=6.5, linespacing=1.1)
    axes.annotate("", (0.42, 0), (-0.42, 0), arrowprops={"arrowstyle": "-|>", "color": START, "linewidth": 2})
    axes.text(0.75, 3.15, "turn left", va="center", fontsize=7)
    axes.text(0.75, -3.15, "turn right", va="center", fontsize=7)
    axes.text(-2.9, 3.15, "label\nprediction", va="center", fontsize=7)
    axes.set_xlim(-3, 3)
    axes.set_ylim(-3.7, 3.7)
    axes.set_aspect("equal")
    axes.set_xlabel("goal, steps of 10 cm ahead", fontsize=8)
    axes.set_xticks(range(-2, 3))
    axes.set_yticks(range(-2, 3))
    axes.tick_params(labelsize=8)
    axes.spines[:].set_visible(False)

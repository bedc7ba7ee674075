"""Height maps of scanned places, with the patches cut from them."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.patches import Polygon

from hdsp.labels.tasks import TaskSet
from hdsp.robot.lattice import PATCH_CENTER, Grid, abstract_steps_to_world, heading_angle, rotation
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.robot_drawing import draw_pose, draw_robot
from hdsp.viz.style import BLUE, GREY, SKY, START, VERMILLION, draw_terrain, figure, ground_level, save

_COLUMNS = 6  # columns of patches beside a map
_LOWEST, _HIGHEST = -0.2, 1.2


class ScanPicture(NamedTuple):
    """A scan, its height map, the base states [n, 3] of its patches, and their labelled tasks."""

    name: str
    place: str
    licence: str
    terrain: HeightMap
    starts: np.ndarray
    tasks: TaskSet


def save_scan_sheet(scans: Sequence[ScanPicture], path: str | os.PathLike, robot: Robot | str = "momaro") -> Path:
    """Draws each scan: its map with patch outlines, and beside it the patches in the robot frame.

    Dots mark the goals: blue for feasible tasks, red for infeasible tasks.
    """
    robot = Robot.load(robot)
    if not scans:
        made = figure(6, 1)
        made.text(0.5, 0.5, "no scan was to be had", ha="center", color=GREY)
        return save(made, path)
    lines = [max(2, math.ceil(len(scan.tasks) / _COLUMNS)) for scan in scans]
    made = figure(20, 1.9 * sum(lines) + 0.6 * len(scans))
    parts = made.subfigures(len(scans), 1, height_ratios=lines, squeeze=False)[:, 0]
    for part, scan, count in zip(parts, scans, lines, strict=True):
        part.suptitle(f"{scan.place} ({scan.name}; {scan.licence})", fontsize=11, x=0.01, ha="left")
        left, right = part.subfigures(1, 2, width_ratios=(8, 12))
        floor = ground_level(scan.terrain.heights)
        image = _draw_map(left.subplots(), scan, floor)
        grid = right.subplots(count, _COLUMNS, squeeze=False).ravel()
        for axes, number in zip(grid, range(len(scan.tasks)), strict=False):
            _draw_patch(axes, scan.tasks, number, robot, floor)
        for axes in grid[len(scan.tasks) :]:
            axes.set_axis_off()
        bar = left.colorbar(image, ax=left.axes, shrink=0.7, pad=0.01, extend="both")
        bar.set_label("height above the floor (m)", fontsize=8)
    return save(made, path)


def save_map(terrain: HeightMap, path: str | os.PathLike, title: str = "") -> Path:
    """Draws a height map in world metres."""
    return save(map_figure(terrain, title), path)


def map_figure(terrain: HeightMap, title: str = "", side: float = 8.0):
    """Draws a height map in world metres as a matplotlib figure; ``side`` is the longer side of the map in inches."""
    length, width = terrain.size
    longest = max(length, width)
    made = figure(2.2 + side * length / longest, 1.2 + side * width / longest)
    axes = made.subplots()
    known = terrain.heights[np.isfinite(terrain.heights)]
    low, high = np.quantile(known, [0.01, 0.99]) if known.size else (0.0, 1.0)
    image = draw_terrain(axes, terrain, float(low), float(high))
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_title(title, fontsize=10)
    made.colorbar(image, ax=axes, shrink=0.6, pad=0.02, extend="both").set_label("height (m)", fontsize=9)
    return made


def _draw_map(axes, scan: ScanPicture, floor: float):
    terrain = replace(scan.terrain, heights=scan.terrain.heights - floor)
    image = draw_terrain(axes, terrain, _LOWEST, _HIGHEST)
    grid = Grid(terrain.origin, terrain.shape)
    side = scan.tasks.heights.shape[1] * terrain.resolution / 2
    corners = np.array([(-side, -side), (side, -side), (side, side), (-side, side)])
    for ix, iy, heading in scan.starts.tolist():
        theta, centre = float(heading_angle(heading)), grid.center((ix, iy))
        outline = corners @ rotation(theta).T + centre
        axes.add_patch(Polygon(outline, fill=False, edgecolor=BLUE, linewidth=0.5, alpha=0.6))
        draw_pose(axes, (*centre, theta), START, length=0.25)
    axes.set_xlim(terrain.origin[0], terrain.origin[0] + terrain.size[0])
    axes.set_ylim(terrain.origin[1], terrain.origin[1] + terrain.size[1])
    axes.set_xlabel("x (m)", fontsize=8)
    axes.set_ylabel("y (m)", fontsize=8)
    return image


def _draw_patch(axes, tasks: TaskSet, number: int, robot: Robot, floor: float) -> None:
    in_robot_frame = HeightMap(tasks.heights[number] - floor).crop_cells(PATCH_CENTER, PATCH_CENTER, 0)
    draw_terrain(axes, in_robot_frame, _LOWEST, _HIGHEST)
    draw_robot(axes, np.array([0, 0, 0, *tasks.start[number, 3:]]), robot, START)
    goals = abstract_steps_to_world(tasks.goals[number])[:, :2]
    moves = tasks.goals[number][:, 2] == 0
    for feasible, color in ((True, SKY), (False, VERMILLION)):
        shown = moves & (tasks.feasible[number] == feasible)
        axes.plot(*goals[shown].T, ".", color=color, markersize=3, zorder=9)
    axes.set_title(f"no. {tasks.index[number]}", fontsize=7, pad=2)
    axes.set_xticks([])
    axes.set_yticks([])

"""Planning on maps as robots measure them: noise, unknown cells, spikes and coarse cells over known scenes.

    python -m benchmarks.real_ground [--count 40] [--seed 0] [--robot momaro] [--heuristic manual] [--weight 1.25]
                                     [--only white_1cm,cells_5cm] [--page docs/your-map.md]

Each task is a scene with a plan on its exact map: level floor, a kerb of 0.15 m, a door, stairs of 0.16 / 0.30 m, or a
ramp; position, direction and poses are random. Every disturbance is applied to the map of every task. The planner
conditions the disturbed map (`hdsp.terrain.conditioned`) and plans. The plan is then tested against the exact scene
(`hdsp.planning.check_plan`).

The last line is JSON. For each disturbance:

- `solved`: share of the tasks with a plan;
- `cost`: mean ratio between the cost of the plan and the cost on the exact map;
- `most`: largest ratio;
- `stepped`: share of the plans over a kerb or stairs with a step;
- `seconds`: mean time of one conditioning.

`false` is the number of plans that collide with the exact scene by more than 0.02 m. `conditioning_10x10` is the time in
s for a map of 10 x 10 m with noise and unknown cells, `conditioning_1m2` the time for a change of 1 m2 in it.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.planning.collisions import check_plan
from hdsp.planning.planner import Planner
from hdsp.planning.plans import Plan
from hdsp.robot.lattice import RESOLUTION
from hdsp.robot.robot import Robot
from hdsp.terrain.arenas import Arena
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Bank, Block, Scene, Staircase

SIDE = 6.0  # m
MIDDLE = SIDE / 2
KINDS = "flat", "kerb", "door", "stairs", "ramp"
KERB, RISE, TREAD, STEPS = 0.15, 0.16, 0.30, 3  # m, m, m
TOLERANCE = 0.02  # m
_FAR = 12.0  # m, larger than the map


class Task(NamedTuple):
    """A scene with start and goal pose (x, y, theta), m and rad."""

    kind: str
    arena: Arena
    start: tuple[float, float, float]
    goal: tuple[float, float, float]


def random_task(seed: int, number: int) -> Task:
    """Makes a task; it depends on seed and number alone. The way leads from one side of the map to the other."""
    rng = np.random.default_rng((seed, number))
    kind = KINDS[number % len(KINDS)]
    yaw = float(rng.uniform(-0.2, 0.2))
    ahead, left = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])

    def place(along: float, aside: float = 0.0) -> tuple[float, float]:
        x, y = MIDDLE + along * ahead + aside * left
        return float(x), float(y)

    phase = float(rng.uniform(-0.05, 0.05))
    obstacles: tuple = ()
    if kind == "kerb":
        x, y = place(phase + _FAR / 2)
        obstacles = (Block(x, y, yaw, _FAR, _FAR, KERB),)
    elif kind == "door":
        thick, gap, at = rng.uniform(0.1, 0.3), rng.uniform(0.95, 1.2), rng.uniform(-0.5, 0.5)
        walls = [(at + side * (gap + _FAR) / 2) for side in (-1, 1)]
        obstacles = tuple(Block(*place(phase, wall), yaw, thick, _FAR, 2.0) for wall in walls)
    elif kind == "stairs":
        x, y = place(phase - TREAD)
        obstacles = (Staircase(x, y, yaw, STEPS, RISE, TREAD, _FAR, _FAR),)
    elif kind == "ramp":
        run, slope = 2.0, math.radians(rng.uniform(5.0, 12.0))
        x, y = place(phase - run / 2 + _FAR / 2)
        obstacles = (Bank(x, y, yaw, _FAR, _FAR, run * math.tan(slope), run),)
    first, last = ((-1.6, 1.7) if rng.random() < 0.5 else (1.7, -1.6)) if kind != "stairs" else (-1.7, 1.7)
    turn = yaw if last > first else yaw + math.pi
    turns = rng.uniform(-0.3, 0.3, 2) if kind in ("flat", "door", "ramp") else np.zeros(2)
    asides = rng.uniform(-0.6, 0.6, 2) if kind in ("flat", "door", "ramp") else np.zeros(2)
    ends = [
        (*place(along, float(aside)), math.remainder(turn + float(bend), 2 * math.pi))
        for along, aside, bend in zip((first, last), asides, turns, strict=True)
    ]
    return Task(kind, Arena(SIDE, Scene(obstacles)), ends[0], ends[1])


Disturbance = Callable[[HeightMap, np.random.Generator], HeightMap]


def _white(sigma: float) -> Disturbance:
    return lambda terrain, rng: _with(terrain, terrain.heights + sigma * rng.standard_normal(terrain.shape))


def _smooth(sigma: float, length: float = 0.05) -> Disturbance:
    """Noise with a standard deviation ``sigma`` (m), correlated over ``length`` (m)."""
    from scipy.ndimage import gaussian_filter

    def disturbed(terrain: HeightMap, rng: np.random.Generator) -> HeightMap:
        waves = gaussian_filter(rng.standard_normal(terrain.shape), length / terrain.resolution)
        return _with(terrain, terrain.heights + sigma * waves / waves.std())

    return disturbed


def _unknown(share: float) -> Disturbance:
    return lambda terrain, rng: _with(terrain, np.where(rng.random(terrain.shape) < share, np.nan, terrain.heights))


def _spikes(share: float, highest: float = 0.5) -> Disturbance:
    def disturbed(terrain: HeightMap, rng: np.random.Generator) -> HeightMap:
        hit = rng.random(terrain.shape) < share
        return _with(terrain, terrain.heights + hit * rng.uniform(-highest, highest, terrain.shape))

    return disturbed


def _coarse(cells: int) -> Disturbance:
    """Cells ``cells`` times as large, each with the mean height."""

    def disturbed(terrain: HeightMap, rng: np.random.Generator) -> HeightMap:
        nx, ny = (count // cells for count in terrain.shape)
        blocks = terrain.heights[: nx * cells, : ny * cells].reshape(nx, cells, ny, cells)
        return HeightMap(blocks.mean(axis=(1, 3)), terrain.origin, terrain.resolution * cells)

    return disturbed


def _together(*parts: Disturbance) -> Disturbance:
    def disturbed(terrain: HeightMap, rng: np.random.Generator) -> HeightMap:
        for part in parts:
            terrain = part(terrain, rng)
        return terrain

    return disturbed


def _with(terrain: HeightMap, heights: np.ndarray) -> HeightMap:
    return HeightMap(heights, terrain.origin, terrain.resolution)


DISTURBANCES: dict[str, Disturbance] = {
    "white_1cm": _white(0.01),
    "white_2cm": _white(0.02),
    "white_3cm": _white(0.03),
    "smooth_2cm": _smooth(0.02),
    "unknown_1%": _unknown(0.01),
    "unknown_5%": _unknown(0.05),
    "spikes_1%": _spikes(0.01),
    "cells_5cm": _coarse(2),
    "cells_10cm_kerb": _coarse(4),
    "together": _together(_coarse(2), _white(0.01), _unknown(0.02)),
}
#: Disturbances for some kinds of tasks only.
_ONLY = {"cells_10cm_kerb": ("kerb",)}

"""Limits of queries: by how much they exceed their time and their memory.

    python -m benchmarks.limits [--queries 200] [--seed 0] [--memory-queries 60]

**Time.** Each query has a random heuristic, map, pair of poses and limit of 0.1 - 5 s; some planners are fresh, some
have answered before, and some pairs have no plan. A second thread wakes at the limit and notes the CPU time of the
process. The overrun is the CPU time from then to the answer, so other work on the machine does not count; overruns by
the clock are printed as well. Compilation comes before the clock.

**Memory.** Each query runs in a new process on a planner whose own arrays are in memory already. The growth of the
resident memory at its peak is compared with the limit.

The last line is JSON: `time_over`, the largest overrun as a share of the limit; `time_over_ms`, the largest in
milliseconds among limits below 0.5 s; `memory_over`, the largest share by which memory exceeds its limit.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hdsp import HeightMap, Planner
from hdsp.planning.answers.plans import Plan
from hdsp.terrain.random_arenas import random_arena

LIMITS = 0.1, 0.2, 0.5, 1.0, 2.0, 5.0
#: Below this limit, the bar is in milliseconds.
SHORT = 0.5


@dataclass(frozen=True)
class Kind:
    """Kind of a query: the planner's heuristic, and the way to ask."""

    name: str
    heuristic: str
    ask: Callable[[Planner, tuple, tuple, dict], Plan]


def planned(**options) -> Callable:
    return lambda planner, start, goal, limits: planner.plan(start, goal, **options, **limits)


def improved(planner: Planner, start: tuple, goal: tuple, limits: dict) -> Plan:
    *_, last = planner.improve(start, goal, **limits)
    return last


KINDS = (
    Kind("geometric", "geometric", planned(weight=1.25)),
    Kind("grid", "grid", planned(weight=1.25)),
    Kind("manual", "manual", planned()),
    Kind("learned", "learned", planned()),
    Kind("learned, refinable", "learned", planned(refinable=True)),
    Kind("learned, anchored", "learned", planned(weight=1.25, anchor_weight=1.1)),
    Kind("learned, improving", "learned", improved),
    Kind("geometric, improving", "geometric", improved),
    Kind("any feet at the goal", "manual", planned(tolerance=(0.3, 3.2))),
)


def walled(size: int) -> HeightMap:
    """Flat ground with a wall across."""
    heights = np.zeros((size, size), np.float32)
    heights[size // 2 : size // 2 + 4] = 1.0
    return HeightMap(heights)


MAPS: dict[str, Callable[[], HeightMap]] = {
    "5 m": lambda: random_arena(0, 5.0),
    "other 5 m": lambda: random_arena(3, 5.0),
    "10 m": lambda: random_arena(1, 10.0),
    "wall, 5 m": lambda: walled(200),
    "wall, 10 m": lambda: walled(400),
    "14 m": lambda: random_arena(2, 14.0),
}


def poses(planner: Planner, rng: np.random.Generator) -> list[tuple]:
    """A start and a goal that the robot can leave, on both halves of the map."""
    size = 0.025 * np.array(planner.grid.shape)
    found: list[tuple] = []
    while len(found) < 2:
        at = rng.uniform(0.1, 0.9, 2) * size
        at[0] = (at[0] + size[0] * len(found)) / 2
        pose = *at.tolist(), float(rng.uniform(-3, 3))
        if planner.can_leave(pose):
            found.append(pose)
    return found


@dataclass(frozen=True)
class Timed:
    """A query with a limit of time."""

    kind: str
    map: str
    fresh: bool
    limit: float
    status: str
    wall: float
    late: float
    stated: float

    @property
    def share(self) -> float:
        return self.late / self.limit


def timed(planner: Planner, kind: Kind, name: str, ends: list[tuple], limit: float, fresh: bool) -> Timed:
    at_limit: list[float] = []
    watch = threading.Timer(limit, lambda: at_limit.append(time.process_time()))
    watch.start()
    began = time.perf_counter()
    plan = kind.ask(planner, *ends, {"time": limit})
    wall, cpu = time.perf_counter() - began, time.process_time()
    watch.cancel()
    late = cpu - at_limit[0] if at_limit else 0.0
    ended = plan.stats.ended or str(plan.status)
    return Timed(kind.name, name, fresh, limit, ended, wall, late, plan.stats.seconds)

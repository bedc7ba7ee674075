"""Small scenes with all that a textbook search finds in them: tests take seconds also without the JIT."""

from functools import cache
from typing import NamedTuple

import numba
import numpy as np
import pytest

from hdsp.detailed.actions.action import undo
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.search import store, windows
from hdsp.detailed.search.expansion import begin_at
from hdsp.detailed.world.world import World, build_world
from hdsp.terrain.height_map import HeightMap
from tests.detailed.instances import (
    AHEAD_ONLY,
    FIXED_WHEELS,
    NIMBLE,
    NIMBLE_CHANGES,
    SHORT_ARCS,
    WIDE_ARCS,
    blocky,
    costs_to_go,
    near_edges,
    toy,
    valid_states,
)
from tests.naive import Naive, dijkstra

if numba.config.DISABLE_JIT:
    # NumPy's differences of uint8 wrap around, and Python's integers turn into no uint64 if negative; Numba calculates
    # with both in int64.
    store.undo = lambda key, action, *tables: undo(key, int(action), *tables)
    windows.begin_at = lambda states, start: begin_at(states, np.int64(start))

WINDOW = 1  # heading steps to either side of the start's heading


class SmallScene(NamedTuple):
    """A terrain, a robot, and all states in reach of a start.

    Attributes:
        world, twin: terrain and robot.
        rules: few headings.
        start: a state.
        graph: {state: [(action, reached state, cost)]}.
    """

    world: World
    twin: Naive
    rules: Rules
    start: tuple
    graph: dict


#: Wheels that do not steer, steps and base shifts ahead only.
FORWARD = toy(
    step={**NIMBLE_CHANGES["step"], "backward": False},
    base_shift={**NIMBLE_CHANGES["base_shift"], "backward": False},
    drive={"sideways": False},
)
#: Robot, side of the map in cells, and seed of the terrain; each has drives, turns or arcs, steps and base shifts.
SCENES = {
    "nimble": (NIMBLE, 10, 2), "fixed wheels": (FIXED_WHEELS, 10, 2), "ahead only": (AHEAD_ONLY, 12, 120),
    "forward": (FORWARD, 10, 2), "short arcs": (SHORT_ARCS, 10, 3), "wide arcs": (WIDE_ARCS, 10, 13),
}  # fmt: skip


@cache
def small_scene(name: str) -> SmallScene:
    robot, cells, seed = SCENES[name]
    rng = np.random.default_rng(seed)
    heights = blocky(rng, cells=cells, blocks=1)
    twin = Naive(heights, robot)
    states = valid_states(twin, rng, 6, headings=[0, 1, 5, 16, 40])
    start = (near_edges(twin, states) + states)[0]
    twin = Naive(heights, robot, center=start[2], window=WINDOW)
    graph, missing = {}, [start]
    while missing:
        if (state := missing.pop()) not in graph:
            graph[state] = [(action, reached, cost) for action, reached, cost in twin.successors(state)]
            missing += [reached for _, reached, _ in graph[state]]
    return SmallScene(build_world(HeightMap(heights), robot), twin, Rules(start[2], WINDOW), start, graph)


@cache
def exact_costs(name: str, goal: tuple) -> dict:
    """Least cost to a goal from each state in the graph of a scene with a path to it."""
    graph = small_scene(name).graph
    return costs_to_go({state: [edge[1:] for edge in edges] for state, edges in graph.items()}, goal)


@cache
def some_goals(name: str, count: int = 4) -> tuple[tuple, ...]:
    """States spread over the graph of a scene, among them the dearest one, one on neutral feet, and the start."""
    scene = small_scene(name)
    gone = dijkstra(scene.twin, scene.start).cost
    order = list(gone)
    spread = [order[k] for k in np.linspace(0, len(order) - 1, count).astype(int)]
    return (*spread, [state for state in order if not any(state[3:])][-1])


by_scene = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.xdist_group("small scenes")) for name in SCENES]
)

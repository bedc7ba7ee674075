"""Layers over a map: the planner's view of the ground, its heuristic, and the work of a search."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hdsp.planning.answers.findings import Inquiry
from hdsp.planning.heuristics import AbstractHeuristic
from hdsp.planning.planner import Planner
from hdsp.planning.viewing.planning_session import PlanningAnswer
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
    abstract_anchor,
    abstract_shape,
)
from hdsp.terrain.cost_maps import cost_maps
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.palette import RED
from hdsp.viz.viewer.textures import VALUE_COLORS, mark_colors, shaded, value_colors

_PER_FOOT = 10.0  # the foot cost rises ten times as fast as the state cost, whose share of each foot is 0.1
_SECONDS = 5.0  # of a search that is repeated for its states
#: Index of each abstract drive by its displacement in cells.
_DRIVES = {(int(dx), int(dy)): k for k, (dx, dy, turn) in enumerate(ABSTRACT_ACTIONS) if turn == 0}
_OVER = 0.03  # m, of lines above the ground


class EdgeLines(NamedTuple):
    """Edges of the abstract graph as lines.

    Attributes:
        ends: float64 [n, 2, 3], m.
        colors: uint8 [n, 3].
    """

    ends: np.ndarray
    colors: np.ndarray


class LayerSources:
    """Answers from which layers were drawn.

    Args:
        of_planner: layers that depend on an answer's planner alone.
    """

    def __init__(self, of_planner: Sequence[str]):
        self._of_planner = of_planner
        # The objects themselves: the identity of an object that is gone may be that of a newer one.
        self._sources: dict[str, object] = {}

    def has(self, name: str, answer: PlanningAnswer) -> bool:
        """Whether a layer shows an answer."""
        return self._sources.get(name) is self._source(name, answer)

    def set(self, name: str, answer: PlanningAnswer) -> None:
        """Notes a layer that shows an answer."""
        self._sources[name] = self._source(name, answer)

    def forget(self, name: str | None = None) -> None:
        """Forgets a layer; None: all."""
        if name is None:
            self._sources.clear()
        else:
            self._sources.pop(name, None)

    def _source(self, name: str, answer: PlanningAnswer) -> object:
        return answer.planner if name in self._of_planner else answer


def foot_costs(planner: Planner) -> np.ndarray:
    """Returns colours for foot costs, uint8 [nx, ny, 4]; red cells carry no foot."""
    terrain, robot = planner.terrain, planner.robot
    maps = cost_maps(terrain, robot)
    costs = 1 + _PER_FOOT * robot.drive.unevenness_cost * maps.unevenness
    colors = value_colors(np.where(maps.standable, costs, np.nan), low=1.0)
    refused = np.isfinite(terrain.heights) & ~maps.standable
    return np.where(refused[..., None], mark_colors(refused, RED, 210), colors)


def costs_to_go(planner: Planner) -> np.ndarray:
    """Returns colours for the least estimated cost to the last goal over all headings, uint8 [nx, ny, 4].

    A robot on neutral feet stands at the middle of each abstract cell.
    """
    shape = abstract_shape(planner.grid.shape)
    cells = np.stack(np.meshgrid(*map(np.arange, shape), np.arange(ABSTRACT_HEADINGS), indexing="ij"), axis=-1)
    states = np.zeros((cells[..., 0].size, 7), np.int64)
    states[:, :3] = abstract_anchor(cells).reshape(-1, 3)
    costs = planner.heuristic(states).reshape(*shape, ABSTRACT_HEADINGS).min(axis=2)
    return value_colors(_in_cells(costs, planner.grid.shape), low=0.0)


def _in_cells(values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Values of abstract cells for each cell of the map; NaN beyond the last whole abstract cell."""
    found = np.full(shape, np.nan)
    fine = values.repeat(CELLS_PER_ABSTRACT, axis=0).repeat(CELLS_PER_ABSTRACT, axis=1)
    found[: fine.shape[0], : fine.shape[1]] = fine
    return found


def abstract_edges(planner: Planner, surface: HeightMap) -> EdgeLines | None:
    """Returns the edges between neighbouring abstract cells, coloured by cost per metre.

    Each line stands for the cheapest heading and the cheaper direction.

    Args:
        planner: the planner.
        surface: its terrain without unknown cells, as by `hdsp.viz.viewer.ground_mesh.surface_of`.

    Returns:
        the lines; None for a heuristic without an abstraction.
    """
    heuristic = planner.heuristic
    if not isinstance(heuristic, AbstractHeuristic):
        return None
    cheapest = heuristic.known.incoming.min(axis=0)  # by end state
    nx, ny = cheapest.shape[:2]
    lines, prices = [], []
    index = np.moveaxis(np.indices((nx, ny)), 0, -1)
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
        ahead, back = _DRIVES[dx, dy], _DRIVES[-dx, -dy]
        starts = index[: nx - dx, max(0, -dy) : ny - max(0, dy)].reshape(-1, 2)
        ends = starts + (dx, dy)
        cost = np.minimum(cheapest[ends[:, 0], ends[:, 1], ahead], cheapest[starts[:, 0], starts[:, 1], back])
        open_ = np.isfinite(cost)
        lines.append(np.stack([starts[open_], ends[open_]], axis=1))
        prices.append(cost[open_] / np.hypot(dx, dy))
    places, price = np.concatenate(lines), np.concatenate(prices)
    if not len(price):
        return EdgeLines(np.empty((0, 2, 3)), np.empty((0, 3), np.uint8))
    states = np.concatenate([places, np.zeros((*places.shape[:2], 1), np.int64)], axis=-1)
    at = planner.grid.center(abstract_anchor(states)[..., :2])
    heights = surface.height_at(at[..., 0], at[..., 1]) + _OVER
    colors = shaded(price, VALUE_COLORS, float(price.min()), float(np.percentile(price, 95)))
    return EdgeLines(np.concatenate([at, heights[..., None]], axis=-1), colors)


def searched_cells(answer: PlanningAnswer) -> np.ndarray | None:
    """Returns the cells of the base that a search saw, bool [nx, ny]; None if the search is unknown.

    A search keeps its states only if it finds no plan. The same search is therefore repeated, and ends one expansion
    before the plan.
    """
    request, plan = answer.request, answer.plan
    if plan.solved:
        plan = answer.planner.plan(
            request.start, request.goal, request.weight, tolerance=request.tolerance or None, polish=0.0,
            expansions=max(plan.stats.expansions - 1, 0), time=_SECONDS,
        )  # fmt: skip
    reached = plan.inquiry.reached if isinstance(plan.inquiry, Inquiry) else None
    return None if reached is None else reached.headings != 0

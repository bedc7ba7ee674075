"""Conformance checker for abstract costs: does an own ``AbstractCosts`` keep the contract?

from hdsp.abstract import check_abstract_costs

check_abstract_costs(MyCosts("momaro"))
"""

from collections.abc import Callable

import numpy as np

from hdsp.abstract.abstract_costs import AbstractCosts, LocalCosts, Region, TaskPredictor
from hdsp.base.conformance import Contract
from hdsp.base.errors import InputError
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
    HEADINGS_PER_ABSTRACT,
    N_ABSTRACT_ACTIONS,
    PATCH_CELLS,
    abstract_anchor,
    abstract_shape,
    robot_frame_goals,
)
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.patches import crop_patches
from hdsp.terrain.scenes import random_map

#: The rules of the contracts `AbstractCosts`, `LocalCosts` and `TaskPredictor`.
RULES = {
    "methods": "edges(height_map, region=None, mask=None) is a method",
    "shape": "edges are [16, nx, ny, 22] for the nx x ny whole abstract cells of the map or the region",
    "dtype": "edges are float32",
    "values": "a cost is >= 0 and never NaN, inf is infeasible; unknown ground is no exception",
    "exits": "an action that leads off the map is infeasible",
    "mask": "states inside the mask keep their costs, all actions of the others are infeasible",
    "region": "the costs of a region are cut out of the costs of the whole map",
    "determinism": "the same map has the same costs, whatever was asked or written into an answer in between",
    "input": "the height map and the mask stay unchanged",
    "origin": "the place of a map in the world has no influence on costs",
    "errors": "InputError for a region that is empty or leaves the map, and for a mask of another shape",
    "affected": "affected(changed) is bool [16, nx, ny], and a change leaves the costs of all other states alone",
    "tasks": "predict returns feasible bool [n, 22] and cost float32 [n, 22], >= 0 and finite where feasible",
    "task determinism": "a patch has the same answer alone, among others and when it is asked again",
    "task input": "patches and goals stay unchanged",
    "task errors": "InputError for patches or goals of a wrong shape",
}

#: Sampled headings: along a map axis, and between axes.
_HEADINGS = (0, 4, 9, 15)


def check_abstract_costs(
    costs: AbstractCosts, terrain: HeightMap | None = None, *, states: int = 200, tolerance: float = 1e-4
) -> tuple[str, ...]:
    """Checks whether abstract costs keep their contract.

    Rules of ``LocalCosts`` and ``TaskPredictor`` apply if ``costs`` has their methods. Every rule is checked on
    samples, so success is evidence but no proof.

    Args:
        costs: implementation.
        terrain: height map with at least 6 x 6 abstract cells and some feasible actions; None = random cuboids on 2.6 x
            2.2 m with unknown cells.
        states: number of abstract states to evaluate on the terrain.
        tolerance: largest difference between two evaluations of a cost in batches with different sizes.

    Returns:
        Names of the checked rules, keys in ``RULES``.

    Raises:
        ConformanceError: a rule is broken.
        InputError: the terrain is too small, or no action is feasible at the sampled states.
    """
    contract = Contract("AbstractCosts", RULES)
    contract.require("methods", callable(getattr(costs, "edges", None)), f"{type(costs).__name__} has no edges")
    terrain = _default_terrain() if terrain is None else terrain
    nx, ny = abstract_shape(terrain.shape)
    if min(nx, ny) < 6:
        raise InputError(f"terrain of {nx} x {ny} abstract cells; need at least 6 x 6")

    for small in _small_maps(terrain):
        _check_answer(contract, costs.edges(small), small, (0, 0, *abstract_shape(small.shape)))
    _check_errors(contract, costs, terrain)
    random = np.random.default_rng(0)
    region = nx // 4, ny // 3, nx - nx // 4, ny
    mask = _mask(random, (nx, ny), region, states)
    whole = _check_whole(contract, costs, terrain, mask, tolerance)
    _check_region(contract, costs, terrain, region, mask, whole, tolerance)
    _check_origin(contract, costs, terrain, mask, whole, tolerance)
    if isinstance(costs, LocalCosts):
        _check_affected(contract, costs, terrain, random, states, tolerance)
    if isinstance(costs, TaskPredictor):
        _check_tasks(contract, costs, terrain, random, tolerance)
    return contract.checked


def _default_terrain() -> HeightMap:
    # Cells are left over at the upper borders, and a corner is unknown.
    heights = random_map(0, "cuboid_2", 0, cells=104).heights[:103, :90].copy()
    heights[:9, :14] = np.nan
    heights[60, 40] = np.nan
    return HeightMap(heights)


def _small_maps(terrain: HeightMap) -> list[HeightMap]:
    """Maps smaller than a patch: a terrain part, a single abstract cell, unknown ground."""
    size = CELLS_PER_ABSTRACT
    ix, iy = terrain.shape[0] // 3, terrain.shape[1] // 3
    part = terrain.heights[ix : ix + 3 * size + 3, iy : iy + 3 * size + 1]
    return [HeightMap(part), HeightMap.flat((size, size)), HeightMap(np.full((2 * size, 3 * size), np.nan))]


def _mask(random: np.random.Generator, shape: tuple[int, int], region: Region, states: int) -> np.ndarray:
    """Abstract states, bool [16, nx, ny]: nine in ten within the region, all at a few headings.

    A few headings save three quarters of the time in implementations that work heading by heading.
    """
    first_x, first_y, end_x, end_y = region
    mask = np.zeros((ABSTRACT_HEADINGS, *shape), bool)
    cells = random.integers((0, 0), shape, (states, 2))
    cells[: states * 9 // 10] = random.integers((first_x, first_y), (end_x, end_y), (states * 9 // 10, 2))
    mask[random.choice(_HEADINGS, states), cells[:, 0], cells[:, 1]] = True
    return mask


def _check_answer(contract: Contract, edges: np.ndarray, height_map: HeightMap, region: Region) -> None:
    first_x, first_y, end_x, end_y = region
    expected = ABSTRACT_HEADINGS, end_x - first_x, end_y - first_y, N_ABSTRACT_ACTIONS
    shape = np.shape(edges)
    contract.require("shape", shape == expected, f"{shape} instead of {expected} on a map of {height_map.shape} cells")
    contract.require("dtype", edges.dtype == np.float32, str(edges.dtype))
    if not (edges >= 0).all():
        at = np.argwhere(~(edges >= 0))[0].tolist()
        contract.require("values", False, f"edges{at} = {edges[tuple(at)]}")
    contract.require("values", True, "")
    states = np.moveaxis(np.indices(expected[1:3]), 0, -1) + (first_x, first_y)
    reached = states[:, :, None] + ABSTRACT_ACTIONS[:, :2]
    outside = ((reached < 0) | (reached >= abstract_shape(height_map.shape))).any(axis=-1)
    leaving = np.argwhere(np.isfinite(edges) & outside)
    if len(leaving):
        k, a, b, m = leaving[0].tolist()
        found = f"action {ABSTRACT_ACTIONS[m].tolist()} from cell {[a, b]}, heading {k} costs {edges[k, a, b, m]}"
        contract.require("exits", False, found)
    contract.require("exits", True, "")


def _check_errors(contract: Contract, costs: AbstractCosts, terrain: HeightMap) -> None:
    nx, ny = abstract_shape(terrain.shape)

    def asking(region: Region | None, mask: np.ndarray | None) -> Callable[[], np.ndarray]:
        return lambda: costs.edges(terrain, region, mask)

    for region in ((1, 1, 1, 3), (-1, 0, 2, 2), (0, 0, nx + 1, 2), (0, ny - 1, 2, ny + 1)):
        contract.require_error("errors", InputError, asking(region, None), f"region {region}")
    wrong = np.zeros((ABSTRACT_HEADINGS, nx, ny + 1), bool)
    contract.require_error("errors", InputError, asking(None, wrong), f"a mask of shape {wrong.shape}")
    wrong = np.zeros((ABSTRACT_HEADINGS, nx, ny), bool)
    contract.require_error("errors", InputError, asking((0, 0, 2, 2), wrong), "a mask of the map beside a region")


def _check_whole(
    contract: Contract, costs: AbstractCosts, terrain: HeightMap, mask: np.ndarray, tolerance: float
) -> np.ndarray:
    """Checks the answer for masked states; returns a copy."""
    heights, given = terrain.heights.copy(), mask.copy()
    first = costs.edges(terrain, mask=given)
    _check_answer(contract, first, terrain, (0, 0, *mask.shape[1:]))
    contract.require_equal("input", terrain.heights, heights, "heights after a call")
    contract.require_equal("input", given, mask, "mask after a call")
    outside = np.isfinite(first).any(axis=-1) & ~mask
    states = np.argwhere(outside).tolist()
    contract.require("mask", not states, f"state {states[:1]} outside the mask has a feasible action")
    whole = first.copy()
    if not np.isfinite(whole).any():
        raise InputError("terrain: no action is feasible at the sampled states; need a map on which some are")

    if first.flags.writeable:
        first[...] = -1.0
        contract.require_equal("determinism", costs.edges(terrain, mask=mask), whole, "costs after a written answer")
    costs.edges(HeightMap.flat((4 * CELLS_PER_ABSTRACT, 3 * CELLS_PER_ABSTRACT)))
    contract.require_equal("determinism", costs.edges(terrain, mask=mask), whole, "costs after another map")
    fewer = mask & (np.arange(mask.size).reshape(mask.shape) % 2 == 0)
    part = costs.edges(terrain, mask=fewer)
    contract.require_equal("mask", part[fewer], whole[fewer], "costs under a smaller mask", tolerance)
    none = costs.edges(terrain, mask=np.zeros_like(mask))
    contract.require("mask", np.isinf(none).all(), "an empty mask leaves feasible actions")
    return whole


def _check_region(
    contract: Contract,
    costs: AbstractCosts,
    terrain: HeightMap,
    region: Region,
    mask: np.ndarray,
    whole: np.ndarray,
    tolerance: float,
) -> None:
    first_x, first_y, end_x, end_y = region
    cut = slice(None), slice(first_x, end_x), slice(first_y, end_y)
    part = costs.edges(terrain, region, mask[cut])
    _check_answer(contract, part, terrain, region)
    contract.require_equal("region", part, whole[cut], f"costs of region {region}", tolerance)
    # A single cell without a mask.
    k, a, b = (int(value) for value in np.argwhere(mask & np.isfinite(whole).any(axis=-1))[0])
    single = costs.edges(terrain, (a, b, a + 1, b + 1))
    contract.require_equal("region", single[k, 0, 0], whole[k, a, b], f"costs of cell {[a, b]} alone", tolerance)


def _check_origin(
    contract: Contract, costs: AbstractCosts, terrain: HeightMap, mask: np.ndarray, whole: np.ndarray, tolerance: float
) -> None:
    moved = HeightMap(terrain.heights, (terrain.origin[0] + 11.3, terrain.origin[1] - 4.1), terrain.resolution)
    contract.require_equal("origin", costs.edges(moved, mask=mask), whole, "costs of the moved map", tolerance)


def _check_affected(
    contract: Contract,
    costs: LocalCosts,
    terrain: HeightMap,
    random: np.random.Generator,
    states: int,
    tolerance: float,
) -> None:
    changed = np.zeros(terrain.shape, bool)
    changed[2:5, -8:-5] = True
    given = changed.copy()
    affected = costs.affected(given)
    expected = ABSTRACT_HEADINGS, *abstract_shape(terrain.shape)
    found = f"{affected.dtype} {affected.shape} instead of bool {expected}"
    contract.require("affected", affected.shape == expected and affected.dtype == bool, found)
    contract.require_equal("input", given, changed, "changed cells after a call")
    mask = _nearest_unaffected(affected, changed, random, states)
    before = costs.edges(terrain, mask=mask)
    for height in (1.0, -0.5, np.nan):
        after = costs.edges(HeightMap(np.where(changed, np.float32(height), terrain.heights)), mask=mask)
        words = f"costs of unaffected states with the changed cells at {height} m"
        contract.require_equal("affected", after, before, words, tolerance)


def _nearest_unaffected(
    affected: np.ndarray, changed: np.ndarray, random: np.random.Generator, states: int
) -> np.ndarray:
    """Unaffected states: half of them nearest to the change, which reveals a short reach, the others random."""
    unaffected = np.argwhere(~affected)
    unaffected = unaffected[np.isin(unaffected[:, 0], _HEADINGS)]
    center = np.argwhere(changed).mean(axis=0) / CELLS_PER_ABSTRACT
    nearest = np.argsort(np.hypot(*(unaffected[:, 1:] - center).T), kind="stable")[: states // 2]
    others = random.integers(0, len(unaffected), states // 2) if len(unaffected) else np.empty(0, int)
    mask = np.zeros(affected.shape, bool)
    mask[tuple(unaffected[np.concatenate([nearest, others])].T)] = True
    return mask


def _check_tasks(
    contract: Contract, costs: TaskPredictor, terrain: HeightMap, random: np.random.Generator, tolerance: float
) -> None:
    n = 6
    headings = random.integers(0, ABSTRACT_HEADINGS, n)
    cells = random.integers(0, abstract_shape(terrain.shape), (n, 2))
    bases = abstract_anchor(np.column_stack([cells, headings]))[:, :2]
    patches = crop_patches(terrain.heights, bases, headings * HEADINGS_PER_ABSTRACT)
    patches[-1] = np.nan
    goals = np.stack([robot_frame_goals(int(heading)) for heading in headings])
    given = patches.copy(), goals.copy()
    feasible, cost = costs.predict(*given)
    contract.require_equal("task input", given[0], patches, "patches after a call")
    contract.require_equal("task input", given[1], goals, "goals after a call")
    expected = n, N_ABSTRACT_ACTIONS
    found = f"feasible {feasible.dtype} {feasible.shape}, cost {cost.dtype} {cost.shape}"
    kinds = feasible.dtype == bool and cost.dtype == np.float32
    contract.require("tasks", kinds and feasible.shape == cost.shape == expected, found)
    wrong = cost[feasible][~(np.isfinite(cost[feasible]) & (cost[feasible] >= 0))]
    contract.require("tasks", not len(wrong), f"a feasible task costs {wrong[:1]}")

    answer = np.where(feasible, cost, np.inf)
    again = costs.predict(patches, goals)
    contract.require_equal("task determinism", np.where(again[0], again[1], np.inf), answer, "costs when asked again")
    for i in range(n):
        alone = costs.predict(patches[i : i + 1], goals[i : i + 1])
        words = f"costs of patch {i} alone"
        contract.require_equal("task determinism", np.where(*alone, np.inf)[0], answer[i], words, tolerance)
    for wrong_patches, wrong_goals in ((patches[:, 1:], goals), (patches, goals[1:]), (patches, goals[..., :2])):
        words = f"patches {wrong_patches.shape} and goals {wrong_goals.shape} of {PATCH_CELLS} x {PATCH_CELLS} cells"
        contract.require_error(
            "task errors", InputError, lambda p=wrong_patches, g=wrong_goals: costs.predict(p, g), words
        )

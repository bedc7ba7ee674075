"""Costs of the abstract actions on flat ground, and the cost limit of labels that follows from them."""

import functools
import math

import numpy as np

from hdsp.abstract.oracle import CostKind, LabelSettings, task_costs
from hdsp.abstract.transform import feet_at
from hdsp.base.errors import InputError
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.world.world import World, build_world
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
    HEADINGS_PER_ABSTRACT,
    N_ABSTRACT_ACTIONS,
    PATCH_CELLS,
    cells,
)
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.height_map import HeightMap

#: Actions of each kind in the longest detailed plan for an abstract action on flat ground; a generous bound.
_ACTIONS = 64


@functools.lru_cache(maxsize=16)
def flat_table(robot: Robot, settings: LabelSettings | None = None, kind: CostKind = CostKind.LABEL) -> np.ndarray:
    """Returns flat-ground costs, float32 [16, 22] by heading and action.

    inf = infeasible even on flat ground, for instance a way back for a robot that only drives ahead; for both kinds,
    the rules of labels decide it. A robot turn by 90 degrees only permutes the actions, so four headings are searched.

    Args:
        robot: the robot.
        settings: labelling rules.
        kind: label costs, on a patch, or planning costs, with more ground for ways around.

    Raises:
        InputError: the robot cannot stand on flat ground, or no action is feasible.
    """
    settings = settings or LabelSettings()
    known = flat_table(robot, settings) if kind == CostKind.PLANNING else None
    cells = PATCH_CELLS if known is None else _planning_cells(robot, known)
    world = build_world(HeightMap.flat((cells, cells)), robot)
    table = np.full((ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS), np.inf, np.float32)
    quarter = ABSTRACT_HEADINGS // 4
    for heading in range(quarter):
        start = feet_at(world, (cells // 2, cells // 2, heading * HEADINGS_PER_ABSTRACT))
        if start is None:
            raise InputError(f"robot {robot.name}: the robot cannot stand even on flat ground")
        if known is None:
            table[heading] = task_costs(world, start, settings, _most(world, settings))[1]
            continue
        label = known[heading].astype(float)
        feasible = np.flatnonzero(np.isfinite(label))
        if len(feasible):
            most, actions = float(label[feasible].max()), ABSTRACT_ACTIONS[feasible]
            found = task_costs(world, start, settings, most, actions, kind, at_most=label[feasible])
            table[heading, feasible] = found[1]
    index = {tuple(action): m for m, action in enumerate(ABSTRACT_ACTIONS.tolist())}
    for heading in range(quarter, ABSTRACT_HEADINGS):
        # An action costs the same as its copy, rotated back by 90 degrees, at the heading one quarter earlier.
        turned_back = [index[dy, -dx, turn] for dx, dy, turn in ABSTRACT_ACTIONS.tolist()]
        table[heading] = table[heading - quarter, turned_back]
    if np.isinf(table).all():
        raise InputError(f"robot {robot.name}: every abstract action is infeasible even on flat ground")
    table.flags.writeable = False
    return table


@functools.lru_cache(maxsize=16)
def planning_factors(robot: Robot) -> np.ndarray:
    """Returns ratios of planning to label costs on flat ground, float32 [16, 22] by heading and action, at most 1.

    1 where an action is infeasible on flat ground.
    """
    label, planning = flat_table(robot), flat_table(robot, None, CostKind.PLANNING)
    both = np.isfinite(label) & np.isfinite(planning)
    factors = np.minimum(np.divide(planning, label, out=np.ones_like(label), where=both), 1)
    factors.flags.writeable = False
    return factors


def cost_limit(robot: Robot, settings: LabelSettings) -> float:
    """Returns the highest cost of a feasible label.

    The limit is ``settings.cost_limit_factor`` times the cost of the most expensive feasible action on flat ground, or
    of a longest and highest step with each foot, whichever is higher. It is 1.6 for Momaro.
    """
    flat = flat_table(robot, settings)
    highest = float(flat[np.isfinite(flat)].max())
    step = robot.step
    if step.max_length > 0:
        effort = step.cost + step.cost_per_metre * step.max_length + step.cost_per_height * step.max_height
        highest = max(highest, len(FEET) * effort)
    return round(settings.cost_limit_factor * highest, 6)  # the table has seven digits


def _planning_cells(robot: Robot, labels: np.ndarray) -> int:
    """Side of a flat map, in cells: no plan meets its border, or it is twice as long as a patch."""
    reach = base_reach(robot, float(labels[np.isfinite(labels)].max()))
    return min(2 * (reach + math.ceil(cells(robot.reach()))) + 1, 2 * PATCH_CELLS)


def base_reach(robot: Robot, cost_limit: float) -> int:
    """Largest distance, in cells, between the start of an abstract action and the base on its way."""
    world = build_world(HeightMap.flat((1, 1)), robot)
    least = geometric_estimate(world, np.zeros(7, dtype=np.int64)).distance
    # A way over a place costs at least its distances from start and goal.
    apart = CELLS_PER_ABSTRACT * float(np.hypot(*ABSTRACT_ACTIONS[:, :2].T).max())
    return math.ceil((cost_limit / least + apart) / 2)


def _most(world: World, settings: LabelSettings) -> float:
    """A cost above that of any action on flat ground."""
    price = world.tables.drive_price[0]
    turn = world.constants.turn * max(settings.turn_cost_factor, 1.0)
    return _ACTIONS * (turn + float(price[np.isfinite(price)].max()))

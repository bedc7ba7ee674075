"""Why the tasks of a map are infeasible: the cause of each label, at its place."""

from typing import NamedTuple

import numpy as np

from hdsp.abstract.flat_table import cost_limit
from hdsp.abstract.oracle import LabelSettings, task_costs
from hdsp.abstract.transform import feet_at
from hdsp.base.gradual import finished
from hdsp.base.short_repr import short_repr
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.causes import Cause, Obstacle, faults_of, obstacle_steps
from hdsp.detailed.causes.gap import obstacle_of_foot
from hdsp.detailed.relaxed.heading_masks import PoseFlood
from hdsp.detailed.relaxed.proofs import FOOT, why_unreachable
from hdsp.detailed.search.outcome import Status
from hdsp.detailed.world.world import World, build_world
from hdsp.labels.rules import start_base
from hdsp.robot.lattice import ABSTRACT_ACTIONS, HEADINGS_PER_ABSTRACT, N_ABSTRACT_ACTIONS, Grid
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap


class LabelReason(NamedTuple):
    """Reason for the label of a task.

    Attributes:
        status: end of the search, as in ``MapTasks.reason``.
        words: the reason in one line.
        causes: ground that makes the task infeasible; empty for feasible tasks, and where a limit or the labelling
            rules alone decide.
        restricted: whether the labelling rules make the task infeasible: no proof holds without them.
    """

    status: Status
    words: str
    causes: tuple[Cause, ...] = ()
    restricted: bool = False

    def __repr__(self) -> str:
        return short_repr(self)


def label_reasons(
    terrain: HeightMap, robot: Robot, settings: LabelSettings | None = None, start_heading: int = 0
) -> list[LabelReason]:
    """Returns the reasons for the labels of the 22 tasks that start in the middle cell of a map.

    Args:
        terrain: at least 72 x 72 cells; the base starts in cell (nx // 2, ny // 2).
        robot: the robot whose planner makes the labels.
        settings: labelling rules.
        start_heading: detailed start heading, a multiple of 4 in [0, 64).

    Raises:
        InputError: if the map is smaller than a patch, or the heading is no abstract heading.
    """
    base = start_base(terrain, start_heading)
    world, grid = build_world(terrain, robot), Grid(terrain.origin, terrain.shape)
    start = feet_at(world, base)
    if start is None:
        causes = faults_of(world, grid, robot, np.array([*base, 0, 0, 0, 0]))
        words = "the robot cannot stand at the start: " + "; ".join(map(str, causes))
        return [LabelReason(Status.INVALID_START, words, causes)] * N_ABSTRACT_ACTIONS
    settings = settings or LabelSettings()
    limit = cost_limit(robot, settings)
    goals, _, statuses = task_costs(world, start, settings, limit)
    found = []
    for action, goal, status in zip(ABSTRACT_ACTIONS, goals, statuses, strict=True):
        window = HEADINGS_PER_ABSTRACT if action[2] else settings.heading_window
        found.append(_reason(world, grid, robot, start, goal, Status(status), Rules(int(start[2]), window), limit))
    return found


def _reason(
    world: World,
    grid: Grid,
    robot: Robot,
    start: np.ndarray,
    goal: np.ndarray,
    status: Status,
    rules: Rules,
    limit: float,
) -> LabelReason:
    if status == Status.INVALID_GOAL:
        causes = faults_of(world, grid, robot, goal)
        return LabelReason(status, "the robot cannot stand at the goal: " + "; ".join(map(str, causes)), causes)
    if status != Status.INFEASIBLE:
        words = {
            Status.SOLVED: "feasible",
            Status.COST_LIMIT: f"no plan costs less than {limit:.3f}, the limit of labels",
        }
        return LabelReason(status, words.get(status, f"not decided: {str(status).replace('_', ' ')}"))
    obstacle, restricted = _obstacle(world, grid, robot, start, goal, rules)
    parts = [str(obstacle.gap)] if obstacle.gap is not None else []
    parts += map(str, obstacle.causes)
    if restricted:
        parts.append(f"the labelling rules keep the heading within {rules.heading_window} steps of the start")
    if not parts:
        parts.append("everything that can be reached from the start was searched")
    return LabelReason(status, "there is no way: " + "; ".join(parts), obstacle.causes, restricted)


def _obstacle(
    world: World, grid: Grid, robot: Robot, start: np.ndarray, goal: np.ndarray, rules: Rules
) -> tuple[Obstacle, bool]:
    """The obstacle before a goal that is out of reach under the rules, and whether the rules make it an obstacle."""
    proof = why_unreachable(world, start, goal, rules)
    if proof is None:
        return Obstacle((), None), False
    restricted = why_unreachable(world, start, goal) is None
    if proof.proof == FOOT:
        return obstacle_of_foot(proof, world, grid, robot), restricted
    reached = np.bitwise_or.reduce(PoseFlood(world, rules).reached_from(start, drive_only=False))
    return finished(obstacle_steps(world, grid, robot, start, goal, reached, rules)), restricted

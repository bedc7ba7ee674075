"""Relaxed problem with three dimensions: lower bounds on detailed costs over base poses.

The problem has two layers. On neutral feet, the robot drives and turns exactly as in the detailed search. A neutral
pose at which a foot can step leads into the layer of any feet. A pose in this layer is possible if the body is free and
each foot finds some foothold. The base shifts along its heading, at the least state cost over all feet. Where neutral
feet can stand, the robot may return to the neutral layer.

A state that is unreachable here is unreachable in seven dimensions, and costs here never exceed the true costs. The
problem therefore proves infeasibility, and its costs are a consistent heuristic.

Feet left behind by a base shift must follow. If the base only shifts forward, each cell of a shift also counts the
least cost for four feet to follow by one cell (``follow`` per foot). A state whose feet are ahead has less to go:
costs-to-go are ``table(layer, pose) - follow * sum(offsets)``, with offsets counted from the lowest.
"""

from typing import NamedTuple

import numpy as np

from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.bucket_queue import BucketQueue, new_bucket_queue
from hdsp.detailed.relaxed.pose_search import Wave, spread
from hdsp.detailed.relaxed.poses import Poses, new_poses, nodes_of
from hdsp.detailed.search.estimate import least_foot_cost
from hdsp.detailed.world.world import World
from hdsp.robot.lattice import HEADINGS


class Relaxed(NamedTuple):
    """Relaxed costs from one state.

    Attributes:
        poses: poses and the edges between them.
        follow: cost per cell for a foot to follow a base shift.
        distance: float32 [2, poses], costs from the start; layer 0 on neutral feet, 1 on any feet. A state costs
            ``distance + follow * (sum(its offsets) - sum(start's offsets))``.
        driven: float64 [goals], costs by driving and turning alone; inf if driving does not reach the goal within the
            limit.
        cut: whether the limit excluded any pose.
    """

    poses: Poses
    follow: float
    distance: np.ndarray
    driven: np.ndarray
    cut: bool


def explore(
    world: World,
    rules: Rules,
    start: np.ndarray,
    limit: float,
    goals: np.ndarray | None = None,
    poses: Poses | None = None,
) -> Relaxed:
    """Computes the relaxed costs from a state to all poses within a finite cost.

    The search begins with the layer of neutral feet alone, and thus finds the costs of driving. If driving reaches all
    goals, no pose with a higher cost than the farthest goal is explored.

    Args:
        world: terrain and robot.
        rules: restrictions of the search.
        start: int64 [7], at an allowed heading.
        limit: highest cost of interest.
        goals: int64 [n, 7]; None = all reachable poses are of interest.
        poses: poses shared with searches under other rules; they must have all headings allowed by ``rules``.
    """
    poses = poses or new_poses(world, rules.heading_center, rules.heading_window)
    follow = 0.0 if world.constants.shift_backward else least_foot_cost(world)
    n = len(poses.known)
    cost = np.full(2 * n, np.inf, dtype=np.float32)
    slack = follow * float((start[3:] - world.tables.lowest).sum())
    most = limit + slack
    goals = np.empty((0, 7), dtype=np.int64) if goals is None else goals
    goal_layer, goal_pose = nodes_of(world, poses, goals)
    driven = np.full(len(goals), np.inf)
    layer, pose = (int(a[0]) for a in nodes_of(world, poses, start[None]))
    sources, initial, cut = np.array([layer * n + pose]), np.zeros(1), False
    if layer == 0:
        on_neutral = goal_layer == 0
        wanted = np.zeros(n, dtype=np.bool_)
        if on_neutral.all():  # an early end gains nothing if one goal lies in the other layer
            wanted[goal_pose] = True
        wave = Wave(cost, cost, _new_queue(world, rules, most, poses), most, follow, backward=False)
        drive = rules._replace(drive_only=True)
        cut = spread(world, drive, poses, wave, sources, initial, wanted, int(wanted.sum()))
        driven[on_neutral] = cost[goal_pose[on_neutral]]
        driven[driven > limit] = np.inf
        if len(goals) and np.isfinite(driven).all():
            most = min(limit, driven.max()) + slack
        sources = np.flatnonzero(poses.stepping & (cost[:n] <= most))
        initial = cost[sources].astype(float)
        sources += n
    if len(sources) and not rules.drive_only:
        wave = Wave(cost, cost, _new_queue(world, rules, most, poses), most, follow, backward=False)
        cut |= spread(world, rules, poses, wave, sources, initial, np.zeros(n, dtype=np.bool_), 0)
    return Relaxed(poses, follow, cost.reshape(2, n), driven, bool(cut))


def least_costs(world: World, relaxed: Relaxed, start: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Relaxed costs from the start of ``relaxed`` to states int64 [n, 7], float64 [n]; inf beyond the limit."""
    layer, pose = nodes_of(world, relaxed.poses, goals)
    ahead = relaxed.follow * (goals[:, 3:].sum(axis=1) - start[3:].sum())
    return np.maximum(relaxed.distance[layer, pose].astype(float) + ahead, 0)


def costs_to_go(world: World, rules: Rules, relaxed: Relaxed, start: np.ndarray, goals, later, limit: float):
    """Computes the relaxed costs to the nearest of several goals.

    Args:
        world: terrain and robot.
        rules: restrictions of the search.
        relaxed: result of ``explore``.
        start: int64 [7], as for ``explore``.
        goals: int64 [n, 7].
        later: float64 [n], >= 0, additional cost per goal.
        limit: highest cost of interest; poses stay inf if no plan within the limit contains them.

    Returns:
        float32 [2, 64, nx, ny], ``table`` in the module docstring, and whether the limit excluded any pose.
    """
    poses, follow, lowest = relaxed.poses, relaxed.follow, world.tables.lowest
    layer, pose = nodes_of(world, poses, goals)
    n = len(poses.known)
    initial = later + follow * (goals[:, 3:] - lowest).sum(axis=1)
    to_go = np.full(2 * n, np.inf, dtype=np.float32)
    most = limit + follow * float((start[3:] - lowest).sum())
    queue = _new_queue(world, rules, most, poses)
    wave = Wave(to_go, relaxed.distance.reshape(-1), queue, most, follow, backward=True)
    cut = spread(world, rules, poses, wave, layer * n + pose, initial, np.zeros(n, dtype=np.bool_), 0)
    table = np.full((2, HEADINGS, world.nx, world.ny), np.inf, dtype=np.float32)
    headings = (poses.first + np.arange(poses.slots)) % HEADINGS
    table[:, headings] = to_go.reshape(2, poses.slots, world.nx, world.ny)
    return table, bool(cut or relaxed.cut)


def _new_queue(world: World, rules: Rules, most: float, poses: Poses) -> BucketQueue:
    # Buckets may be wider than the smallest edge: a node that becomes cheaper while its bucket is processed is
    # processed again.
    width = max(0.5 * world.constants.turn * rules.turn_cost_factor, most / 4096)
    return new_bucket_queue(width, most, 2 * len(poses.known))

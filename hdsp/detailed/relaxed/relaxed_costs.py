"""A relaxed problem of three dimensions: what the detailed search could at best do at each base pose.

It has two layers. On neutral feet the robot drives and turns exactly as the detailed search does. From a neutral pose
at which a foot can step it may go over into the layer of any feet: there a pose is possible if the body is free and
each foot finds some foothold, the base shifts along its heading at the least state cost over all feet, and where
neutral feet can stand the robot may go back to them. What cannot be reached here cannot be reached in seven dimensions,
and costs here never exceed the true ones: this proves infeasibility and is a consistent heuristic.

Feet that a base shift leaves behind must follow. If the base only shifts forward, each cell costs what four feet need
at least to follow by a cell (``follow``), and a state whose feet are ahead has that much less to go: costs to go are
``table(layer, pose) - follow * sum(offsets)``, with offsets counted from the lowest.
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
    """What can be reached from one state.

    Attributes:
        poses: the poses and the edges between.
        follow: cost per cell that a foot follows a base shift.
        distance: float32 [2, poses]; cost from the start to a state there, but for ``follow`` times by how much its
            offsets are ahead of those of the start; layer 0 on neutral feet, 1 on any.
        driven: float64 [goals]; what driving and turning alone cost, inf where they do not lead.
        cut: whether the limit kept anything out.
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
    """All that the relaxed problem reaches from a state, within a finite cost.

    First the layer of neutral feet alone, which tells what driving costs. If it leads to all goals, nothing that costs
    more than the farthest of them is explored.

    Args:
        world: terrain and robot.
        rules: of the search.
        start: int64 [7], at an allowed heading.
        limit: highest cost of interest.
        goals: int64 [n, 7]; None = all that can be reached is of interest.
        poses: to share with searches under other rules; must have all headings that ``rules`` allow.
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
        if on_neutral.all():  # one farther goal, and there is nothing to be gained from an early end
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
    """Relaxed costs, float64 [n], from the start of ``relaxed`` to states int64 [n, 7]; inf beyond the limit."""
    layer, pose = nodes_of(world, relaxed.poses, goals)
    ahead = relaxed.follow * (goals[:, 3:].sum(axis=1) - start[3:].sum())
    return np.maximum(relaxed.distance[layer, pose].astype(float) + ahead, 0)


def costs_to_go(world: World, rules: Rules, relaxed: Relaxed, start: np.ndarray, goals, later, limit: float):
    """Relaxed costs to the nearest of several goals.

    Args:
        world: terrain and robot.
        rules: of the search.
        relaxed: from ``explore``.
        start: int64 [7], the same as there.
        goals: int64 [n, 7].
        later: float64 [n], >= 0, cost that each goal counts as farther away.
        limit: poses through which no plan up to this cost leads stay inf.

    Returns:
        float32 [2, 64, nx, ny], costs of the module's docstring, and whether the limit kept anything out.
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
    # Buckets need not be narrower than the smallest edge: a node that gets cheaper while its bucket is worked on is
    # taken up again.
    width = max(0.5 * world.constants.turn * rules.turn_cost_factor, most / 4096)
    return new_bucket_queue(width, most, 2 * len(poses.known))

"""The gap between the poses in reach and a goal, and the ground that closes it.

Among all ways from the poses in reach to the poses from which the robot can drive to the goal, the way of least
resistance meets the fewest obstacles: a door that is a little too narrow, rather than the wall beside it. The first
invalid pose on this way names the causes. The way leads over a coarse lattice of poses with neutral feet; the causes
come from the detailed lattice.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hdsp.base.gradual import Steps
from hdsp.base.jit import njit
from hdsp.base.short_repr import short_repr
from hdsp.detailed.actions.state_costs import feet_cells
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.causes.cause import Cause, Kind
from hdsp.detailed.causes.state_faults import faults_of, ground_fault, place_of
from hdsp.detailed.relaxed.heading_masks import PoseFlood
from hdsp.detailed.relaxed.proofs import FOOT, POSE, Unreachable
from hdsp.detailed.world.body import collides
from hdsp.detailed.world.world import World, cell_index
from hdsp.robot.lattice import HEADINGS, Grid, heading_angle
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.height_map import HeightMap

_MOST_POSES = 400_000  # on the coarse lattice; a way takes about a second then
_HEADINGS = 16  # of the coarse lattice
_WRAP = 3  # coarse headings that repeat beyond a whole turn
#: Resistance of a pose, in steps on the coarse lattice: per cell between a foot and the nearest foothold, and of a body
#: that hits the ground.
_PER_CELL, _HIT = 2.0, 10.0


class Gap(NamedTuple):
    """Gap that cuts off a goal. Convention: world coordinates, m and rad.

    Attributes:
        near: (x, y, theta), pose in reach at which the gap begins; (x, y) for a foot.
        far: the same on the other side, different from ``near``.
        foot: name of the foot that does not get across; None for the whole robot.
    """

    near: tuple[float, ...]
    far: tuple[float, ...]
    foot: str | None = None

    def __repr__(self) -> str:
        return short_repr(self)

    @property
    def turns(self) -> bool:
        """Whether both sides differ in their heading only."""
        return self.near[:2] == self.far[:2]

    def __str__(self) -> str:
        return self.words()

    def words(self, proved: bool = True) -> str:
        """The gap in words; ``proved``: nothing closes it, otherwise steps or a way around it may."""
        near, far = f"({self.near[0]:.2f}, {self.near[1]:.2f})", f"({self.far[0]:.2f}, {self.far[1]:.2f}) m"
        if self.foot is not None:
            return f"the {self.foot} foot gets nowhere from {near} to {far}, neither by rolling nor by stepping"
        if near == far[:-2]:
            one, other = (math.degrees(pose[2]) for pose in (self.near, self.far))
            way, stops = f"turn from {one:.0f} to {other:.0f} degrees at {far}", f"turning at {far}"
        else:
            way, stops = f"get from {near} to {far}", f"driving from {near} to {far}"
        if proved:
            return f"the robot cannot {way}"
        return f"an obstacle stops {stops}; steps and ways around it were not searched to the end"


class Obstacle(NamedTuple):
    """Obstacle before a goal.

    Attributes:
        causes: the causes at the first invalid pose in the gap; none if each pose in the gap is valid.
        gap: the gap; None without an invalid pose.
    """

    causes: tuple[Cause, ...]
    gap: Gap | None

    def __repr__(self) -> str:
        return short_repr(self)


def obstacle_steps(
    world: World,
    grid: Grid,
    robot: Robot,
    start: np.ndarray,
    goal: np.ndarray,
    reached: np.ndarray,
    rules: Rules | None = None,
) -> Steps[Obstacle]:
    """Finds the obstacle between the poses in reach and a goal, in short steps.

    Args:
        world: terrain and robot, compiled.
        grid: place of the terrain in the world.
        robot: its limits.
        start, goal: int64 [7], valid states in lattice units.
        reached: uint64 [nx, ny], the headings in reach at each cell, as bits; without the goal.
        rules: restrictions of the search.
    """
    flood = yield from PoseFlood(world, rules or Rules()).steps_from(goal, drive_only=True)
    around_goal = np.bitwise_or.reduce(flood)
    yield
    way = _turn_at(reached, goal)
    obstacle = _first_obstacle(world, grid, robot, way, reached, around_goal) if way is not None else None
    if obstacle is not None:
        theta = float(heading_angle(goal[2]))
        heading = Cause(Kind.HEADING, place_of(grid, goal[:2]), theta)
        return obstacle._replace(causes=(heading, *obstacle.causes))
    yield
    # The longest step comes last: nothing after it asks for as much time again.
    way = _way_of_least_resistance(world, start, goal, reached, around_goal)
    return _first_obstacle(world, grid, robot, way, reached, around_goal) or Obstacle((), None)


def obstacle_of_foot(proof: Unreachable, world: World, grid: Grid, robot: Robot) -> Obstacle:
    """Returns the obstacle in a proof for a single foot (``hdsp.detailed.relaxed.proofs``)."""
    assert proof.proof == FOOT
    name, found = FEET[proof.foot], []
    for x, y in proof.blocked.tolist():
        fault = ground_fault(world, grid, robot, (x, y), name)
        if fault is not None and fault not in found:
            found.append(fault)
    # Unknown ground is the nearest cause; of edges, the highest one counts.
    unknown = [cause for cause in found if cause.kind == Kind.UNKNOWN][:1]
    rest = [max((c for c in found if c.kind == kind), key=lambda c: c.amount or 0.0, default=None)
            for kind in (Kind.EDGE, Kind.SLOPE)]  # fmt: skip
    ends = (place_of(grid, proof.from_start), place_of(grid, proof.from_goal))
    return Obstacle((*unknown, *(cause for cause in rest if cause is not None)), Gap(*ends, foot=name))


def obstacle_of_base(proof: Unreachable, terrain: HeightMap, grid: Grid) -> Obstacle:
    """Returns the obstacle in a proof for the whole robot, as far as it is known without further work."""
    assert proof.proof == POSE
    heading = float(heading_angle(proof.heading))
    x, y = proof.blocked[len(proof.blocked) // 2] if len(proof.blocked) else proof.from_goal
    pose = (*place_of(grid, np.array((x, y))), heading, 0.0, 0.0, 0.0, 0.0)
    hits = [(place_of(grid, cell), float(terrain.heights[tuple(cell)])) for cell in proof.body_hits[:1]]
    causes = tuple(Cause(Kind.BODY, place, height, pose=pose) for place, height in hits)
    near, far = ((*place_of(grid, cell), heading) for cell in (proof.from_start, proof.from_goal))
    return Obstacle(causes, Gap(near, far) if near != far else None)


def _turn_at(reached: np.ndarray, goal: np.ndarray) -> np.ndarray | None:
    """Poses int64 [n, 3] at the goal's cell, from a heading in reach to the goal's heading; None without one."""
    x, y, theta = (int(value) for value in goal[:3])
    bits = int(reached[x, y])
    turns = [t for t in range(-HEADINGS // 2, HEADINGS // 2) if bits >> (theta + t) % HEADINGS & 1]
    if not turns:
        return None
    least = min(turns, key=abs)
    between = range(least, 0, -1 if least > 0 else 1)
    return np.array([(x, y, (theta + t) % HEADINGS) for t in [*between, 0]])


def _holds(bits: np.ndarray, pose: np.ndarray) -> bool:
    return bool(int(bits[pose[0], pose[1]]) >> int(pose[2]) & 1)


def _first_obstacle(
    world: World, grid: Grid, robot: Robot, way: np.ndarray, reached: np.ndarray, around_goal: np.ndarray
) -> Obstacle | None:
    """The obstacle at the first invalid pose after the last reached pose on a way; None without one."""
    last = max((k for k, pose in enumerate(way) if _holds(reached, pose)), default=0)
    # A robot on displaced feet drives on only if neutral feet find footholds at its pose, too.
    for k in [*range(last + 1, len(way)), last]:
        causes = faults_of(world, grid, robot, np.array([*way[k], 0, 0, 0, 0]))
        if causes and last + 1 < len(way):
            after = (pose for pose in way[k + 1 :] if _holds(around_goal, pose))
            return Obstacle(causes, Gap(_pose(grid, way[last]), _pose(grid, next(after, way[-1]))))
    return None


def _pose(grid: Grid, pose: np.ndarray) -> tuple[float, ...]:
    return (*place_of(grid, pose[:2]), float(heading_angle(pose[2])))


def _way_of_least_resistance(
    world: World, start: np.ndarray, goal: np.ndarray, reached: np.ndarray, around_goal: np.ndarray
) -> np.ndarray:
    """Poses int64 [n, 3] from a pose in reach to the goal or to a pose from which the robot can drive to it."""
    from scipy.ndimage import binary_erosion, distance_transform_edt
    from skimage.graph import MCP_Geometric

    stride = max(2, math.ceil(math.sqrt(world.nx * world.ny * (_HEADINGS + 2 * _WRAP) / _MOST_POSES)))
    shift = goal[:2] % stride  # so that the goal is on the coarse lattice
    turn = HEADINGS // _HEADINGS
    away = distance_transform_edt(~world.standable.reshape(-1, world.stride)).astype(np.float32).ravel()
    headings = (int(goal[2]) + turn * np.arange(-_WRAP, _HEADINGS + _WRAP)) % HEADINGS
    costs = 1.0 + _resistance(world, away, shift, stride, headings)
    starts, ends = (_coarse(bits, shift, stride, headings) for bits in (reached, around_goal))
    if len(both := np.argwhere(starts & ends)):
        return _detailed(both[:1], shift, stride, headings)
    # Ways begin and end at the rims.
    inside = [binary_erosion(nodes, np.ones((3, 3, 3)), border_value=True) for nodes in (starts, ends)]
    costs[inside[0]] = np.inf
    starts, ends = (np.argwhere(nodes & ~inner) for nodes, inner in zip((starts, ends), inside, strict=True))
    ways = MCP_Geometric(costs, fully_connected=True)
    near_start = [*np.clip(np.rint((start[:2] - shift) / stride).astype(int), 0, np.array(costs.shape[:2]) - 1)]
    begin = near_start + [int(np.argmin(abs((headings - start[2] + HEADINGS // 2) % HEADINGS - HEADINGS // 2)))]
    ends = np.concatenate([[[*((goal[:2] - shift) // stride), _WRAP]], ends])
    costs_to, _ = ways.find_costs([*starts.tolist(), begin], ends.tolist(), find_all_ends=False)
    arrived = ends[np.argmin(costs_to[tuple(ends.T)])]
    poses = _detailed(np.array(ways.traceback(arrived)), shift, stride, headings)
    return _refined(poses if _holds(reached, poses[0]) else np.concatenate([start[None, :3], poses]))


def _coarse(bits: np.ndarray, shift: np.ndarray, stride: int, headings: np.ndarray) -> np.ndarray:
    """Whether the poses of the coarse lattice are in ``bits``, bool [nx, ny, headings]."""
    sampled = bits[shift[0] :: stride, shift[1] :: stride]
    return (sampled[..., None] >> headings.astype(np.uint64) & np.uint64(1)).astype(bool)


def _detailed(nodes: np.ndarray, shift: np.ndarray, stride: int, headings: np.ndarray) -> np.ndarray:
    """Poses int64 [n, 3] of nodes [n, 3] of the coarse lattice."""
    return np.column_stack([nodes[:, :2] * stride + shift, headings[nodes[:, 2]]])


def _refined(poses: np.ndarray) -> np.ndarray:
    """Adds the detailed poses between coarse poses, int64 [n, 3]."""
    found = [poses[:1]]
    for one, other in pairwise(poses):
        change = other - one
        change[2] = (change[2] + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        steps = max(int(abs(change).max()), 1)
        between = np.rint(one + change * np.arange(1, steps + 1)[:, None] / steps).astype(np.int64)
        between[:, 2] %= HEADINGS
        found.append(between)
    return np.concatenate(found)


@njit()
def _resistance(world, away, shift, stride, headings):
    """Resistance of the poses on a coarse lattice, float64 [nx, ny, headings].

    Args:
        world: terrain and robot.
        away: float32 flat, distance to the nearest foothold, cells.
        shift: int64 [2], first cell.
        stride: cells between neighbouring poses.
        headings: int64 [headings], detailed headings.
    """
    t = world.tables
    nx, ny = (world.nx - shift[0] + stride - 1) // stride, (world.ny - shift[1] + stride - 1) // stride
    found = np.empty((nx, ny, len(headings)))
    o = -t.lowest
    for i in range(nx):
        for j in range(ny):
            p = cell_index(world, shift[0] + stride * i, shift[1] + stride * j)
            for k in range(len(headings)):
                h = headings[k]
                p0, p1, p2, p3 = feet_cells(p, t.feet, t.n_offsets, t.n_samples, h, o, o, o, o)
                feet = np.float64(away[p0]) + away[p1] + away[p2] + away[p3]
                found[i, j, k] = _PER_CELL * feet + _HIT * collides(world, h, p)
    return found

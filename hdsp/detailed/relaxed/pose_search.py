"""Dijkstra over the relaxed problem, forward from a start or back from goals; see ``relaxed_costs``.

A node is ``layer * poses + pose``; layer 0 is on neutral feet, layer 1 on any feet. The backward search visits only
nodes that the forward search reached.
"""

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.action import ARCS, DRIVES, TURN_LEFT, TURN_RIGHT, arc_turn
from hdsp.detailed.actions.any_feet import stands_on_neutral
from hdsp.detailed.relaxed.bucket_queue import BucketQueue, put, take
from hdsp.detailed.relaxed.poses import look_at_feet, look_at_pose
from hdsp.robot.lattice import HEADINGS

_NOTHING = np.float32(0)


class Wave(NamedTuple):
    """One run of Dijkstra's algorithm.

    Attributes:
        cost: float32 [2 * poses], inf if unknown; the result.
        before: float32 [2 * poses]; in a backward search, costs from the forward search.
        queue: waiting nodes; empty at first.
        most: highest cost of interest; in a backward search, the cost from the start included.
        follow: as in ``Relaxed``.
        backward: costs to the sources instead of from them.
    """

    cost: np.ndarray
    before: np.ndarray
    queue: BucketQueue
    most: float
    follow: float
    backward: bool


@njit(allocates=False, nogil=True)
def spread(world, rules, poses, wave, sources, initial, wanted, left):
    """Runs a wave to its end; returns whether ``most`` kept a node out.

    Args:
        world: terrain and robot.
        rules: restrictions; with ``drive_only``, the search stays on neutral feet.
        poses: edges; the forward search fills them in, the backward search reads them.
        wave: changed in place.
        sources: int64 [n], nodes.
        initial: float64 [n], cost at each source.
        wanted: bool [poses], on neutral feet; cleared when settled.
        left: number of wanted poses; the search ends with the last one. 0: the search visits everything.
    """
    nx, ny, size = world.nx, world.ny, len(poses.known)
    cost, heads = wave.cost, wave.queue.heads
    cut, last = False, False
    for s in range(len(sources)):
        if not (wave.backward and wave.before[sources[s]] == np.inf):
            _offer(wave, sources[s], np.float32(initial[s]), _NOTHING)
    for bucket in range(len(heads)):
        if last:
            break
        while heads[bucket] >= 0:
            node = np.int64(heads[bucket])
            take(wave.queue, node)
            so_far = cost[node]
            pose = node if node < size else node - size
            slot, x, y = pose // (nx * ny), pose // ny % nx, pose % ny
            heading = (poses.first + slot) % HEADINGS
            if node < size:
                if not wave.backward and not poses.known[pose]:
                    look_at_pose(world, poses, pose, x, y, heading)
                if left > 0 and wanted[pose]:
                    wanted[pose] = False
                    left -= 1
                    last = left == 0
                cut |= _drive(world, poses, wave, pose, slot, x, y, so_far)
                if world.constants.on_the_spot:
                    cut |= _turn(world, rules, poses, wave, pose, slot, x, y, so_far)
                else:
                    cut |= _drive_arcs(world, rules, poses, wave, pose, slot, x, y, so_far)
                if not rules.drive_only:
                    cut |= _leave_neutral(poses, wave, pose, so_far)
            else:
                cut |= _shift_base(world, poses, wave, pose, slot, x, y, heading, so_far)
                cut |= _return_to_neutral(world, poses, wave, pose, x, y, heading, so_far)
    return cut


@njit(inline="always")
def _offer(wave, node, new, rest):
    """Queues a node at cost ``new`` if this is cheaper; returns whether ``most`` keeps it out."""
    if new >= wave.cost[node]:
        return False
    if new + rest > wave.most:
        return True
    wave.cost[node] = new
    put(wave.queue, node, new)
    return False


@njit(inline="always")
def _was_expanded(poses, wave, pose):
    """Whether the forward search expanded a pose on neutral feet; other poses are too far away."""
    return wave.before[pose] < np.inf and poses.known[pose]


@njit(inline="always")
def _drive(world, poses, wave, pose, slot, x, y, so_far):
    nx, ny, move_dx, move_dy = world.nx, world.ny, world.tables.move_dx, world.tables.move_dy
    cut = False
    for m in range(DRIVES):
        if wave.backward:
            u, v = x - move_dx[m], y - move_dy[m]
            if not (0 <= u < nx and 0 <= v < ny):
                continue
            other = (slot * nx + u) * ny + v
            if not _was_expanded(poses, wave, other):
                continue
            edge, rest = poses.edge[other, m], wave.before[other]
        else:  # an edge never leads off the map
            other, edge, rest = pose + move_dx[m] * ny + move_dy[m], poses.edge[pose, m], _NOTHING
        if edge < np.inf:
            cut |= _offer(wave, other, so_far + edge, rest)
    return cut


@njit(inline="always")
def _turn(world, rules, poses, wave, pose, slot, x, y, so_far):
    factor = np.float32(rules.turn_cost_factor)
    cut = False
    for action, way in ((TURN_LEFT, 1), (TURN_RIGHT, -1)):
        to = slot - way if wave.backward else slot + way
        if poses.slots == HEADINGS:
            to %= HEADINGS
        off = (poses.first + to - rules.heading_center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        if not 0 <= to < poses.slots or abs(off) > rules.heading_window:
            continue
        other = (to * world.nx + x) * world.ny + y
        edge, rest = poses.edge[pose, action], _NOTHING
        if wave.backward:
            if not _was_expanded(poses, wave, other):
                continue
            edge, rest = poses.edge[other, action], wave.before[other]
        if edge < np.inf:
            cut |= _offer(wave, other, so_far + factor * edge, rest)
    return cut


@njit(allocates=False)
def _drive_arcs(world, rules, poses, wave, pose, slot, x, y, so_far):
    nx, ny, arcs = world.nx, world.ny, world.tables.arcs
    factor = np.float32(rules.turn_cost_factor)
    cut = False
    for arc in range(ARCS):
        sign = -1 if wave.backward else 1
        to = slot + sign * arc_turn(arc)
        if poses.slots == HEADINGS:
            to %= HEADINGS
        off = (poses.first + to - rules.heading_center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        if not 0 <= to < poses.slots or abs(off) > rules.heading_window:
            continue
        begins = (poses.first + (to if wave.backward else slot)) % HEADINGS
        u, v = x + sign * arcs[begins, arc, 0], y + sign * arcs[begins, arc, 1]
        if not (0 <= u < nx and 0 <= v < ny):
            continue
        other = (to * nx + u) * ny + v
        edge, rest = poses.edge[pose, TURN_LEFT + arc], _NOTHING
        if wave.backward:
            if not _was_expanded(poses, wave, other):
                continue
            edge, rest = poses.edge[other, TURN_LEFT + arc], wave.before[other]
        if edge < np.inf:
            cut |= _offer(wave, other, so_far + factor * edge, rest)
    return cut


@njit(inline="always")
def _leave_neutral(poses, wave, pose, so_far):
    """Enters the layer of any feet; backward, the edge leads out of it."""
    any_feet = len(poses.known) + pose
    if wave.backward:
        cut = wave.before[any_feet] < np.inf and _offer(wave, any_feet, so_far, wave.before[any_feet])
    else:
        cut = poses.stepping[pose] and _offer(wave, any_feet, so_far, _NOTHING)
    return cut


@njit(inline="always")
def _shift_base(world, poses, wave, pose, slot, x, y, heading, so_far):
    nx, ny, shifts, size = world.nx, world.ny, world.tables.shifts, len(poses.known)
    cut = False
    for sign in (1, -1):
        if sign == -1 and not world.constants.shift_backward:
            continue
        way = -sign if wave.backward else sign
        u, v = x + way * shifts[heading, 0], y + way * shifts[heading, 1]
        if not (0 <= u < nx and 0 <= v < ny):
            continue
        other = (slot * nx + u) * ny + v
        if wave.backward and wave.before[size + other] == np.inf:
            continue
        here = look_at_feet(world, poses, pose, x, y, heading)
        there = look_at_feet(world, poses, other, u, v, heading)
        length = np.sqrt(np.float64(shifts[heading, 0] ** 2 + shifts[heading, 1] ** 2))
        shift = world.constants.base_shift * length * 0.5 * (here + there) + 4 * wave.follow * shifts[heading, 2]
        if shift < np.inf:
            rest = wave.before[size + other] if wave.backward else _NOTHING
            cut |= _offer(wave, size + other, np.float32(so_far + shift), rest)
    return cut


@njit(inline="always")
def _return_to_neutral(world, poses, wave, pose, x, y, heading, so_far):
    """Enters the layer of neutral feet; backward, the edge leads out of it."""
    if wave.backward:
        goes, rest = _was_expanded(poses, wave, pose) and poses.stepping[pose], wave.before[pose]
    else:
        goes, rest = wave.cost[pose] > so_far and stands_on_neutral(world, x, y, heading), _NOTHING
    return goes and _offer(wave, pose, so_far, rest)

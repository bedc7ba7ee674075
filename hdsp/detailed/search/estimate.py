"""The heuristic in the form for the kernels: a flat array and a lookup rule, without calls into Python.

``h = max(max(geometric, table) + feet + steps, costs-to-go between abstract states)``. Each part can be switched off.
With a backward search (``backward``), ``h = max(geometric + feet, relaxed) + steps``; its values rise while the search
goes on.
"""

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.base.records import by_reference
from hdsp.detailed.search.backward import (
    Backward,
    advance,
    begin_toward,
    is_final,
    lower_bound,
    new_backward,
    no_backward,
    settle,
)
from hdsp.detailed.search.interpolation import CostsToGo, interpolated, no_costs_to_go
from hdsp.detailed.states import distinct_rows, unpack
from hdsp.robot.lattice import CELLS_PER_ABSTRACT, HEADINGS, metres


@by_reference
class Estimate(NamedTuple):
    """Parameters of ``estimate``.

    Attributes:
        distance: cost per cell of straight distance to the nearest disc.
        turn: cost per heading step to the headings of this disc.
        discs: int64 [n, 4], discs that contain all goals: base pose in the middle (ix, iy, heading), and the largest
            difference in heading.
        radius: float64 [n], radius of each disc, cells. A single goal is a disc of radius 0.
        foot: cost per cell by which the feet differ from the goal's configuration, up to a common shift.
        goal_feet: int64 [n, 4], foot offsets at one or several goals, counted from the lowest; the nearest goal counts.
        table: float32 [layers, headings, nx, ny] flattened, costs-to-go; empty = none.
        layered: whether the table has two layers, one for neutral feet and one for any feet.
        follow: cost subtracted from a table entry per cell of the summed foot offsets, counted from the lowest.
        neutral: offset of a neutral foot, counted from the lowest.
        table_nx, table_ny: table size, in table cells.
        cells: detailed cells per table cell.
        heading_steps: detailed headings per table heading.
        outside: cost added to the geometric part where the table is inf or ends; inf excludes these states.
        to_go: costs-to-go of abstract states, interpolated between them.
        region: int32, flat as in ``World``, region of each foothold (see ``foothold_regions``).
        effort: float32 [4 * regions], per foot the least effort of steps from a region to the goal; empty = none.
        feet, n_offsets, n_samples, pad, stride: positions of the feet, as in ``World`` and its tables.
        back: backward search over base poses; empty = none.
    """

    distance: float
    turn: float
    discs: np.ndarray
    radius: np.ndarray
    foot: float
    goal_feet: np.ndarray
    table: np.ndarray
    layered: bool
    follow: float
    neutral: int
    table_nx: int
    table_ny: int
    cells: int
    heading_steps: int
    outside: float
    to_go: CostsToGo
    region: np.ndarray
    effort: np.ndarray
    feet: np.ndarray
    n_offsets: int
    n_samples: int
    pad: int
    stride: int
    back: Backward


#: Most foot configurations at the goals that the foot term compares; its time grows with their number.
MOST_FEET = 16
NO_TABLE = np.empty(0, dtype=np.float32)
NO_REGION = np.empty(0, dtype=np.int32)


@njit(inline="always")
def _feet(goal_feet, o0, o1, o2, o3):
    """Least total length, in cells, of single foot moves to a goal's configuration, up to a common shift."""
    least = 1 << 30
    for i in range(len(goal_feet)):
        d0, d1 = o0 - goal_feet[i, 0], o1 - goal_feet[i, 1]
        d2, d3 = o2 - goal_feet[i, 2], o3 - goal_feet[i, 3]
        # Sum of distances to the median: two largest minus two smallest.
        lo1, hi1, lo2, hi2 = min(d0, d1), max(d0, d1), min(d2, d3), max(d2, d3)
        least = min(least, abs(max(hi1, hi2) - min(lo1, lo2)) + abs(min(hi1, hi2) - max(lo1, lo2)))
    return least


@njit(inline="always")
def _way(e, ix, iy, heading):
    """Least cost of distance and turns to a disc."""
    discs, radius = e.discs, e.radius
    least = np.inf
    for i in range(len(radius)):
        dx, dy = np.float64(ix - discs[i, 0]), np.float64(iy - discs[i, 1])
        turned = abs((heading - discs[i, 2] + HEADINGS // 2) % HEADINGS - HEADINGS // 2)
        away, off = max(np.sqrt(dx * dx + dy * dy) - radius[i], 0.0), max(turned - discs[i, 3], 0)
        least = min(least, e.distance * away + e.turn * off)
    return least


@njit(allocates=False)
def estimate(world, e, key):
    """Estimated cost from a packed state to the goal, float64."""
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    way = _way(e, ix, iy, heading)
    h = way
    if len(e.table) > 0:
        a, b = ix // e.cells, iy // e.cells
        k = ((heading + e.heading_steps // 2) // e.heading_steps) % (HEADINGS // e.heading_steps)
        looked_up = np.float64(np.inf)
        if a < e.table_nx and b < e.table_ny:
            row = k
            if e.layered and not (o0 == e.neutral and o1 == e.neutral and o2 == e.neutral and o3 == e.neutral):
                row += HEADINGS
            looked_up = np.float64(e.table[(row * e.table_nx + a) * e.table_ny + b]) - e.follow * (o0 + o1 + o2 + o3)
        if looked_up == np.inf:
            h += e.outside
        else:
            h = max(h, looked_up)
    if e.foot > 0:
        h += e.foot * _feet(e.goal_feet, o0, o1, o2, o3)
    if len(e.back.place) > 0:
        relaxed = _bound(world, e.back, _layer(e, o0, o1, o2, o3), ix, iy, heading)
        relaxed -= e.back.follow * (o0 + o1 + o2 + o3)
        if e.back.follow == 0:
            relaxed += e.foot * _feet(e.goal_feet, o0, o1, o2, o3)
        h = max(h, relaxed)
    if len(e.effort) > 0:
        h += _steps(e, ix, iy, heading, o0, o1, o2, o3)
    if len(e.to_go.values) > 0:
        between = interpolated(world, e.to_go, key)
        # Interpolation rounds off the tip at the goal; the value falls to 0 over the last abstract cell.
        between *= min(1.0, way / (CELLS_PER_ABSTRACT * e.distance))
        h = h + e.outside if between == np.inf else max(h, between)
    return h


@njit(inline="always")
def _layer(e, o0, o1, o2, o3):
    """Layer of a state in the backward search: 0 on neutral feet, else 1."""
    return np.int64(not (o0 == e.neutral and o1 == e.neutral and o2 == e.neutral and o3 == e.neutral))


# Functions that are not inlined take the backward search alone. With the whole estimate as an argument, hundreds of
# numbers, all searches took three times as long. For the same reason, no part of an estimate contains the world.
@njit(allocates=False)
def _bound(world, back, layer, ix, iy, heading):
    """The backward search's lower bound, as far as it is known."""
    begin_toward(world, back, ix, iy, heading)
    return lower_bound(world, back, layer, ix, iy, heading)


@njit(allocates=False)
def _advanced(world, back, layer, ix, iy, heading, wanted):
    """Continues the backward search a little for a pose; returns whether its lower bound is final."""
    begin_toward(world, back, ix, iy, heading)
    if not is_final(world, back, layer, ix, iy, heading):
        advance(world, back, layer, ix, iy, heading, wanted)
    return is_final(world, back, layer, ix, iy, heading)


@njit(inline="always")
def resume(world, e, key, wanted):
    """Continues the backward search a little for a state; returns whether ``estimate`` is final.

    Several calls lead to a final estimate. Final estimates depend on the first state asked, and on no other.

    Args:
        world: terrain and robot.
        e: the estimate.
        key: packed state.
        wanted: an estimate below this value rises to it with few calls, unless it becomes final.
    """
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    wanted += e.back.follow * (o0 + o1 + o2 + o3)
    if len(e.effort) > 0:
        wanted -= _steps(e, ix, iy, heading, o0, o1, o2, o3)
    return _advanced(world, e.back, _layer(e, o0, o1, o2, o3), ix, iy, heading, wanted)


@njit()
def begin_from(world, e, key):
    """Begins the backward search toward a packed state, the start of the forward search."""
    ix, iy, heading, _, _, _, _ = unpack(key)
    begin_toward(world, e.back, ix, iy, heading)


@njit(nogil=True)
def settle_for(world, e, key, nodes):
    """Continues the backward search for a state by about so many nodes; ``estimate`` needs no end of it."""
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    settle(world, e.back, _layer(e, o0, o1, o2, o3), ix, iy, heading, nodes)


@njit(nogil=True)
def final_estimates(world, e, keys):
    """Final estimates, float64 [n], for packed states int64 [n]."""
    result = np.empty(len(keys))
    for i in range(len(keys)):
        if len(e.back.place) > 0:
            while not resume(world, e, keys[i], 0.0):
                pass
        result[i] = estimate(world, e, keys[i])
    return result


@njit(inline="always")
def _steps(e, ix, iy, heading, o0, o1, o2, o3):
    """Least effort of the remaining steps, each foot by itself; inf if a foot has no foothold."""
    p = (ix + e.pad) * e.stride + iy + e.pad
    n = len(e.effort) // 4
    row = heading * 4 * e.n_offsets
    r0 = e.region[p + e.feet[(row + o0) * e.n_samples]]
    r1 = e.region[p + e.feet[(row + e.n_offsets + o1) * e.n_samples]]
    r2 = e.region[p + e.feet[(row + 2 * e.n_offsets + o2) * e.n_samples]]
    r3 = e.region[p + e.feet[(row + 3 * e.n_offsets + o3) * e.n_samples]]
    if min(min(r0, r1), min(r2, r3)) < 0:
        return np.inf
    steps = np.float64(e.effort[r0]) + e.effort[n + r1]
    return steps + (np.float64(e.effort[2 * n + r2]) + e.effort[3 * n + r3])


def geometric_estimate(world, goals, groups=None) -> Estimate:
    """Admissible geometric heuristic: distance, heading difference and foot difference (paper, Sec. VI-B).

    Each part counts the least possible cost on even ground. For several goals, the nearest counts, separately for the
    base and for the feet. The heuristic stays consistent: the minimum over consistent heuristics is consistent.

    Args:
        world: terrain and robot.
        goals: int64 [7] or [n, 7], lattice units.
        groups: int64 [n], number of the disc around each goal, 0, 1, ...; None = each goal by itself.
    """
    goals = np.atleast_2d(np.asarray(goals, dtype=np.int64))
    groups = np.arange(len(goals)) if groups is None else np.asarray(groups)
    around = [disc_around(goals[groups == group, :3]) for group in range(int(groups.max()) + 1)]
    c, t = world.constants, world.tables
    feet = goals[distinct_rows(goals[:, 3:]), 3:]
    length = np.maximum(np.hypot(t.arcs[..., 0], t.arcs[..., 1]), 1.0)
    drive = min(metres(float(t.deviation.min())), float((t.drive_price[0, :, len(t.move_dx) :] / length).min()))
    return Estimate(
        distance=min(drive, c.base_shift),
        turn=c.turn,
        discs=np.array([disc for disc, _ in around], dtype=np.int64),
        radius=np.array([radius for _, radius in around], dtype=float),
        foot=least_foot_cost(world) if len(feet) <= MOST_FEET else 0.0,
        goal_feet=feet - world.tables.lowest,
        table=NO_TABLE,
        layered=False,
        follow=0.0,
        neutral=-world.tables.lowest,
        table_nx=0,
        table_ny=0,
        cells=1,
        heading_steps=1,
        outside=0.0,
        to_go=no_costs_to_go(),
        region=NO_REGION,
        effort=NO_TABLE,
        feet=world.tables.feet,
        n_offsets=world.tables.n_offsets,
        n_samples=world.tables.n_samples,
        pad=world.pad,
        stride=world.stride,
        back=no_backward(),
    )


def disc_around(poses: np.ndarray) -> tuple[tuple[int, int, int, int], float]:
    """Returns the disc around base poses int64 [n, 3]: its middle and difference in heading, and its radius (cells)."""
    low, high = poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)
    x, y = (int(value) for value in (low + high) // 2)
    radius = float(np.hypot(poses[:, 0] - x, poses[:, 1] - y).max())
    # The middle of the shortest arc that contains all headings lies opposite the largest gap between them.
    headings = np.unique(poses[:, 2])
    gaps = np.diff(headings, append=headings[0] + HEADINGS)
    widest = int(np.argmax(gaps))
    span = HEADINGS - int(gaps[widest])
    first = int(headings[(widest + 1) % len(headings)])
    return (x, y, (first + span // 2) % HEADINGS, span - span // 2), radius


def pose_estimate(world, to_go: np.ndarray, follow: float, feet: np.ndarray) -> Estimate:
    """Heuristic from relaxed costs-to-go, plus foot moves to a goal's configuration.

    Args:
        world: terrain and robot.
        to_go: float32 [2, 64, nx, ny], see ``relaxed_costs``.
        follow: cost per cell of foot motion that ``to_go`` already contains.
        feet: int64 [n, 4], foot offsets at the goals.
    """
    table = np.ascontiguousarray(to_go, dtype=np.float32).ravel()
    return geometric_estimate(world, np.zeros(7, dtype=np.int64))._replace(
        distance=0.0,
        turn=0.0,
        foot=0.0 if follow > 0 else least_foot_cost(world),
        goal_feet=np.unique(np.asarray(feet, dtype=np.int64), axis=0) - world.tables.lowest,
        table=table,
        layered=True,
        follow=follow,
        table_nx=to_go.shape[2],
        table_ny=to_go.shape[3],
        outside=np.inf,
    )


def grid_estimate(world, goals, groups, memory: int) -> Estimate:
    """Admissible and consistent heuristic from a backward search over base poses; without efforts of steps.

    Args:
        world: terrain and robot.
        goals: int64 [n, 7], valid states.
        groups: as for ``geometric_estimate``.
        memory: budget of the backward search in bytes.
    """
    goals = np.atleast_2d(np.asarray(goals, dtype=np.int64))
    e = geometric_estimate(world, goals, groups)
    follow = 0.0 if world.constants.shift_backward else least_foot_cost(world)
    return e._replace(back=new_backward(world, goals, e.distance, e.turn, follow, memory))


def with_step_efforts(e: Estimate, region: np.ndarray, efforts: np.ndarray) -> Estimate:
    """Adds each foot's least step effort to an estimate.

    Args:
        e: the estimate.
        region: int32 flat, region of each foothold (``FootholdRegions.region``).
        efforts: float32 [4, regions], per foot from a region to the goal.
    """
    return e._replace(region=region, effort=np.ascontiguousarray(efforts, dtype=np.float32).ravel())


def least_foot_cost(world) -> float:
    """Least cost per cell for moving one foot relative to the others."""
    c, longest = world.constants, world.tables.line.shape[1] - 1
    return min(c.foot_move, c.step_per_metre * metres(1.0) + c.step / max(longest, 1))

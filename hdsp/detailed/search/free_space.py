"""Least costs between poses on even ground without obstacles, for a robot that turns on the spot.

On the way from a pose, the robot passes through an interval of headings. A displacement is a sum of drive moves, each
made at the cheapest heading in the interval. The cost of all drives is therefore a norm of the displacement, whose unit
ball is a polygon with corners in the directions of moves: between two directions, the norm is linear. The least cost is
the minimum over all intervals of the turns through the interval plus this norm. A few intervals suffice for each final
heading and each pair of neighbouring directions; they are listed at the first use.

Moves count in real multiples, so costs never exceed the costs in cells. They are consistent: a drive costs at least its
norm, and a turn extends the interval by one heading.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.base.records import by_reference
from hdsp.detailed.actions.action import DRIVES
from hdsp.detailed.world.world import DRIVE_MOVES, World
from hdsp.robot.lattice import HEADINGS


def _directions() -> np.ndarray:
    steps = np.unique(DRIVE_MOVES // np.gcd(*DRIVE_MOVES.T)[:, None], axis=0)
    return steps[np.argsort(np.mod(np.arctan2(steps[:, 1], steps[:, 0]), 2 * np.pi))]


#: Directions of drive moves as shortest steps, int64 [16, 2], counter-clockwise from (1, 0). The opposite of each
#: direction is a direction.
DIRECTIONS = _directions()
_N = len(DIRECTIONS)
_ROUND = HEADINGS // 2  # further headings beyond an interval's ends cost as much as a full turn
_MOST = 2 * (_ROUND + 1) * (_ROUND + 2)  # intervals for one list, at most
_ROOM = 1 << 14  # intervals in all lists


@by_reference
class FreeSpace(NamedTuple):
    """Costs from one pose; empty for a robot that the rule does not cover.

    Attributes:
        norm: float64 [64 * 64 * 16], cost of a step in each direction, with the headings from a first one on up to a
            number of further ones.
        ways: float64 [3 * intervals], turns through an interval, and its norm as a linear function of the displacement.
        lists: int32 [64 * 16 + 1], place and number of intervals for each turned angle and direction, -1 = none yet;
            the last entry counts the intervals.
    """

    norm: np.ndarray
    ways: np.ndarray
    lists: np.ndarray

    def nbytes(self) -> int:
        """Bytes in use for one pose; all searches of a robot share ``norm``."""
        return self.lists.nbytes + 24 * int(self.lists[-1]) if len(self.lists) else 0


def no_free_space() -> FreeSpace:
    """The empty one."""
    return FreeSpace(_NO_NORM, _NO_NORM, _NO_LISTS)


_NO_NORM, _NO_LISTS = np.empty(0), np.empty(0, np.int32)


def new_free_space(world: World, follow: float) -> FreeSpace:
    """Returns the costs for a robot.

    Args:
        world: terrain and robot.
        follow: cost per cell for a foot to follow a base shift.
    """
    t, c = world.tables, world.constants
    if not c.on_the_spot:
        return no_free_space()
    signs = (1, -1) if c.shift_backward else (1,)
    length = np.hypot(t.shifts[:, 0], t.shifts[:, 1])
    shift_price = c.base_shift * length + 4 * follow * t.shifts[:, 2]
    shifts = np.stack([sign * t.shifts[:, :2] for sign in signs])
    price = t.drive_price[0, :, :DRIVES]
    norm = _norms(price.tobytes(), shifts.tobytes(), shift_price.tobytes(), len(signs))
    if norm is None:
        return no_free_space()
    lists = np.full(HEADINGS * _N + 1, -1, np.int32)
    lists[-1] = 0
    return FreeSpace(norm, np.empty(3 * (_ROOM + _MOST)), lists)


@lru_cache(maxsize=4)
def _norms(price: bytes, shifts: bytes, shift_price: bytes, signs: int) -> np.ndarray | None:
    """Returns ``FreeSpace.norm``; None if a move has no price, or if a base shift is cheaper than drives."""
    prices = np.frombuffer(price).reshape(HEADINGS, DRIVES)
    steps = np.gcd(*DRIVE_MOVES.T)
    per_step = np.full((HEADINGS, _N), np.inf)
    for move in range(DRIVES):
        (k,) = np.flatnonzero((DRIVE_MOVES[move] // steps[move] == DIRECTIONS).all(axis=1))
        per_step[:, k] = np.minimum(per_step[:, k], prices[:, move] / steps[move])
    if not np.isfinite(per_step).all():
        return None
    norm = _hulls(DIRECTIONS.astype(float), per_step)
    moved = np.frombuffer(shifts, np.int64).reshape(signs, HEADINGS, 2)
    own = norm.reshape(HEADINGS, HEADINGS, _N)[:, 0]
    for way in moved:
        if (_at_own_heading(own, way) > np.frombuffer(shift_price)).any():
            return None
    return norm


@njit(nogil=True)
def _hulls(directions, price):
    """Cost of a step in each direction as the cheapest sum of moves, ``FreeSpace.norm``."""
    n = len(directions)
    norm = np.empty(HEADINGS * HEADINGS * n)
    for first in range(HEADINGS):
        least = np.full(n, np.inf)
        for further in range(HEADINGS):
            for s in range(n):
                least[s] = min(least[s], price[(first + further) % HEADINGS, s])
            for s in range(n):
                cost = least[s]
                # Only directions on both sides within half a turn can replace a direction.
                for i in range(1, n // 2):
                    a = (s + n - i) % n
                    for j in range(1, n // 2 - i + 1):
                        b = (s + j) % n
                        across = _cross(directions, a, directions[b, 0], directions[b, 1])
                        if across > 0:
                            x = _cross(directions, s, directions[b, 0], directions[b, 1]) / across
                            y = _cross(directions, a, directions[s, 0], directions[s, 1]) / across
                            cost = min(cost, x * least[a] + y * least[b])
                norm[(first * HEADINGS + further) * n + s] = cost
    return norm


@njit()
def _at_own_heading(norm, shifts):
    """Norm of the base shift at each heading, float64 [64]; ``norm`` float64 [64, 16] of this heading alone."""
    cost = np.empty(HEADINGS)
    for heading in range(HEADINGS):
        dx, dy = shifts[heading, 0], shifts[heading, 1]
        s = _direction(dx, dy)
        along, across = _linear(s, norm[heading, s], norm[heading, (s + 1) % _N])
        cost[heading] = along * dx + across * dy
    return cost


@njit(inline="always")
def _cross(directions, s, dx, dy):
    return directions[s, 0] * dy - directions[s, 1] * dx


@njit(inline="always")
def _direction(dx, dy):
    """Number of the last direction, counter-clockwise, that does not lie beyond a displacement."""
    opposite = dy < 0 or (dy == 0 and dx < 0)
    x, y = (-dx, -dy) if opposite else (dx, dy)
    s = 0
    for i in range(1, _N // 2):
        s += _cross(DIRECTIONS, i, x, y) >= 0
    return s + _N // 2 if opposite else s


@njit(inline="always")
def _linear(s, here, there):
    """The linear function with given values at direction ``s`` and at the next one."""
    z = (s + 1) % _N
    ax, ay, bx, by = DIRECTIONS[s, 0], DIRECTIONS[s, 1], DIRECTIONS[z, 0], DIRECTIONS[z, 1]
    area = np.float64(ax * by - ay * bx)
    return (here * by - there * ay) / area, (there * ax - here * bx) / area


@njit(inline="always")
def free_cost(free, turn, dx, dy, first, heading):
    """Least cost from a pose at heading ``first`` to a pose displaced by (dx, dy) cells; the costs are not empty."""
    s = _direction(dx, dy)
    entry = np.int64(free.lists[((heading - first) % HEADINGS) * _N + s])
    if entry < 0:
        entry = _list_ways(free, turn, first, (heading - first) % HEADINGS, s)
    least = np.inf
    for i in range(entry // _MOST, entry // _MOST + entry % _MOST):
        least = min(least, free.ways[3 * i] + free.ways[3 * i + 1] * dx + free.ways[3 * i + 2] * dy)
    return least


@njit(allocates=False)
def _list_ways(free, turn, first, turned, s):
    """Lists the intervals that can be the cheapest for an angle and a direction; returns their entry.

    Without room, the list serves once.
    """
    norm, ways, z = free.norm, free.ways, (s + 1) % _N
    begin = np.int64(free.lists[-1])
    end = begin
    least_here, least_there = norm[(HEADINGS - 1) * _N + s], norm[(HEADINGS - 1) * _N + z]
    for rounds in range(-2, 2):
        # Heading steps from the first to the last heading, either way round, and with a full turn before.
        steps = turned + rounds * HEADINGS
        done = False
        for more in range(_ROUND + 1):
            for before in range(more + 1):
                low, high = min(steps, 0) - before, max(steps, 0) + more - before
                row = ((first + low) % HEADINGS * HEADINGS + min(high - low, HEADINGS - 1)) * _N
                cost, here, there = turn * (abs(steps) + 2 * more), norm[row + s], norm[row + z]
                needed = True
                for i in range(begin, end):
                    if ways[3 * i] <= cost and ways[3 * i + 1] <= here and ways[3 * i + 2] <= there:
                        needed = False
                        break
                if needed:
                    ways[3 * end], ways[3 * end + 1], ways[3 * end + 2] = cost, here, there
                    end += 1
                done |= here <= least_here and there <= least_there
            if done:
                break
    kept = begin
    for i in range(begin, end):
        needed = True
        for j in range(i + 1, end):
            cheaper = ways[3 * j] <= ways[3 * i] and ways[3 * j + 1] <= ways[3 * i + 1]
            if cheaper and ways[3 * j + 2] <= ways[3 * i + 2]:
                needed = False
                break
        if needed:
            for k in range(3):
                ways[3 * kept + k] = ways[3 * i + k]
            kept += 1
    for i in range(begin, kept):
        ways[3 * i + 1], ways[3 * i + 2] = _linear(s, ways[3 * i + 1], ways[3 * i + 2])
    entry = begin * _MOST + kept - begin
    if kept <= _ROOM:
        free.lists[turned * _N + s], free.lists[-1] = entry, kept
    return entry

"""Textbook twin of `hdsp.detailed.search.interpolation`: costs-to-go between abstract states, in plain Python."""

import itertools
import math

from hdsp.detailed.search.interpolation import PUT_OFF
from tests.naive_ground import CELL, rotated

INF = math.inf
FALLING = 8  # cells; farthest look ahead for falling costs-to-go
NEAR = 2  # cells that a reference within an edge's clearance may be away from its foothold


def to_go_between(twin, values, feet, state):
    """Cost-to-go of a state (ix, iy, heading, 4 offsets).

    Args:
        twin: `Naive`.
        values: float [16, nx, ny], costs-to-go of abstract states.
        feet: dict, (k, a, b) -> 4 reference offsets; neutral feet without an entry.
        state: the state.
    """
    ix, iy, heading = state[:3]
    total = weights = 0.0
    for i, j, n in itertools.product(range(2), repeat=3):
        a, b, k = (ix - 2) // 4 + i, (iy - 2) // 4 + j, (heading // 4 + n) % 16
        parts = ((ix - 2) % 4, i), ((iy - 2) % 4, j), (heading % 4, n)
        shares = [part / 4 if far else 1 - part / 4 for part, far in parts]
        weight = math.prod(shares)
        if weight == 0 or not (0 <= a < values.shape[1] and 0 <= b < values.shape[2]) or values[k, a, b] == INF:
            continue
        ahead, _ = rotated(-heading, 4 * a + 2 - ix, 4 * b + 2 - iy)
        work = correction(twin, values, state, feet.get((k, a, b), (0, 0, 0, 0)), round(ahead), values[k, a, b])
        total += weight * (values[k, a, b] + work)
        weights += weight
    if weights == 0:
        return INF
    put_off = sum(rolling_put_off(twin, state, foot) for foot in range(4))
    return max(total / weights, 0.0) + PUT_OFF * twin.robot.foot_move.cost_per_metre * CELL * put_off


def correction(twin, values, state, reference, ahead, most_rolling):
    """What the feet of a state still have to do before they stand as at an anchor."""
    lowest, highest = twin.robot.offset_range()
    steps = rolling = 0.0
    for foot, offset in enumerate(state[3:]):
        there = min(max(reference[foot] + ahead, lowest), highest)
        roll = twin.robot.foot_move.cost_per_metre * CELL * twin.foot_cost(state, foot)
        work = steps_between(twin, state, foot, min(offset, there), max(offset, there), roll)
        if there >= offset:
            steps += work
            rolling += roll * (reference[foot] - offset)
        elif work > 0 and falls(values, state, min(offset - reference[foot], FALLING)):
            steps -= work
            rolling -= roll * (offset - reference[foot])
        else:
            rolling += roll * abs(reference[foot] - offset)
    return steps + min(rolling, most_rolling)


def steps_between(twin, state, foot, low, high, roll):
    """Cost of all steps of a foot from one offset to a higher one, without the rolling that they save."""
    lowest, highest = twin.robot.offset_range()

    def cell(offset):
        return twin.foothold((*state[:3], *(offset for _ in range(4))), foot)

    first = next((at for at in range(low, max(low - NEAR, lowest) - 1, -1) if twin.standable(cell(at))), None)
    footholds = [] if first is None else [first]
    for at in range(low + 1, min(high + NEAR, highest) + 1):
        if twin.standable(cell(at)):
            footholds.append(at)
            if at >= high:
                break
    limits, work = twin.robot.step, 0.0
    for before, after in itertools.pairwise(footholds):
        if after - before > 1:
            rise = abs(float(twin.height(cell(after))) - float(twin.height(cell(before))))
            effort = limits.cost + limits.cost_per_metre * (after - before) * CELL + limits.cost_per_height * rise
            work += max(twin.state_cost(state) * effort - roll * (after - before), 0.0)
    return work


def falls(values, state, cells):
    """Whether the cost-to-go is lower ``cells`` ahead of a base pose."""
    ix, iy, heading = state[:3]
    x, y = rotated(heading, cells, 0)
    return nearest_value(values, ix + round(x), iy + round(y), heading) < nearest_value(values, ix, iy, heading)


def nearest_value(values, ix, iy, heading):
    a, b = ix // 4, iy // 4
    inside = 0 <= a < values.shape[1] and 0 <= b < values.shape[2]
    return values[(heading + 2) // 4 % 16, a, b] if inside else INF


def rolling_put_off(twin, state, foot):
    """Cells that a foot behind neutral could roll at once, beyond one base shift."""
    reached = offset = state[3 + foot]
    while reached < 0 and twin.standable(twin.foothold((*state[:3], *((reached + 1,) * 4)), foot)):
        reached += 1
    return max(reached - offset - twin.shift(state[2])[0], 0)

"""The robot on a compiled terrain: whether the base is free over its feet, and whether the feet stand on a slope.

The body is free over given feet if nothing rises into its boxes; they lie above the plane through the ground under the
feet (`hdsp.detailed.base_pose`). On neutral feet, the answer depends on the base pose alone; it is computed at the
first look and kept. For other feet, the lowest ground that leaves a level body free is kept instead.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.base_pose import ground_plane

#: Values in ``World.base``.
FREE, BLOCKED = np.uint8(1), np.uint8(2)

_TOUCH = 1e-6  # m; a body that touches the ground by no more is free
_ROUNDING = 1e-5  # relative to heights, for comparisons that others confirm


@njit(allocates=False)
def look_at_body(world, heading, p):
    """Computes and keeps an entry in ``world.base``."""
    known = BLOCKED if collides(world, heading, p) else FREE
    world.base[heading * len(world.standable) + p] = known
    return known


@njit(allocates=False)
def collides(world, heading, p):
    """Whether the base on neutral feet is blocked at flat cell ``p``.

    The ground under the base centre or under a foot is unknown, the ground under a foot is too steep, or the body hits
    the terrain.
    """
    t, height = world.tables, world.height
    row, between = (heading * 4 * t.n_offsets - t.lowest) * t.n_samples, t.n_offsets * t.n_samples
    p0, p1, p2, p3 = (
        p + t.feet[row],
        p + t.feet[row + between],
        p + t.feet[row + 2 * between],
        p + t.feet[row + 3 * between],
    )
    h0, h1, h2, h3 = height[p0], height[p1], height[p2], height[p3]
    if height[p] == -np.inf or min(min(h0, h1), min(h2, h3)) == -np.inf:
        return True
    if is_steep(world, heading, p0, p1, p2, p3):
        return True
    ground, ahead, left = _plane(world, (0, 0, 0, 0), (h0, h1, h2, h3))
    return _touches(world, heading, p, ground, ahead, left)


@njit(inline="always")
def is_steep(world, heading, p0, p1, p2, p3):
    """Whether the ground under any foot, in flat cells, is too steep at this heading but not at every heading."""
    steep = world.steep
    if len(steep) == 0:
        return False
    return ((steep[p0] | steep[p1] | steep[p2] | steep[p3]) >> np.uint64(heading)) & np.uint64(1) != 0


@njit(inline="always")
def _plane(world, x, z):
    """``ground_plane`` under feet with offsets ``x`` (cells) and heights ``z`` (m); gradients in m per cell."""
    c = world.constants
    heights = np.float64(z[0]), np.float64(z[1]), np.float64(z[2]), np.float64(z[3])
    return ground_plane(c.neutral_x, c.neutral_y, c.steepest_ahead, c.steepest_left, x, heights)


@njit(inline="always")
def _touches(world, heading, p, ground, ahead, left):
    """Whether the terrain reaches into a body over a plane."""
    t, height = world.tables, world.height
    cos, sin = t.ahead[heading, 0], t.ahead[heading, 1]
    slope_x, slope_y = ahead * cos - left * sin, ahead * sin + left * cos
    lower = abs(ahead) * t.corner[0] + abs(left) * t.corner[1] - _TOUCH
    for b in range(len(t.box_above)):
        limit = ground + t.box_above[b]
        if world.window_height[p] > limit - lower:
            limit += _TOUCH
            # No part of the body lies lower.
            least = limit - lower - _TOUCH
            least = np.float32(least - _ROUNDING * (1 + abs(least)))
            runs, all_dx, all_dy = t.box_runs[b, heading], t.box_dx[b, heading], t.box_dy[b, heading]
            for run in range(len(runs)):
                first, number, count = p + runs[run, 0], runs[run, 1], runs[run, 2]
                if count == 0:
                    break
                if not _any_above(height, first, count, least):
                    continue
                cells = height[first : first + count]
                dx, dy = all_dx[number : number + count], all_dy[number : number + count]
                above = False
                for k in range(count):
                    above |= cells[k] > limit + (slope_x * dx[k] + slope_y * dy[k])
                if above:
                    return True
    return False


@njit(inline="always")
def _any_above(height, first, count, least):
    """Whether any of ``count`` flat cells is higher; a loop without exits, which processors do in parallel."""
    cells, above = height[first : first + count], False
    for k in range(len(cells)):
        above |= cells[k] > least
    return above


@njit(allocates=False)
def body_is_free(world, heading, p, o0, o1, o2, o3):
    """Whether the base over any feet is free at flat cell ``p``.

    Args:
        world: terrain and robot.
        heading: heading index.
        p: flat cell of the base.
        o0, o1, o2, o3: foot offsets counted from the lowest, each on a foothold.
    """
    t, height = world.tables, world.height
    row, n = heading * 4 * t.n_offsets, t.n_samples
    p0, p1 = p + t.feet[(row + o0) * n], p + t.feet[(row + t.n_offsets + o1) * n]
    p2, p3 = p + t.feet[(row + 2 * t.n_offsets + o2) * n], p + t.feet[(row + 3 * t.n_offsets + o3) * n]
    if height[p] == -np.inf or is_steep(world, heading, p0, p1, p2, p3):
        return False
    feet = o0 + t.lowest, o1 + t.lowest, o2 + t.lowest, o3 + t.lowest
    ground, ahead, left = _plane(world, feet, (height[p0], height[p1], height[p2], height[p3]))
    lower = abs(ahead) * t.corner[0] + abs(left) * t.corner[1]
    least = world.level_ground[heading * len(world.standable) + p]
    if least == 0:  # not yet computed
        if _all_below(world, p, ground - lower):
            return True
        least = level_ground(world, heading, p)
    if ground - lower >= least:
        return True
    if ground + lower < least - _TOUCH:
        return False
    return not _touches(world, heading, p, ground, ahead, left)


@njit(inline="always")
def _all_below(world, p, ground):
    """Whether all ground around the base at flat cell ``p`` lies below a level body over ``ground`` (m)."""
    highest, least = world.window_height[p] + _TOUCH, np.inf
    for b in range(len(world.tables.box_above)):
        least = min(least, world.tables.box_above[b])
    return ground + least >= highest


@njit(allocates=False)
def level_ground(world, heading, p):
    """Lowest ground (m) under the base at flat cell ``p`` with a free level body; -inf over unknown ground alone."""
    known = world.level_ground[heading * len(world.standable) + p]
    if known == 0:
        t, height = world.tables, world.height
        known = np.float32(-np.inf)
        for b in range(len(t.box_above)):
            highest = np.float32(-np.inf)
            for run in range(t.box_runs.shape[2]):
                first, count = p + t.box_runs[b, heading, run, 0], t.box_runs[b, heading, run, 2]
                if count == 0:
                    break
                if _any_above(height, first, count, highest):
                    for z in height[first : first + count]:
                        highest = max(highest, z)
            known = max(known, np.float32(highest - t.box_above[b]))
        if known == 0:  # 0 means not yet computed
            known = np.float32(-1e-30)
        world.level_ground[heading * len(world.standable) + p] = known
    return known


@njit(allocates=False)
def may_be_free(world, heading, p):
    """Whether the base may be free at flat cell ``p`` over some feet on footholds: false only if it never is.

    The highest and the lowest foothold in reach of each foot bound the height and the gradients of the plane.
    """
    t, c, height, standable = world.tables, world.constants, world.height, world.standable
    if height[p] == -np.inf:
        return False
    highest, lowest, total = -np.inf, np.inf, 0.0
    for foot in range(4):
        top = -np.inf
        for offset in range(t.n_offsets):
            q = p + t.feet[((heading * 4 + foot) * t.n_offsets + offset) * t.n_samples]
            if standable[q]:
                top = max(top, np.float64(height[q]))
                lowest = min(lowest, np.float64(height[q]))
        if top == -np.inf:
            return False
        highest = max(highest, top)
        total += top
    span, longest = highest - lowest, t.n_offsets - 1
    ahead = min(c.steepest_ahead, span / max(c.min_separation, 1))
    left = min(c.steepest_left, (span + span / max(c.min_separation, 1) * longest) / (2 * c.neutral_y))
    reach = max(-t.lowest, longest + t.lowest)
    most = 0.25 * total + ahead * (reach + t.corner[0]) + left * t.corner[1]
    most += _TOUCH
    known = world.level_ground[heading * len(world.standable) + p]
    if known != 0:
        return most >= known
    # Most answers need no level ground: the highest ground around is low enough, or some ground soon is too high.
    for b in range(len(t.box_above)):
        if most + t.box_above[b] >= world.window_height[p]:
            continue
        for run in range(t.box_runs.shape[2]):
            first, count = p + t.box_runs[b, heading, run, 0], t.box_runs[b, heading, run, 2]
            cells, above = height[first : first + count], False
            for k in range(len(cells)):
                above |= cells[k] - t.box_above[b] > most
            if above:
                return False
    return True


@njit(allocates=False)
def on_slope(world, heading, p):
    """Whether the ground joins the neutral feet without an edge: no edge lies on the outline between them."""
    outline, edge = world.tables.outline, world.edge
    crossed = False
    for k in range(outline.shape[1]):
        crossed = crossed or edge[p + outline[heading, k]]
    return not crossed

"""Textbook twin of the detailed planner: plain Python from the documented rules, slow and simple.

Convention: lengths are in cells unless a name says metres. A state is a tuple (ix, iy, heading, f0, f1, f2, f3) in
lattice units with signed foot offsets. An action is ("drive", dx, dy), ("turn", +-1), ("arc", +-1 ahead or back,
+-1 left or right), ("foot", i, +-1), ("shift", +-1) or ("step", i, length).
"""

import heapq
import itertools
import math
from functools import cache
from typing import NamedTuple

import numpy as np

CELL = 0.025
HEADINGS = 64
MOVES = [(x, y) for x in range(-2, 3) for y in range(-2, 3) if (x, y) != (0, 0) and not abs(x) == abs(y) == 2]
INF = math.inf
TOUCH = 1e-6  # m; a body that touches the ground by no more is free
REMEMBERED = ["known", "difference", "foothold_difference", "edge", "joined", "steep", "unevenness", "standable",
              "foot_cell", "contact_cell", "cells_of_feet", "contact_height", "blocked", "cost_at", "free", "line",
              "lifted_over", "can_step", "deviation", "least_deviation", "arc"]  # fmt: skip


def angle(heading):
    return 2 * math.pi * heading / HEADINGS


def rotated(heading, x, y):
    """Rotates (x, y) from the robot frame to the world frame."""
    c, s = math.cos(angle(heading)), math.sin(angle(heading))
    return c * x - s * y, s * x + c * y


def deviation_angle(heading, dx, dy):
    """Angle between heading and direction of travel, [0, pi]."""
    x, y = rotated(-heading, dx, dy)
    return abs(math.atan2(y, x))


@cache
def ray(way, n):
    """Offset of the cell ``n`` cells away in one of eight directions over half a turn."""
    return tuple(nearest(n * f(way * math.pi / 8), 1) for f in (math.cos, math.sin))


def nearest(value, direction):
    """Nearest integer to a value; halfway between two integers, the one in the given direction."""
    below = math.floor(value)
    if abs(value - below - 0.5) < 1e-9:
        return below + 1 if direction > 0 else below
    return math.floor(value + 0.5)


@cache
def disc(radius):
    """Cells with centres within a radius, as offsets with distances: (dx, dy, distance)."""
    reach = math.floor(radius + 1e-9)
    cells = itertools.product(range(-reach, reach + 1), repeat=2)
    return [(dx, dy, math.hypot(dx, dy)) for dx, dy in cells if math.hypot(dx, dy) <= radius + 1e-9]


@cache
def rectangle_offsets(rectangle, heading):
    """Cells with centres in a rectangle of a robot with this heading: offsets (dx, dy), and (x, y) in its frame."""
    reach = math.ceil(math.hypot(max(abs(rectangle.x_min), abs(rectangle.x_max)), rectangle.half_width) / CELL)
    found = []
    for dx, dy in itertools.product(range(-reach, reach + 1), repeat=2):
        x, y = rotated(-heading, dx * CELL, dy * CELL)
        if rectangle.x_min - 1e-9 <= x <= rectangle.x_max + 1e-9 and abs(y) <= rectangle.half_width + 1e-9:
            found.append((dx, dy, *rotated(-heading, dx, dy)))
    return found


def turned(heading, other):
    """Heading steps between two headings, along the shorter direction."""
    off = abs(heading - other) % HEADINGS
    return min(off, HEADINGS - off)


class Naive:
    """A terrain and a robot. Nothing is computed in advance; results are only cached.

    Args:
        heights: float32 [nx, ny], m, NaN = unknown.
        robot: an `hdsp.Robot`.
        center, window, turn_factor, drive_only: labelling rules (`hdsp.detailed.actions.successors.Rules`).
    """

    def __init__(self, heights, robot, center=0, window=HEADINGS, turn_factor=1.0, drive_only=False):
        self.heights = [[np.float32(h) for h in row] for row in heights]
        self.shape = len(self.heights), len(self.heights[0])
        self.robot = robot
        self.center, self.window, self.turn_factor, self.drive_only = center, window, turn_factor, drive_only
        for name in REMEMBERED:
            setattr(self, name, cache(getattr(self, name)))

    # --- terrain ----------------------------------------------------------------------------------------------------

    def inside(self, cell):
        return 0 <= cell[0] < self.shape[0] and 0 <= cell[1] < self.shape[1]

    def height(self, cell):
        return self.heights[cell[0]][cell[1]]

    def known(self, cell):
        return self.inside(cell) and not math.isnan(self.height(cell))

    def around(self, cell, radius):
        """Map cells with centres within a radius, with their distances."""
        for dx, dy, distance in disc(radius):
            other = cell[0] + dx, cell[1] + dy
            if self.inside(other):
                yield other, distance

    def difference(self, cell):
        """Height difference dH: the largest one to a known cell among eight neighbours, m."""
        if not self.known(cell):
            return 0.0
        neighbours = [other for other, _ in self.around(cell, 1.5) if self.known(other)]
        return max(float(abs(self.height(other) - self.height(cell))) for other in neighbours)

    def contact_height(self, cell):
        """Height at which a foot touches the ground in a known cell, m."""
        half = math.floor(self.robot.feet.contact_half_width / CELL + 1e-9)
        square = itertools.product(range(-half, half + 1), repeat=2)
        cells = [(cell[0] + i, cell[1] + j) for i, j in square]
        return max(self.height(other) for other in cells if self.known(other))

    def foothold_difference(self, cell):
        """Largest difference between the contact heights of a cell and its eight neighbours, m."""
        if not self.known(cell):
            return 0.0
        neighbours = [other for other, _ in self.around(cell, 1.5) if self.known(other)]
        here = self.contact_height(cell)
        return max(float(abs(self.contact_height(other) - here)) for other in neighbours)

    def edge(self, cell):
        """Whether no wheel passes a map cell."""
        return not self.known(cell) or self.difference(cell) > np.float32(self.robot.drive.highest_edge)

    def steep(self, cell, heading):
        """Whether the ground at a cell is too steep for a foot of a robot at this heading."""
        rolled_over, slope = float(np.float32(self.robot.drive.highest_edge)), self.robot.slope
        steepest = math.tan(slope.max_pitch), math.tan(slope.max_roll)
        # Along this length, an edge that a wheel passes is no steeper than the limit.
        longest = max(math.ceil(self.robot.drive.highest_edge / min(steepest) / CELL / 2 - 1e-9), 1)
        for way, n in itertools.product(range(8), range(1, longest + 1)):
            dx, dy = ray(way, n)
            ends = [(cell[0] + dx, cell[1] + dy), (cell[0] - dx, cell[1] - dy)]
            if not self.joined(cell, way, n):
                continue
            rise = abs(float(self.height(ends[0])) - float(self.height(ends[1])))
            x, y = rotated(-heading, dx, dy)
            largest = math.hypot(steepest[0] * x, steepest[1] * y) / math.hypot(dx, dy)
            if rise > rolled_over * (1 + 1e-5) and rise / (2 * CELL * math.hypot(dx, dy)) > largest * (1 + 1e-5):
                return True
        return False

    def joined(self, cell, way, reach):
        """Whether no edge lies up to ``reach`` cells on either side of a cell, in one of eight directions."""
        for n in range(1, reach + 1):
            dx, dy = ray(way, n)
            for end in ((cell[0] + dx, cell[1] + dy), (cell[0] - dx, cell[1] - dy)):
                if not self.inside(end) or self.edge(end):
                    return False
        return True

    def always_steep(self, cell):
        return all(self.steep(cell, heading) for heading in range(HEADINGS))

    def barrier(self, cell):
        """Whether no wheel passes a map cell at any heading."""
        return self.edge(cell) or self.always_steep(cell)

    def unevenness(self, cell):
        """S of a cell, m."""
        radius = self.robot.drive.unevenness_radius / CELL
        near = self.around(cell, radius)
        return sum(self.foothold_difference(other) * max(0.0, 1 - r / radius) for other, r in near)

    def standable(self, cell):
        if not self.inside(cell):
            return False
        if any(self.edge(other) for other, _ in self.around(cell, self.robot.feet.clearance / CELL)):
            return False
        return not self.always_steep(cell)

    # --- robot on the terrain ---------------------------------------------------------------------------------------

    def foot_cell(self, heading, foot, offset, dx=0.0, dy=0.0):
        """Foot cell relative to the base cell before a move by (dx, dy); ties go forward and to the body."""
        x, y = self.neutral(foot)
        at = rotated(heading, x + offset, y)
        tie = rotated(heading, 2.0, -math.copysign(1.0, y))  # forward has priority over the body
        return nearest(at[0] + dx, tie[0]), nearest(at[1] + dy, tie[1])

    def neutral(self, foot):
        feet = self.robot.feet
        x, y = feet.neutral_x / CELL, feet.neutral_y / CELL
        return (x if foot in (0, 3) else -x), (y if foot in (0, 1) else -y)

    def foothold(self, state, foot):
        dx, dy = self.foot_cell(state[2], foot, state[3 + foot])
        return state[0] + dx, state[1] + dy

    def in_rectangle(self, base, heading, rectangle):
        """Known cells with centres in a rectangle of the robot, with (x, y) in its frame."""
        for dx, dy, x, y in rectangle_offsets(rectangle, heading):
            if self.known((base[0] + dx, base[1] + dy)):
                yield (base[0] + dx, base[1] + dy), x, y

    def contact_cell(self, heading, foot, offset, dx=0.0, dy=0.0):
        """Middle cell of a foot's contact, like `foot_cell`, but with the move rounded separately."""
        inward = self.robot.feet.contact_inward / CELL
        x, y = (v - math.copysign(inward, v) for v in self.neutral(foot))
        at = rotated(heading, x + offset, y)
        tie = rotated(heading, 2.0, -math.copysign(1.0, y))
        return tuple(nearest(at[i], tie[i]) + nearest((dx, dy)[i], tie[i]) for i in range(2))

    def uneven_under(self, cell):
        """S paid by a foot with the middle of its contact in a cell, m."""
        return self.unevenness(cell) if self.inside(cell) else 0.0

    def uneven_under_foot(self, state, foot):
        dx, dy = self.contact_cell(state[2], foot, state[3 + foot])
        return self.uneven_under((state[0] + dx, state[1] + dy))

    def plane(self, heading, offsets, footholds):
        """Ground of the base: height under its centre (m), gradients ahead and to the left (m per cell)."""
        x = [self.neutral(i)[0] + offset for i, offset in enumerate(offsets)]
        z = [float(self.height(cell)) for cell in footholds]

        def mean(values, feet):
            return sum(values[i] for i in feet) / len(feet)

        front, rear, left, right = (0, 3), (1, 2), (0, 1), (2, 3)
        ahead = (mean(z, front) - mean(z, rear)) / (mean(x, front) - mean(x, rear))
        across = mean(z, left) - mean(z, right) - ahead * (mean(x, left) - mean(x, right))
        across /= 2 * self.neutral(0)[1]
        steepest = [math.tan(limit) * CELL for limit in (self.robot.slope.max_pitch, self.robot.slope.max_roll)]
        ahead, across = (max(-most, min(most, v)) for v, most in zip((ahead, across), steepest, strict=True))
        return mean(z, range(4)) - ahead * mean(x, range(4)), ahead, across

    def blocked(self, base, heading, offsets):
        """Whether the base over feet on known ground is blocked; on other ground it always is."""
        footholds = [self.foothold((*base, heading, *offsets), i) for i in range(4)]
        if not all(self.known(cell) for cell in (base, *footholds)):
            return True
        if any(self.steep(cell, heading) for cell in footholds):
            return True
        ground, ahead, across = self.plane(heading, offsets, footholds)
        for box in self.robot.body.boxes:
            for cell, x, y in self.in_rectangle(base, heading, box):
                if float(self.height(cell)) > ground + ahead * x + across * y + box.above + TOUCH:
                    return True
        return False

    def may_be_free(self, base, heading):
        """Whether the bounds on height and gradients of the plane leave the body free over some feet."""
        low, high = self.robot.offset_range()
        in_reach = []
        for foot in range(4):
            cells = [self.foothold((*base, heading, *[offset] * 4), foot) for offset in range(low, high + 1)]
            in_reach.append([float(self.height(cell)) for cell in cells if self.standable(cell)])
        if not self.known(base) or not all(in_reach):
            return False
        span = max(map(max, in_reach)) - min(map(min, in_reach))
        apart = max(math.ceil(self.robot.feet.min_separation / CELL - 1e-9), 1)
        slope = self.robot.slope
        ahead = min(math.tan(slope.max_pitch) * CELL, span / apart)
        across = min(math.tan(slope.max_roll) * CELL, span * (1 + (high - low) / apart) / (2 * self.neutral(0)[1]))
        boxes = self.robot.body.boxes
        length = max(max(abs(box.x_min), abs(box.x_max)) for box in boxes) / CELL
        width = max(box.half_width for box in boxes) / CELL
        most = sum(map(max, in_reach)) / 4 + ahead * (max(-low, high) + length) + across * width
        return all(
            float(self.height(cell)) <= most + box.above + TOUCH
            for box in boxes
            for cell, _, _ in self.in_rectangle(base, heading, box)
        )

    def cost_at(self, base, heading, offsets, footholds, contacts):
        """State cost C for a base cell, four foot cells and four contact cells; inf if the state is invalid.

        On a drive move, the feet are between cells; the base counts as free if it is so over its own cell.
        """
        if not all(self.standable(cell) for cell in footholds) or self.blocked(base, heading, offsets):
            return INF
        uneven = [self.uneven_under(cell) for cell in contacts]
        return 1 + self.robot.drive.unevenness_cost * (max(uneven) + sum(uneven))

    def state_cost(self, state):
        return self.cost_on_the_way(state, 0.0, 0.0)

    def cost_on_the_way(self, state, dx, dy):
        """State cost after a move by (dx, dy) cells from a state."""
        ix, iy, heading, *feet = state
        base = ix + nearest(dx, dx), iy + nearest(dy, dy)
        relative = self.cells_of_feet(heading, tuple(feet), dx, dy)
        footholds, contacts = (tuple((ix + x, iy + y) for x, y in cells) for cells in relative)
        return self.cost_at(base, heading, tuple(feet), footholds, contacts)

    def cells_of_feet(self, heading, feet, dx, dy):
        """Foot cells and contact cells relative to the base cell before a move."""
        return [[of(heading, i, feet[i], dx, dy) for i in range(4)] for of in (self.foot_cell, self.contact_cell)]

    def valid(self, state):
        low, high = self.robot.offset_range()
        return all(low <= offset <= high for offset in state[3:]) and self.state_cost(state) < INF

    def separated(self, state):
        """Whether front and rear foot on each side keep their distance."""
        apart = 2 * self.robot.feet.neutral_x / CELL
        least = self.robot.feet.min_separation / CELL - 1e-9
        return apart + state[3] - state[4] >= least and apart + state[6] - state[5] >= least

    # --- actions ----------------------------------------------------------------------------------------------------

    def successors(self, state):
        """All (action, state, cost) from a valid state."""
        if not any(state[3:]):
            yield from self.drives(state)
        if self.free(state):
            yield from self.turns(state) if self.robot.turn.on_the_spot else self.arcs(state)
        if not self.drive_only and (any(state[3:]) or self.any_foot_can_step(state)):
            yield from self.foot_moves(state)
            yield from self.base_shifts(state)
            yield from self.steps(state)

    def free(self, state):
        """Whether the robot may turn and drive in any direction.

        All feet are neutral; they are at about the same height, or no edge separates neighbouring feet.
        """
        heights = [float(self.height(self.foothold(state, i))) for i in range(4)]
        level = max(heights) - min(heights) <= self.robot.drive.level
        return not any(state[3:]) and (level or self.on_slope(state))

    def on_slope(self, state):
        """Whether no edge lies on the outline of the rectangle between the neutral feet."""
        corners = [self.neutral(i) for i in range(4)]
        for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
            points = math.ceil(2 * math.hypot(bx - ax, by - ay))
            for n in range(points + 1):
                x, y = rotated(state[2], ax + (bx - ax) * n / points, ay + (by - ay) * n / points)
                # A point between two cells touches both.
                for i, j in itertools.product((-1, 1), repeat=2):
                    cell = state[0] + nearest(x, i), state[1] + nearest(y, j)
                    if self.inside(cell) and self.barrier(cell):
                        return False
        return True

    def drives(self, state):
        ix, iy, heading = state[:3]
        for dx, dy in MOVES:
            if not self.free(state) and not self.straight(heading, dx, dy):
                continue
            samples = math.floor(math.hypot(dx, dy)) + 1
            costs = [self.cost_on_the_way(state, dx * i / samples, dy * i / samples) for i in range(1, samples + 1)]
            cost = math.hypot(dx, dy) * CELL * self.deviation(heading, dx, dy) * sum(costs) / samples
            if cost < INF:
                yield ("drive", dx, dy), (ix + dx, iy + dy, *state[2:]), cost

    def straight(self, heading, dx, dy):
        """Whether a move goes forward or backward; a robot with feet at different heights can only drive such moves."""
        deviation = deviation_angle(heading, dx, dy)
        return min(deviation, math.pi - deviation) <= self.robot.drive.straight_deviation + 1e-9

    def deviation(self, heading, dx, dy):
        """Cost factor for driving toward (dx, dy); inf if the robot cannot drive there."""
        f = self.robot.drive.deviation_cost
        deviation = deviation_angle(heading, dx, dy)
        if not self.robot.drive.sideways or f.side == INF:
            x, y = rotated(-heading, dx, dy)
            straight = f.ahead if x > 0 else f.behind
            # The robot pays its way along its heading and its way across.
            return straight * (abs(x) + abs(y)) / math.hypot(x, y) if self.straight(heading, dx, dy) else INF
        if deviation <= f.side_from:
            return f.ahead + (f.side - f.ahead) * deviation / f.side_from
        if deviation <= f.side_to + 1e-9:
            return f.side
        if f.behind == INF:
            return INF
        return f.side + (f.behind - f.side) * (deviation - f.side_to) / (math.pi - f.side_to)

    def turns(self, state):
        turn = self.robot.turn
        for way in (1, -1):
            reached = (*state[:2], (state[2] + way) % HEADINGS, *state[3:])
            if turned(reached[2], self.center) > self.window or self.state_cost(reached) == INF:
                continue
            uneven = sum(self.uneven_under_foot(end, i) for end in (state, reached) for i in range(4))
            yield ("turn", way), reached, turn.cost * self.turn_factor * (1 + turn.unevenness_cost * uneven / 2)

    def arcs(self, state):
        turn = self.robot.turn
        for ahead, way in itertools.product((1, -1), (1, -1)):
            dx, dy, factor = self.arc(state[2], ahead, way)
            new = (state[2] + way) % HEADINGS
            if factor == INF or turned(new, self.center) > self.window:
                continue
            reached = (state[0] + dx, state[1] + dy, new, *state[3:])
            samples = math.floor(math.hypot(dx, dy)) + 1
            costs = [
                self.cost_on_the_way(state if 2 * i < samples else (*state[:2], new, *state[3:]), dx * t, dy * t)
                for i, t in ((i, i / samples) for i in range(1, samples + 1))
            ]
            if max(costs) < INF:
                uneven = sum(self.uneven_under_foot(end, i) for end in (state, reached) for i in range(4))
                drive = math.hypot(dx, dy) * CELL * factor * sum(costs) / samples
                yield (
                    ("arc", ahead, way),
                    reached,
                    self.turn_factor * (drive + turn.cost * (1 + turn.unevenness_cost * uneven / 2)),
                )

    def arc(self, heading, ahead, way):
        """Displacement by an arc and its cost factor: the cell beyond the radius nearest to the circle's end."""
        f, chord = self.robot.drive.deviation_cost, 2 * self.robot.turn.radius / CELL * math.sin(math.pi / HEADINGS)
        mean = math.pi * (2 * heading + way) / HEADINGS
        ux, uy = ahead * math.cos(mean), ahead * math.sin(mean)
        reach = math.ceil(chord) + 3
        found = []
        for dx, dy in itertools.product(range(-reach, reach + 1), repeat=2):
            along, across = dx * ux + dy * uy, abs(dy * ux - dx * uy)
            off = math.atan2(across, along)
            if math.hypot(dx, dy) >= max(chord - 1e-9, 0.5) and off <= self.robot.drive.straight_deviation + 1e-9:
                found.append((round(math.hypot(along - chord, across), 9), dx, dy, off))
        if not found:
            return 0, 0, INF
        _, dx, dy, off = min(found)
        if self.robot.drive.sideways and f.side < INF:
            return dx, dy, self.robot.drive.factor(off if ahead == 1 else math.pi - off)
        return dx, dy, (f.ahead if ahead == 1 else f.behind) * (math.cos(off) + math.sin(off))

    def foot_moves(self, state):
        price = self.robot.foot_move.cost_per_metre * CELL
        for i, way in itertools.product(range(4), (1, -1)):
            reached = with_offset(state, i, state[3 + i] + way)
            toward_neutral = abs(reached[3 + i]) < abs(state[3 + i])
            if toward_neutral and self.valid(reached) and self.separated(reached):
                alone = [self.foot_cost(end, i) for end in (state, reached)]
                yield ("foot", i, way), reached, price * sum(alone) / 2

    def foot_cost(self, state, foot):
        return 1 + 10 * self.robot.drive.unevenness_cost * self.uneven_under_foot(state, foot)

    def base_shifts(self, state):
        ix, iy, heading, *feet = state
        n, dx, dy = self.shift(heading)
        price = self.robot.base_shift.cost_per_metre * CELL * math.hypot(dx, dy)
        for way in (1, -1) if self.robot.base_shift.backward else (1,):
            reached = (ix + way * dx, iy + way * dy, heading, *(offset - way * n for offset in feet))
            followed = self.any_foot_can_step(state) or any(way * offset > 0 for offset in feet)
            if followed and self.valid(reached):
                yield ("shift", way), reached, price * (self.state_cost(state) + self.state_cost(reached)) / 2

    def shift(self, heading):
        """Steps and cells of a base shift: among one to four steps ahead, the number with the end nearest to a cell."""
        ways = []
        for n in range(1, 5):
            x, y = rotated(heading, n, 0)
            dx, dy = nearest(x, x), nearest(y, y)
            ways.append((round(math.hypot(dx - x, dy - y), 9), n, dx, dy))
        return min(ways)[1:]

    # --- steps ------------------------------------------------------------------------------------------------------

    def line(self, cell, heading, way, length):
        """The cell ``length`` steps ahead of another cell, or behind it."""
        x, y = rotated(heading, way * length, 0)
        return cell[0] + nearest(x, x), cell[1] + nearest(y, y)

    def lifted_over(self, cell):
        """Highest ground under a foot that swings over a cell; inf beside unknown ground."""
        if not self.inside(cell):
            return INF
        cells = [other for other, _ in self.around(cell, self.robot.feet.clearance / CELL)]
        return max(float(self.height(c)) if self.known(c) else INF for c in cells)

    def longest_step(self):
        return math.floor(self.robot.step.max_length / CELL + 1e-9)

    def step_fits(self, foothold, landing, heading, way, length):
        """Whether a foot can step over an edge to the cell ``length`` steps away."""
        if not (self.standable(foothold) and self.standable(landing)):
            return False
        if self.standable(self.line(foothold, heading, way, 1)):
            return False  # the foot can roll further
        passed = [self.line(foothold, heading, way, n) for n in range(1, length + 1)]
        if not any(self.inside(cell) and self.barrier(cell) for cell in passed):
            return False
        before, after = float(self.height(foothold)), float(self.height(landing))
        highest = max([before, after, *(self.lifted_over(cell) for cell in passed)])
        limits = self.robot.step
        return abs(after - before) <= limits.max_height and highest - min(before, after) <= limits.max_clearance

    def can_step(self, cell, heading, way):
        """Whether a foot in a cell has a foothold in line behind an edge."""
        lengths = range(1, self.longest_step() + 1)
        return any(self.step_fits(cell, self.line(cell, heading, way, n), heading, way, n) for n in lengths)

    def any_foot_can_step(self, state):
        ways = itertools.product(range(4), self.step_ways())
        return any(self.can_step(self.foothold(state, i), state[2], way) for i, way in ways)

    def step_ways(self):
        return (1, -1) if self.robot.step.backward else (1,)

    def supported(self, state, lifted):
        """Whether the base centre lies in the triangle of the other feet, with the margin."""
        feet = [(x + state[3 + i], y) for i, (x, y) in enumerate(map(self.neutral, range(4))) if i != lifted]
        for (ax, ay), (bx, by) in ((feet[0], feet[1]), (feet[1], feet[2]), (feet[2], feet[0])):
            # Feet are numbered counter-clockwise: inside is to the left of every side.
            left = ((by - ay) * ax - (bx - ax) * ay) / math.hypot(bx - ax, by - ay)
            if left < self.robot.step.support_margin / CELL - 1e-9:
                return False
        return True

    def steps(self, state):
        limits = self.robot.step
        for i, way in itertools.product(range(4), self.step_ways()):
            foothold = self.foothold(state, i)
            if not self.supported(state, i) or not self.can_step(foothold, state[2], way):
                continue
            for length in range(1, self.longest_step() + 1):
                reached = with_offset(state, i, state[3 + i] + way * length)
                if not (self.valid(reached) and self.separated(reached)):
                    continue
                landing = self.foothold(reached, i)
                if self.step_fits(foothold, landing, state[2], way, length):
                    rise = abs(float(self.height(landing)) - float(self.height(foothold)))
                    effort = limits.cost + limits.cost_per_metre * length * CELL + limits.cost_per_height * rise
                    cost = effort * (self.state_cost(state) + self.state_cost(reached)) / 2
                    yield ("step", i, way * length), reached, cost
                    break  # the nearest foothold behind the edge is enough, because the foot can roll from there

    # --- heuristic and feet -----------------------------------------------------------------------------------------

    def least_deviation(self):
        drives = [self.deviation(heading, dx, dy) for heading in range(HEADINGS) for dx, dy in MOVES]
        if self.robot.turn.on_the_spot:
            return min(drives)
        arcs = itertools.product(range(HEADINGS), (1, -1), (1, -1))
        return min([*drives, *(self.arc(*which)[2] for which in arcs)])

    def geometric(self, state, goal):
        """Distance, heading difference and foot configuration difference, each with its least possible cost."""
        return self.geometric_to_nearest(state, [goal], [(*goal[:3], 0, 0.0)])

    def geometric_to_nearest(self, state, goals, discs):
        """The same for the nearest of several goals in discs (x, y, heading, difference in heading, radius)."""
        robot = self.robot
        factor = self.least_deviation()
        longest = self.longest_step()
        distance = min(factor, robot.base_shift.cost_per_metre) * CELL
        step = (robot.step.cost + robot.step.cost_per_metre * CELL * longest) / longest if longest else INF
        foot = min(robot.foot_move.cost_per_metre * CELL, step)

        def moved(feet):
            apart = [a - b for a, b in zip(state[3:], feet, strict=True)]
            return min(sum(abs(d - common) for d in apart) for common in range(min(apart), max(apart) + 1))

        def way(x, y, heading, slack, radius):
            away, off = math.hypot(state[0] - x, state[1] - y) - radius, turned(state[2], heading) - slack
            return distance * max(away, 0) + robot.turn.cost * max(off, 0)

        return min(way(*disc) for disc in discs) + foot * min(moved(goal[3:]) for goal in goals)

    def feet_value(self, state):
        """Objective of T_a->d over the feet: the state cost, plus a cost for the distance from neutral positions."""
        preference = self.robot.feet.neutral_preference * CELL
        return self.state_cost(state) + preference * sum(abs(offset) for offset in state[3:])

    def best_feet(self, ix, iy, heading):
        """Least value over all foot configurations for a base state, and its state; (inf, None) if there is none."""
        low, high = self.robot.offset_range()
        states = ((ix, iy, heading, *feet) for feet in itertools.product(range(low, high + 1), repeat=4))
        found = [(self.feet_value(state), state) for state in states if self.separated(state) and self.valid(state)]
        return min(found, default=(INF, None))


def with_offset(state, foot, offset):
    return (*state[: 3 + foot], offset, *state[4 + foot :])


class Gone(NamedTuple):
    """Result of Dijkstra: least costs to settled states, and whether all reachable states are settled."""

    cost: dict
    exhausted: bool
    before: dict


def dijkstra(twin, start, goals=(), most=INF):
    """Least costs from a state, until all goals or ``most`` states are settled."""
    best, before, settled, queue = {start: 0.0}, {}, {}, [(0.0, start)]
    missing = set(goals)
    while queue:
        cost, state = heapq.heappop(queue)
        if state in settled:
            continue
        settled[state] = cost
        missing.discard(state)
        if (goals and not missing) or len(settled) >= most:
            return Gone(settled, False, before)
        for action, reached, price in twin.successors(state):
            if cost + price < best.get(reached, INF):
                best[reached] = cost + price
                before[reached] = state, action
                heapq.heappush(queue, (cost + price, reached))
    return Gone(settled, True, before)


def way_back(gone, state):
    """Actions from the start to a settled state."""
    actions = []
    while state in gone.before:
        state, action = gone.before[state]
        actions.append(action)
    return actions[::-1]

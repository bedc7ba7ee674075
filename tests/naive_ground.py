"""Textbook twin of the ground: footholds, costs and validity of states, in plain Python from the documented rules.

Conventions as in `tests.naive`.
"""

import itertools
import math
from functools import cache

import numpy as np

CELL = 0.025
HEADINGS = 64
MOVES = [(x, y) for x in range(-2, 3) for y in range(-2, 3) if (x, y) != (0, 0) and not abs(x) == abs(y) == 2]
INF = math.inf
TOUCH = 1e-6  # m; a body that touches the ground by no more is free
ULP = 2.0**-23  # distance between neighbouring float32 values, as a share of them
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


def rounding(height):
    """Excess (m) of a difference of heights over a limit that may come from their rounding."""
    return 1e-5 + ULP * abs(float(height))


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


class NaiveGround:
    """Ground under a robot, and the states in which it stands. Nothing is computed in advance; results are only cached.

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
        if not self.known(cell):
            return True
        return self.difference(cell) > self.robot.drive.highest_edge + rounding(self.height(cell))

    def steep(self, cell, heading):
        """Whether the ground at a cell is too steep for a foot of a robot at this heading."""
        rolled_over, slope = self.robot.drive.highest_edge, self.robot.slope
        steepest = math.tan(slope.max_pitch), math.tan(slope.max_roll)
        # Along this length, an edge that a wheel passes is no steeper than the limit.
        longest = max(math.ceil(self.robot.drive.highest_edge / min(steepest) / CELL / 2 - 1e-9), 1)
        for way, n in itertools.product(range(8), range(1, longest + 1)):
            dx, dy = ray(way, n)
            ends = [(cell[0] + dx, cell[1] + dy), (cell[0] - dx, cell[1] - dy)]
            if not self.joined(cell, way, n):
                continue
            end = float(self.height(ends[0]))
            rise = abs(end - float(self.height(ends[1])))
            x, y = rotated(-heading, dx, dy)
            largest = math.hypot(steepest[0] * x, steepest[1] * y) / math.hypot(dx, dy)
            gradient = (rise - ULP * abs(end)) / (2 * CELL * math.hypot(dx, dy))
            if rise > rolled_over + rounding(end) and gradient > largest * (1 + 1e-5):
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

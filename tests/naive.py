"""Textbook twin of the detailed planner: plain Python from the documented rules, slow and simple.

Convention: lengths are in cells unless a name says metres. A state is a tuple (ix, iy, heading, f0, f1, f2, f3) in
lattice units with signed foot offsets. An action is ("drive", dx, dy), ("turn", +-1), ("arc", +-1 ahead or back,
+-1 left or right), ("foot", i, +-1), ("shift", +-1) or ("step", i, length).
"""

import heapq
import itertools
import math
from typing import NamedTuple

from tests.naive_ground import (
    CELL,
    HEADINGS,
    INF,
    MOVES,
    NaiveGround,
    deviation_angle,
    nearest,
    rotated,
    rounding,
    turned,
)


class Naive(NaiveGround):
    """A terrain and a robot with all its actions."""

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
        most = limits.max_height + rounding(before), limits.max_clearance + rounding(before)
        return abs(after - before) <= most[0] and highest - min(before, after) <= most[1]

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

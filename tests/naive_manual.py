"""The manual abstraction by its rules (`hdsp.abstract.manual`), state by state in plain Python."""

import math

from hdsp.abstract.flat_table import flat_table
from hdsp.abstract.manual import coarse_features
from hdsp.abstract.oracle import CostKind
from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS, heading_angle, robot_frame_goals
from tests.naive_ground import rounding

CELL = 0.1  # m


class NaiveManual:
    """Edges of the manual abstraction for a robot on a map."""

    def __init__(self, heights, robot, settings):
        self.ground, self.robot, self.settings = coarse_features(heights), robot, settings
        self.flat = flat_table(robot, None, CostKind.PLANNING)

    def edge(self, heading, ix, iy, action):
        """Cost of an action; inf = infeasible."""
        nx, ny = self.ground.top.shape
        dx, dy, turn = ABSTRACT_ACTIONS[action].tolist()
        if not (0 <= ix + dx < nx and 0 <= iy + dy < ny):
            return math.inf
        middle = {(x, y) for x in nearest(dx / 2) for y in nearest(dy / 2)}
        met = [(heading, ix + x, iy + y) for x, y in {(0, 0), (dx, dy)} | middle]
        if turn:
            met.append(((heading + turn) % ABSTRACT_HEADINGS, ix, iy))
        poses = [self.pose(*each) for each in met]
        x, y, _ = robot_frame_goals(heading)[action]
        deviation = abs(math.atan2(y, x))
        may_step = not turn and min(deviation, math.pi - deviation) <= self.settings.step_deviation
        stepping = set().union(*(steps for _, steps, _ in poses))
        if any(blocked for blocked, _, _ in poses) or (stepping and not may_step):
            return math.inf
        uneven = sum(each for _, _, each in poses) / len(poses)
        flat = float(self.flat[heading, action])
        return flat * (1 + self.settings.unevenness_cost * uneven) + self.settings.step_cost * len(stepping)

    def pose(self, heading, ix, iy):
        """Whether a pose is blocked, its feet on a step, and the mean height range around it."""
        robot, settings = self.robot, self.settings
        angle = float(heading_angle(heading, ABSTRACT_HEADINGS))
        cos, sin = math.cos(angle), math.sin(angle)

        def cell(x, y):  # ties go outward
            turned = (cos * x - sin * y) / CELL, (sin * x + cos * y) / CELL
            return tuple(int(math.copysign(math.floor(abs(at) + 0.5 + 1e-9), at)) for at in turned)

        def read(values, at, outside):
            x, y = ix + at[0], iy + at[1]
            inside = 0 <= x < values.shape[0] and 0 <= y < values.shape[1]
            return float(values[x, y]) if inside else outside

        def higher(at, limit):
            return not read(self.ground.height_range, at, math.inf) <= limit + rounding(read(self.ground.top, at, 0.0))

        def edge(at):
            return higher(at, robot.drive.highest_edge)

        feet, reach, steps, z = robot.neutral_feet(), settings.foot_reach, set(), []
        for foot, (x, y) in enumerate(feet.tolist()):
            under = cell(x, y)
            z.append(read(self.ground.ground, under, math.nan))
            if math.isnan(z[-1]) or higher(under, robot.step.max_height):
                return True, set(), 0.0
            if edge(under):
                steps.add(foot)
                if edge(cell(x + reach, y)) and edge(cell(x - reach, y)):
                    return True, set(), 0.0
        length, width = abs(feet).max(axis=0).tolist()
        most = robot.slope.steepest()
        slopes = (z[0] + z[3] - z[1] - z[2]) / (4 * length), (z[0] + z[1] - z[2] - z[3]) / (4 * width)
        ahead, left = (max(-limit, min(limit, slope)) for limit, slope in zip(most, slopes, strict=True))

        def inside(x_min, x_max, half):
            span = range(-12, 13)
            places = (((a, b), (cos * a + sin * b) * CELL, (cos * b - sin * a) * CELL) for a in span for b in span)
            return [each for each in places if x_min - 1e-9 <= each[1] <= x_max + 1e-9 and abs(each[2]) <= half + 1e-9]

        for box in robot.body.boxes:
            for at, x, y in inside(box.x_min, box.x_max, box.half_width):
                if read(self.ground.top, at, math.nan) - (sum(z) / 4 + x * ahead + y * left) > box.above:
                    return True, set(), 0.0
        longer, wider = length + settings.margin, width + settings.margin
        ranges = [read(self.ground.height_range, at, 0.0) for at, _, _ in inside(-longer, longer, wider)]
        return False, steps, sum(0.0 if math.isnan(each) else each for each in ranges) / len(ranges)


def nearest(value):
    """Nearest integer, or both at a tie."""
    return {math.ceil(value - 0.5), math.floor(value + 0.5)}

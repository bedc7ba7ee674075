"""Sequences of changed maps: after each `update()`, a plan is that of a new planner, for every heuristic."""

import tempfile
from functools import cache

import numpy as np

from hdsp.abstract.abstract_costs import AbstractCosts
from hdsp.base.errors import InputError
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

#: Heuristics with their shares.
HEURISTICS = {"geometric": 1.0, "grid": 1.0, "manual": 1.0, "learned": 1.0}
#: Cells and changes of a sequence; networks take more time than all else.
_SIZES = {"learned": ((80, 64), 2)}
_SIZE = (96, 80), 3
_BORDER = 0.65  # m, around starts and goals
#: Widths of a network that takes a part of the shipped network's time; one sequence in four has the shipped one.
_SMALL = {"width": 16, "hidden": 16, "features": 16, "context": 16, "feet": 16, "head": 16, "planning": True}
_SHIPPED_IN = 4


class UpdateCases:
    """All sequences for one heuristic."""

    def __init__(self, heuristic: str):
        self.heuristic, self.number = heuristic, sorted(HEURISTICS).index(heuristic)
        self.cells, self.changes = _SIZES.get(heuristic, _SIZE)
        self.robot = Robot.load("momaro")

    def outcome(self, seed: int) -> str:
        """``equal``, ``refused`` (invalid start), or a fault with words behind it."""
        random = np.random.default_rng([self.number, seed])
        try:
            return self._sequence(random, seed % _SHIPPED_IN == 0)
        except AssertionError as error:
            return f"wrong {' '.join(str(error).split())[:200]}"
        except Exception as error:
            return f"traceback {type(error).__name__}: {' '.join(str(error).split())[:200]}"

    def _sequence(self, random: np.random.Generator, shipped: bool) -> str:
        heights = _ground(self.cells, random)
        start, goal = _poses(self.cells, random)
        weight = float(random.choice([1.25, 2.0, 3.0]))
        updated, fresh = (self._heuristic(shipped, copy) for copy in (0, 1))
        planner, outcomes = self._planner(heights, updated), set()
        if random.random() < 0.8:  # else the first plan is on a changed map
            outcomes.add(_plan(planner, start, goal, weight)[0])
        for _ in range(self.changes):
            heights, region = _changed(heights, random)
            planner.update(HeightMap(heights), region if random.random() < 0.5 else None)
            if random.random() < 0.4:
                start, goal = _poses(self.cells, random)
            found = _plan(planner, start, goal, weight)
            expected = _plan(self._planner(heights, fresh), start, goal, weight)
            assert found[0] == expected[0], (found[0], expected[0])
            if found[1] is not None:
                assert found[1].cost == expected[1].cost, (found[1].cost, expected[1].cost)
                np.testing.assert_array_equal(found[1].states, expected[1].states)
            outcomes.add(found[0])
        return "equal" if outcomes != {"refused"} else "refused"

    def _planner(self, heights: np.ndarray, heuristic: str | AbstractCosts) -> Planner:
        return Planner(HeightMap(heights.copy()), self.robot, heuristic=heuristic, conditioning=None)

    def _heuristic(self, shipped: bool, copy: int) -> str | AbstractCosts:
        if self.heuristic != "learned":
            return self.heuristic
        from hdsp.learning import LearnedCosts

        return LearnedCosts(_network(shipped, copy), robot=self.robot)


@cache
def _network(shipped: bool, copy: int):
    """An abstraction; the updated planner and new ones have a copy each, so that they share no state."""
    from hdsp.learning import LearnedAbstraction, Provenance
    from hdsp.learning.loading import load_abstraction
    from tests.learning.test_zoo import abstraction

    if shipped:
        return load_abstraction("momaro")
    made, robot = abstraction("footprint", **_SMALL), Robot.load("momaro")
    made.provenance = Provenance.of(robot, "0123")
    with tempfile.TemporaryDirectory() as folder:
        return LearnedAbstraction.from_pretrained(made.save_pretrained(f"{folder}/model"), robot)


def _plan(planner: Planner, start, goal, weight: float):
    try:
        plan = planner.plan(start, goal, weight, polish=0, start_free=False, expansions=20_000)
    except InputError as error:
        assert "\n" not in str(error)
        return "refused", None
    return str(plan.status), plan if plan.solved else None


def _poses(cells: tuple[int, int], random: np.random.Generator):
    low, high = (_BORDER, _BORDER), tuple(0.025 * side - _BORDER for side in cells)
    ends = [(*random.uniform(low, high), float(random.choice([0, 0.3, np.pi / 2, -2.0]))) for _ in range(2)]
    return [tuple(map(float, end)) for end in ends]


def _ground(cells: tuple[int, int], random: np.random.Generator) -> np.ndarray:
    heights = np.zeros(cells, np.float32)
    for _ in range(int(random.integers(0, 4))):
        _place(heights, random)
    return heights


def _place(heights: np.ndarray, random: np.random.Generator) -> tuple[int, int, int, int]:
    """Writes a block, a hole of unknown cells, a bump or flat ground; returns its region."""
    ix, iy = (int(random.integers(0, cells - 4)) for cells in heights.shape)
    nx, ny = (int(random.integers(2, 24)) for _ in range(2))
    part = heights[ix : ix + nx, iy : iy + ny]
    kind = random.integers(4)
    part[:] = (random.uniform(0.05, 0.3), 0.0, np.nan, random.uniform(0, 0.04))[kind]
    return ix, iy, min(ix + nx, heights.shape[0]), min(iy + ny, heights.shape[1])


def _changed(heights: np.ndarray, random: np.random.Generator):
    """A copy of the heights with one to three changes, and a region that holds all of them."""
    heights = heights.copy()
    regions = np.array([_place(heights, random) for _ in range(int(random.integers(1, 4)))])
    return heights, (*map(int, regions[:, :2].min(axis=0)), *map(int, regions[:, 2:].max(axis=0)))

"""The checker of heuristics: ours pass, and a broken heuristic is caught for each rule."""

import numpy as np
import pytest

from hdsp.abstract import FlatCosts, ManualCosts
from hdsp.base.conformance import ConformanceError
from hdsp.base.errors import InputError
from hdsp.planning import check_heuristic
from hdsp.planning.heuristic_conformance import RULES
from hdsp.planning.heuristics.abstract import AbstractHeuristic
from hdsp.planning.heuristics.geometric import GeometricHeuristic
from hdsp.terrain.height_map import HeightMap

CLAIMED = {"goal", "admissible", "consistent"}


def test_ours_keep_the_contract():
    assert set(check_heuristic(lambda world, terrain: GeometricHeuristic(world))) == set(RULES)
    for costs in (FlatCosts("momaro"), ManualCosts("momaro")):
        checked = check_heuristic(lambda world, terrain, costs=costs: AbstractHeuristic(world, terrain, costs))
        assert set(checked) == set(RULES) - CLAIMED


class NoName(GeometricHeuristic):
    name = ""


class ConsistentButNotAdmissible(GeometricHeuristic):
    admissible = False


class NeedsNoGoal(GeometricHeuristic):
    def __call__(self, states):
        return super().__call__(states) if self._estimate else np.zeros(len(states))


class KeepsItsGoal(GeometricHeuristic):
    def clear(self):
        pass


class Negative(GeometricHeuristic):
    def __call__(self, states):
        return super().__call__(states) - 1


class OneColumn(GeometricHeuristic):
    def __call__(self, states):
        return super().__call__(states)[:, None]


class OtherView(GeometricHeuristic):
    def set_goal(self, goal):
        return super().set_goal(goal)._replace(distance=0.0)


class Growing(GeometricHeuristic):
    calls = 0

    def estimate_for(self, goal):
        self.calls += 1
        return super().estimate_for(goal)._replace(turn=1e-4 * self.calls)


class MovesTheGoal(GeometricHeuristic):
    def set_goal(self, goal):
        goal[0] += 1
        return super().set_goal(goal)


class GivesUp(GeometricHeuristic):
    admissible = consistent = False

    def estimate_for(self, goal):
        estimate = super().estimate_for(goal)
        # Without a single entry, every state is outside of the table.
        return estimate._replace(table=np.zeros(1, np.float32), outside=np.inf)


class NotZeroAtTheGoal(GeometricHeuristic):
    consistent = False

    def estimate_for(self, goal):
        return super().estimate_for(goal + [1, 0, 0, 0, 0, 0, 0])


class Overestimates(GeometricHeuristic):
    consistent = False

    def estimate_for(self, goal):
        estimate = super().estimate_for(goal)
        return estimate._replace(distance=2 * estimate.distance)


class Inconsistent(GeometricHeuristic):
    """The geometric heuristic every other column, zero between: admissible, and no more."""

    def estimate_for(self, goal):
        estimate = super().estimate_for(goal)
        nx, ny = self.world.nx, self.world.ny
        x, y = np.indices((nx, ny))
        distance = estimate.distance * np.hypot(x - goal[0], y - goal[1])
        table = np.broadcast_to(np.where((x + y) % 2, distance, 0.0), (64, nx, ny)).astype(np.float32)
        return estimate._replace(
            distance=0.0, turn=0.0, foot=0.0, table=table.ravel(), table_nx=nx, table_ny=ny, cells=1, heading_steps=1
        )


class IgnoresUpdates(AbstractHeuristic):
    def update(self, world, terrain, region=None):
        self._estimate = None


@pytest.mark.parametrize(
    ("broken", "rule"),
    [
        (NoName, "claims"),
        (ConsistentButNotAdmissible, "claims"),
        (NeedsNoGoal, "life"),
        (KeepsItsGoal, "life"),
        (Negative, "values"),
        (OneColumn, "values"),
        (OtherView, "kernel"),
        (Growing, "determinism"),
        (MovesTheGoal, "input"),
        (GivesUp, "solvable"),
        (NotZeroAtTheGoal, "goal"),
        (Overestimates, "admissible"),
        (Inconsistent, "consistent"),
    ],
)
def test_a_broken_rule_is_named(broken, rule):
    caught(lambda world, terrain: broken(world), rule)


def test_a_heuristic_that_ignores_updates_is_caught():
    costs = FlatCosts("momaro")
    caught(lambda world, terrain: IgnoresUpdates(world, terrain, costs), "update")


class WritesIntoItsArrays(GeometricHeuristic):
    """Counts updates in an array that its copies share."""

    def __init__(self, world):
        super().__init__(world)
        self.updates = np.zeros(1)

    def __call__(self, states):
        return super().__call__(states) / (1 + self.updates[0])

    def update(self, world, terrain, region=None):
        super().update(world, terrain, region)
        self.updates += 1


def test_a_heuristic_whose_update_changes_its_former_self_is_caught():
    caught(lambda world, terrain: WritesIntoItsArrays(world), "update", "after an update of its copy")


def caught(make, rule, words=""):
    with pytest.raises(ConformanceError) as error:
        check_heuristic(make)
    assert error.value.rule == rule
    assert RULES[rule] in str(error.value) and words in str(error.value)
    assert "\n" not in str(error.value)


def test_an_own_terrain_has_to_carry_the_robot():
    with pytest.raises(InputError, match="the robot can stand at 0 of"):
        check_heuristic(lambda world, terrain: GeometricHeuristic(world), terrain=HeightMap(np.full((72, 72), np.nan)))

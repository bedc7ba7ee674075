"""The checker of abstract costs: ours pass, and a broken implementation is caught for each rule."""

import numpy as np
import pytest

from benchmarks.edges import random_abstraction
from hdsp.abstract import FlatCosts, ManualCosts, check_abstract_costs
from hdsp.abstract.abstract_conformance import RULES
from hdsp.base.conformance import ConformanceError
from hdsp.base.errors import InputError
from hdsp.learning import HardwareSettings, LearnedCosts
from hdsp.robot.lattice import ABSTRACT_ACTIONS
from hdsp.terrain.height_map import HeightMap


def learned_costs(architecture: str) -> LearnedCosts:
    return LearnedCosts(random_abstraction(HardwareSettings("cpu", "32", 1), architecture=architecture))


@pytest.mark.parametrize("costs", ["flat", "manual", "patches", "dense"])
def test_ours_keep_the_contract(costs):
    makers = {
        "flat": lambda: FlatCosts("momaro"),
        "manual": lambda: ManualCosts("momaro"),
        "patches": lambda: learned_costs("compact"),
        "dense": lambda: learned_costs("table"),
    }
    assert set(check_abstract_costs(makers[costs]())) == set(RULES)


class Sloppy(FlatCosts):
    """Flat costs for the robot momaro, spoilt by a test."""

    def __init__(self):
        super().__init__("momaro")

    def edges(self, height_map, region=None, mask=None):
        return self.spoilt(super().edges(height_map, region, mask), height_map, region, mask)

    def spoilt(self, edges, height_map, region, mask):
        return edges


class NoEdges:
    pass


class WithoutTurns(Sloppy):
    def spoilt(self, edges, *asked):
        return edges[..., :20]


class Double(Sloppy):
    def spoilt(self, edges, *asked):
        return edges.astype(float)


class NotANumberOnUnknownGround(Sloppy):
    def spoilt(self, edges, height_map, *asked):
        return edges * np.float32(np.nan) if np.isnan(height_map.heights).all() else edges


class OffTheMap(Sloppy):
    def spoilt(self, edges, *asked):
        edges[:, 0, 0, ABSTRACT_ACTIONS.tolist().index([-2, 0, 0])] = 0.2
        return edges


class BlindToTheMask(Sloppy):
    def edges(self, height_map, region=None, mask=None):
        unmasked = super().edges(height_map, region)
        super().edges(height_map, region, mask)  # raises where the mask has a wrong shape
        return unmasked


class ClosedAtTheRegionsRim(Sloppy):
    def spoilt(self, edges, *asked):
        edges[:, :2, :, ABSTRACT_ACTIONS[:, 0] < -1] = np.inf
        return edges


class SameArray(Sloppy):
    last = None

    def edges(self, height_map, region=None, mask=None):
        key = height_map, region, None if mask is None else mask.tobytes()
        if self.last is None or self.last[0] != key:
            self.last = key, super().edges(height_map, region, mask)
        return self.last[1]


class Counting(Sloppy):
    calls = 0

    def spoilt(self, edges, *asked):
        self.calls += 1
        return edges * np.float32(1 + 0.01 * self.calls)


class FillsHoles(Sloppy):
    def spoilt(self, edges, height_map, *asked):
        height_map.heights.flags.writeable = True
        np.nan_to_num(height_map.heights, copy=False)
        return edges


class DearInTheEast(Sloppy):
    def spoilt(self, edges, height_map, *asked):
        return edges * np.float32(2 if height_map.origin[0] > 5 else 1)


class ForgivesEmptyRegions(Sloppy):
    def edges(self, height_map, region=None, mask=None):
        if region is not None and region[0] == region[2]:
            return np.empty((16, 0, region[3] - region[1], 22), np.float32)
        return super().edges(height_map, region, mask)


class DearWhereItIsHigh(Sloppy):
    """Costs that depend on the highest ground in the map; `affected` reports no state for any change."""

    def spoilt(self, edges, height_map, *asked):
        return edges * np.float32(1 + np.nanmax(height_map.heights, initial=0.0))


class AllTasksInfinite(Sloppy):
    def predict(self, patches, goals):
        feasible, cost = super().predict(patches, goals)
        return feasible, np.full_like(cost, np.inf)


class ComparesPatches(Sloppy):
    def predict(self, patches, goals):
        feasible, cost = super().predict(patches, goals)
        return feasible, cost * np.float32(len(patches))


class FillsPatches(Sloppy):
    def predict(self, patches, goals):
        np.nan_to_num(patches, copy=False)
        return super().predict(patches, goals)


class TakesAnyPatch(Sloppy):
    def predict(self, patches, goals):
        return super().predict(np.zeros((len(patches), 72, 72)), goals)


@pytest.mark.parametrize(
    ("broken", "rule"),
    [
        (NoEdges, "methods"),
        (WithoutTurns, "shape"),
        (Double, "dtype"),
        (NotANumberOnUnknownGround, "values"),
        (OffTheMap, "exits"),
        (BlindToTheMask, "mask"),
        (ClosedAtTheRegionsRim, "region"),
        (SameArray, "determinism"),
        (Counting, "determinism"),
        (FillsHoles, "input"),
        (DearInTheEast, "origin"),
        (ForgivesEmptyRegions, "errors"),
        (DearWhereItIsHigh, "affected"),
        (AllTasksInfinite, "tasks"),
        (ComparesPatches, "task determinism"),
        (FillsPatches, "task input"),
        (TakesAnyPatch, "task errors"),
    ],
)
def test_a_broken_rule_is_named(broken, rule):
    with pytest.raises(ConformanceError) as error:
        check_abstract_costs(broken())
    assert error.value.rule == rule
    assert RULES[rule] in str(error.value)
    assert "\n" not in str(error.value)


def test_an_own_terrain_has_to_show_something():
    with pytest.raises(InputError, match="4 x 25 abstract cells"):
        check_abstract_costs(FlatCosts("momaro"), HeightMap.flat((16, 100)))
    with pytest.raises(InputError, match="no action is feasible"):
        check_abstract_costs(ManualCosts("momaro"), HeightMap(np.full((100, 100), np.nan)))

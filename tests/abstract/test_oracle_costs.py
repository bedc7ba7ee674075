import numpy as np
import pytest

from hdsp.abstract import CostKind, OracleCosts, check_abstract_costs, feet_at
from hdsp.abstract.abstract_costs import GradualCosts, LocalCosts
from hdsp.abstract.flat_table import cost_limit
from hdsp.abstract.oracle import LabelSettings, task_costs
from hdsp.base.errors import InputError
from hdsp.base.workers import ClusterSettings
from hdsp.detailed.world.world import build_world
from hdsp.robot.lattice import abstract_anchor
from hdsp.robot.robot import Robot
from hdsp.terrain.scenes import random_map

ROBOT = Robot.load("momaro")
SETTINGS = LabelSettings()
LIMIT = cost_limit(ROBOT, SETTINGS)


def standing(terrain, count, seed):
    """A mask with ``count`` states at which the robot can stand, and their detailed states."""
    world, rng = build_world(terrain, ROBOT), np.random.default_rng(seed)
    mask = np.zeros((16, terrain.shape[0] // 4, terrain.shape[1] // 4), bool)
    starts = {}
    while len(starts) < count:
        k, a, b = (int(rng.integers(n)) for n in mask.shape)
        start = feet_at(world, abstract_anchor(np.array([a, b, k])))
        if start is not None:
            mask[k, a, b], starts[k, a, b] = True, start
    return world, mask, starts


@pytest.mark.parametrize("kind", CostKind)
def test_oracle_edges_are_the_costs_on_the_whole_map(kind):
    terrain = random_map(1000, "mixed_2", 0, cells=150)
    costs = OracleCosts(ROBOT, kind)
    assert isinstance(costs, LocalCosts) and isinstance(costs, GradualCosts)
    world, mask, starts = standing(terrain, 12, seed=0)
    edges = costs.edges(terrain, mask=mask)
    assert np.isinf(edges[~mask]).all() and np.isfinite(edges[mask]).any()
    for at, start in starts.items():
        expected = task_costs(world, start, SETTINGS, LIMIT, kind=kind)[1]
        np.testing.assert_allclose(edges[at], expected, rtol=1e-5, err_msg=str(at))


def test_oracle_keeps_the_contract():
    checked = check_abstract_costs(OracleCosts(ROBOT), states=24)
    assert {"affected", "region", "mask", "origin"} <= set(checked)


def test_workers_find_the_same_costs_and_report_progress():
    terrain = random_map(1000, "cuboid_1", 1, cells=72)
    _, mask, starts = standing(terrain, 6, seed=1)
    told = []
    alone = OracleCosts(ROBOT).edges(terrain, mask=mask)
    cluster = ClusterSettings(workers=2, dashboard=None)
    shared = OracleCosts(ROBOT, cluster=cluster, progress=lambda *at: told.append(at)).edges(terrain, mask=mask)
    np.testing.assert_array_equal(shared, alone)
    assert told[-1] == (len(starts), len(starts)) and [done for done, _ in told] == sorted(done for done, _ in told)


def test_an_unknown_kind_is_named():
    with pytest.raises(InputError, match="'labels'; need label or planning"):
        OracleCosts(ROBOT, "labels")

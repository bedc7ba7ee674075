import numpy as np
import pytest

from hdsp.abstract import AbstractCosts, FlatCosts, LocalCosts, ManualCosts, ManualSettings, TaskPredictor, cost_to_go
from hdsp.base.errors import InputError
from hdsp.robot.lattice import ABSTRACT_ACTIONS, abstract_anchor, robot_frame_goals
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.patches import crop_patches
from tests import ROOT

AHEAD, BACK, LEFT, RIGHT, TURN_LEFT, TURN_RIGHT = (
    ABSTRACT_ACTIONS.tolist().index(action)
    for action in ([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1])
)

#: Costs on flat ground in the authors' published labels, in action order.
PUBLISHED_FLAT = [
    0.1, 0.38541, 0.3, 0.424264, 0.25, 0.424264, 0.3, 0.38541, 0.2, 0.406809, 0.670821, 0.6, 0.670821, 0.625018, 0.5,
    0.625018, 0.670821, 0.6, 0.670821, 0.406809, 0.036613, 0.036613,
]  # fmt: skip


@pytest.fixture(scope="module")
def flat():
    return FlatCosts("momaro")


@pytest.fixture(scope="module")
def manual():
    return ManualCosts("momaro")


def goals_of(headings):
    return np.stack([robot_frame_goals(heading) for heading in headings])


def inside(shape):
    """Whether each action stays on a map of ``shape`` abstract cells, bool [nx, ny, 22]."""
    to = np.moveaxis(np.indices(shape), 0, -1)[:, :, None, :] + ABSTRACT_ACTIONS[:, :2]
    return ((to >= 0) & (to < shape)).all(axis=-1)


def test_both_fulfil_the_contracts(flat, manual):
    for costs in (flat, manual):
        assert isinstance(costs, AbstractCosts) and isinstance(costs, TaskPredictor) and isinstance(costs, LocalCosts)


def test_flat_costs_are_the_published_ones(flat):
    np.testing.assert_allclose(flat.table[0], PUBLISHED_FLAT, atol=1e-5)


def test_edges_are_planning_costs_and_predictions_are_labels(flat):
    # Sideways, the planner turns a little more than the labels allow, and at the robot's own price.
    assert flat.edge_table[0, AHEAD] == flat.table[0, AHEAD] and flat.edge_table[0, BACK] == flat.table[0, BACK]
    assert (flat.edge_table <= flat.table).all() and (flat.edge_table < 0.8 * flat.table).any()
    terrain = HeightMap.flat((120, 120))
    for costs in (FlatCosts, ManualCosts):
        planning, label = costs("momaro"), costs("momaro", kind="label")
        with pytest.raises(InputError, match="kind of costs 'heuristic'; need label or planning"):
            costs("momaro", kind="heuristic")
        for each, table in ((planning, flat.edge_table), (label, flat.table)):
            np.testing.assert_allclose(each.edges(terrain, (14, 14, 15, 15))[:, 0, 0], table, rtol=1e-6)
            predicted = each.predict(np.zeros((16, 72, 72), np.float32), goals_of(range(16)))[1]
            np.testing.assert_allclose(predicted, flat.table, rtol=1e-6)


def test_flat_costs_turn_with_the_robot(flat):
    for heading, (ahead, left) in {0: (AHEAD, LEFT), 4: (LEFT, BACK), 8: (BACK, RIGHT), 12: (RIGHT, AHEAD)}.items():
        assert flat.table[heading, ahead] == flat.table[0, AHEAD]
        assert flat.table[heading, left] == flat.table[0, LEFT]
    mirrored = [ABSTRACT_ACTIONS.tolist().index([dx, -dy, -turn]) for dx, dy, turn in ABSTRACT_ACTIONS.tolist()]
    for heading in range(16):
        np.testing.assert_allclose(flat.table[-heading, mirrored], flat.table[heading], rtol=1e-5)


@pytest.mark.parametrize("costs", ["flat", "manual"])
def test_on_flat_ground_every_action_within_the_map_has_its_flat_cost(costs, flat, request):
    costs = request.getfixturevalue(costs)
    edges = costs.edges(HeightMap.flat((4 * 30 + 3, 4 * 28)))
    assert edges.shape == (16, 30, 28, 22) and edges.dtype == np.float32 and edges.flags.c_contiguous
    clear = 12  # cells; beyond the map's border, ground is unknown
    assert np.isinf(edges[:, ~inside((30, 28))]).all()
    middle = edges[:, clear:-clear, clear:-clear]
    np.testing.assert_allclose(middle, np.broadcast_to(flat.edge_table[:, None, None], middle.shape), rtol=1e-6)


def test_tasks_on_flat_ground_cost_the_same_at_all_headings(flat, manual):
    headings = range(16)
    patches = np.zeros((16, 72, 72), np.float32)
    for costs in (flat, manual):
        feasible, cost = costs.predict(patches, goals_of(headings))
        assert feasible.all()
        np.testing.assert_allclose(cost, flat.table, rtol=1e-6)


@pytest.mark.parametrize("costs", ["flat", "manual"])
def test_a_region_is_cut_out_of_the_whole(costs, request):
    costs = request.getfixturevalue(costs)
    heights = np.zeros((100, 80), np.float32)
    heights[40:48, 30:60] = 0.5
    terrain = HeightMap(heights)
    np.testing.assert_array_equal(costs.edges(terrain, (3, 5, 12, 20)), costs.edges(terrain)[:, 3:12, 5:20])
    for region in [(0, 0, 26, 20), (5, 5, 5, 9), (-1, 0, 5, 5), (0, 0.5, 5, 5), (0, 0, True, 5), (0, 0), 4]:
        with pytest.raises(InputError, match="region"):
            costs.edges(terrain, region)


@pytest.mark.parametrize("costs", ["flat", "manual"])
@pytest.mark.parametrize("place", [(30, 90), (0, 0), (118, 158), (63, 64)])
def test_only_affected_costs_change(costs, place, request):
    costs = request.getfixturevalue(costs)
    rng = np.random.default_rng(3)
    before = rng.choice([0.0, 0.01], (30, 41)).repeat(4, axis=0).repeat(4, axis=1).astype(np.float32)[:, :163]
    changed = np.zeros(before.shape, bool)
    changed[place[0] : place[0] + 3, place[1] : place[1] + 2] = True
    affected = costs.affected(changed)
    assert affected.shape == (16, 30, 40) and affected.mean() < 0.5
    old = costs.edges(HeightMap(before))
    touched = np.zeros(affected.shape, bool)
    for height in (0.1, 1.0, -1.0, np.nan):
        new = costs.edges(HeightMap(np.where(changed, np.float32(height), before)))
        touched |= (new != old).any(axis=-1)
    assert not (touched & ~affected).any()
    assert touched.any() == (costs is request.getfixturevalue("manual"))


def test_map_and_patch_agree_at_heading_zero():
    manual = ManualCosts("momaro", kind="label")
    rng = np.random.default_rng(2)
    heights = np.zeros((200, 160), np.float32)
    for _ in range(12):
        x, y = rng.integers(0, 150, 2)
        heights[x : x + rng.integers(3, 40), y : y + rng.integers(3, 30)] += rng.choice([0.03, 0.2, 0.8])
    states = np.column_stack([rng.integers(9, 41, 60), rng.integers(9, 31, 60), np.zeros(60, int)])
    edges = manual.edges(HeightMap(heights))[0, states[:, 0], states[:, 1]]
    patches = crop_patches(heights, abstract_anchor(states)[:, :2], 0)
    feasible, cost = manual.predict(patches, goals_of([0] * 60))
    np.testing.assert_array_equal(feasible, np.isfinite(edges))
    np.testing.assert_allclose(cost[feasible], edges[feasible], rtol=1e-6)
    assert 0.2 < feasible.mean() < 0.9


def test_a_wall_ahead_stops_the_robot_and_raises_what_stays_possible(manual, flat):
    patch = np.zeros((1, 72, 72), np.float32)
    patch[0, 56:] = 1.0  # 0.5 m ahead of the base centre, just before the front of the base
    feasible, cost = (answer[0] for answer in manual.predict(patch, goals_of([0])))
    assert not feasible[AHEAD]
    assert feasible[[BACK, LEFT, RIGHT]].all()
    assert (cost[[BACK, LEFT, RIGHT]] > 1.05 * flat.table[0, [BACK, LEFT, RIGHT]]).all()


def test_steps_are_climbed_ahead_but_not_sideways(manual, flat):
    patch = np.zeros((1, 72, 72), np.float32)
    patch[0, 52:] = 0.2
    feasible, cost = (answer[0] for answer in manual.predict(patch, goals_of([0])))
    assert feasible[AHEAD]
    two_feet = 2 * manual.settings.step_cost
    assert cost[AHEAD] > flat.table[0, AHEAD] + two_feet
    patch[0, 49:] = 0.2
    beside = np.swapaxes(patch, 1, 2)  # now 0.325 m to the left
    feasible, _ = (answer[0] for answer in manual.predict(beside, goals_of([0])))
    assert not feasible[LEFT]
    assert feasible[RIGHT]


def test_unknown_ground_bears_no_foot(manual):
    patch = np.zeros((1, 72, 72), np.float32)
    patch[0, 52:] = np.nan
    feasible, _ = (answer[0] for answer in manual.predict(patch, goals_of([0])))
    assert not feasible[AHEAD] and feasible[BACK]


def test_a_bar_under_the_body_blocks_all(manual):
    patch = np.zeros((1, 72, 72), np.float32)
    patch[0, 34:38, 34:38] = 0.0
    patch[0, 38:46, 34:40] = 0.5
    feasible, cost = manual.predict(patch, goals_of([0]))
    assert not feasible.any() and np.isinf(cost).all()


def test_mirrored_ground_has_mirrored_costs(manual):
    rng = np.random.default_rng(4)
    # Coarse cells of 4 x 4, mirrored about the robot's row of cells.
    coarse = rng.choice([0.0, 0.02, 0.1], (17, 17), p=[0.7, 0.2, 0.1]).astype(np.float32)
    patch = np.full((2, 72, 72), np.nan, np.float32)
    patch[0, 2:70, 2:70] = np.kron(coarse, np.ones((4, 4)))
    patch[1, 2:70, 2:70] = np.kron(coarse[:, ::-1], np.ones((4, 4)))
    mirrored = [ABSTRACT_ACTIONS.tolist().index([dx, -dy, -turn]) for dx, dy, turn in ABSTRACT_ACTIONS.tolist()]
    feasible, cost = manual.predict(patch, goals_of([0, 0]))
    np.testing.assert_array_equal(feasible[0], feasible[1][mirrored])
    np.testing.assert_allclose(cost[0][feasible[0]], cost[1][mirrored][feasible[0]], rtol=1e-5)


def test_dijkstra_walks_around_a_wall(manual):
    heights = np.zeros((240, 240), np.float32)
    open_map = cost_to_go(manual.edges(HeightMap(heights)), (40, 30, 0))
    heights[118:122, 60:] = 1.0
    around = cost_to_go(manual.edges(HeightMap(heights)), (40, 30, 0))
    assert np.isfinite(around[0, 15, 30])
    assert around[0, 15, 30] > open_map[0, 15, 30] + 0.5


def test_wrong_settings_and_shapes_are_named(manual, flat):
    with pytest.raises(InputError, match="step_cost is -1"):
        ManualSettings(step_cost=-1)
    for costs in (manual, flat):
        with pytest.raises(InputError, match=r"\(2, 71, 72\)"):
            costs.predict(np.zeros((2, 71, 72), np.float32), goals_of([0, 0]))


def test_the_constants_in_conf_are_the_defaults():
    import yaml

    path = ROOT / "conf" / "abstraction" / "manual.yaml"
    assert ManualSettings(**yaml.safe_load(path.read_text())) == ManualSettings()


@pytest.mark.parametrize("costs", ["flat", "manual"])
def test_states_outside_the_mask_are_closed_and_others_unchanged(costs, request):
    costs = request.getfixturevalue(costs)
    terrain = HeightMap.flat((100, 80))
    mask = np.random.default_rng(0).random((16, 25, 20)) < 0.5
    whole, masked = costs.edges(terrain), costs.edges(terrain, mask=mask)
    np.testing.assert_array_equal(masked[mask], whole[mask])
    assert np.isinf(masked[~mask]).all()
    with pytest.raises(InputError, match="mask"):
        costs.edges(terrain, mask=mask[:, 1:])

import math
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

import hdsp
from hdsp import HeightMap, InputError, Planner, Status
from hdsp.abstract import FlatCosts, ManualCosts
from hdsp.detailed.causes import Kind
from hdsp.detailed.search.weighted_astar import HARD, solve
from hdsp.detailed.world import world_update
from hdsp.detailed.world.world import build_world
from hdsp.planning import query
from hdsp.planning.heuristics import GeometricHeuristic
from hdsp.robot.lattice import RESOLUTION
from tests.detailed.instances import toy

START, GOAL = (0.9, 0.9, 0.0), (1.6, 1.1, 0.3)
FAR = (0.6, 0.6, 0.0), (1.7, 1.8, 2.5)


def with_wall(wall=slice(30, 34)):
    """A flat map of 2.5 m, with a wall across."""
    heights = np.zeros((100, 100), np.float32)
    heights[wall] = 1.0
    return HeightMap(heights)


class CutsEverythingOff(FlatCosts):
    """Abstract costs in which every action is infeasible."""

    def edges(self, height_map, region=None, mask=None):
        return np.full_like(super().edges(height_map, region, mask), np.inf)


@pytest.fixture(scope="module")
def flat():
    return Planner(HeightMap.flat((100, 100)))


def test_a_plan_leads_from_start_to_goal_and_its_costs_add_up(flat):
    plan = flat.plan(START, GOAL)
    assert plan.solved and plan.status == Status.SOLVED
    assert plan.states.shape == (len(plan.actions) + 1, 7)
    for state, wanted in ((plan.states[0], START), (plan.states[-1], GOAL)):
        assert abs(state[:2] - wanted[:2]).max() <= RESOLUTION / 2 + 1e-6
        assert abs(state[2] - wanted[2]) <= math.pi / 64 + 1e-9
    assert plan.action_costs.sum() == pytest.approx(plan.cost)
    assert len(plan.action_costs) == len(plan.actions) and (plan.action_costs > 0).all()
    assert plan.stats["expansions"] > 0 and plan.stats["heuristic"] == "geometric"
    driven = np.hypot(*np.diff(plan.states[:, :2], axis=0).T).sum()
    assert plan.explain().startswith(f"solved: drives {driven:.2f} m, turns by ")
    assert f"cost {plan.cost:.3f} (driving " in plan.explain()


def test_m18_a_planner_takes_a_map_an_array_with_its_cell_size_or_a_path(tmp_path, flat):
    heights = with_wall().heights
    with_wall().save(tmp_path / "map.npz")
    for terrain, resolution in ((heights, RESOLUTION), (str(tmp_path / "map.npz"), None), (tmp_path / "map.npz", None)):
        planner = Planner(terrain, resolution=resolution)
        np.testing.assert_array_equal(planner.terrain.heights, heights)
    for terrain, resolution, words in (
        (heights, None, "need resolution="),
        (with_wall(), 0.05, "resolution is 0.05, but the height map has cells of 0.025 m"),
        (7, None, "terrain is a int"),
        ([[0.0], [0.0, 1.0]], 0.025, "need a 2D array"),
    ):
        with pytest.raises(InputError, match=words):
            Planner(terrain, resolution=resolution)
    with pytest.raises(InputError, match="terrain is a ndarray; need a HeightMap"):
        flat.update(flat.terrain.heights)


def test_m6_masked_cells_are_unknown_ground_to_the_planner():
    heights = np.zeros((100, 100))
    masked = np.ma.masked_array(heights, mask=np.zeros(heights.shape, bool))
    masked[40:60] = np.ma.masked
    planner = Planner(masked, resolution=RESOLUTION)
    assert np.isnan(planner.terrain.heights[40:60]).all() and not np.isnan(planner.terrain.heights[:40]).any()
    assert not planner.plan(*FAR).solved


def test_all_heuristics_solve_what_can_be_solved(flat):
    terrain, least = flat.terrain, flat.plan(START, GOAL).cost
    for heuristic in ("manual", FlatCosts("momaro"), CutsEverythingOff("momaro"), GeometricHeuristic(flat.world)):
        plan = Planner(terrain, heuristic=heuristic).plan(START, GOAL, weight=1.5)
        assert plan.solved, heuristic
        assert plan.cost >= least - 1e-6
        if isinstance(heuristic, GeometricHeuristic):
            assert plan.cost <= 1.5 * least + 1e-6


def test_plans_and_their_statistics_do_not_change_and_read_as_a_mapping(flat):
    plan = flat.plan(START, GOAL)
    assert plan.stats["expansions"] == plan.stats.expansions > 0 and dict(plan.stats) == plan.stats
    assert plan.stats.known().keys() == plan.stats.keys() - {
        "anchor_weight", "expansions_by", "ended", "unpolished_cost",
    }  # fmt: skip
    with pytest.raises(KeyError, match="speed"):
        plan.stats["speed"]
    for thing, name in ((plan, "cost"), (plan.stats, "seen"), (plan.actions[0], "kind")):
        with pytest.raises(FrozenInstanceError):
            setattr(thing, name, 0)


def test_states_are_expanded_again_for_a_heuristic_that_is_admissible_but_not_consistent(flat, monkeypatch):
    class Uneven(GeometricHeuristic):
        consistent = False

    def watched(*args, reopen, **settings):
        asked.append(reopen)
        return solve(*args, reopen=reopen, **settings)

    least, asked = flat.plan(START, GOAL).cost, []
    monkeypatch.setattr(query, "solve", watched)
    for heuristic, times in ((GeometricHeuristic(flat.world), 1), (Uneven(flat.world), 0), (FlatCosts("momaro"), 1)):
        asked.clear()
        plan = Planner(flat.terrain, heuristic=heuristic).plan(START, GOAL, weight=1.5, polish=0)
        assert plan.solved and asked.count(False) == times
        assert plan.bound == 1.5 if isinstance(heuristic, GeometricHeuristic) else 1 <= plan.bound < np.inf
        assert plan.cost <= plan.bound * least + 1e-6


def test_an_overestimating_heuristic_never_proves_a_cost_limit(flat):
    class Dear(FlatCosts):
        def edges(self, height_map, region=None, mask=None):
            return super().edges(height_map, region, mask) * 50

    least = flat.plan(START, GOAL).cost
    plan = Planner(flat.terrain, heuristic=Dear("momaro")).plan(START, GOAL, cost=3 * least)
    assert plan.solved and plan.cost <= 3 * least


def test_a_start_in_a_wall_is_explained_by_the_foot():
    plan = Planner(with_wall()).plan((1.12, 1.25, 0.0, 0, 0, 0, 0), (1.9, 1.25, 0.0))
    assert plan.status == Status.INVALID_START and not plan.solved
    assert np.isinf(plan.cost) and plan.states.shape == (0, 7) and plan.actions == ()
    assert "start" in plan.explain() and "rear_left foot cannot stand at (0.81, 1.49) m" in plan.explain()
    assert "\n" not in plan.explain()


def test_nobody_straddles_a_wall_even_with_the_base_right_above_it():
    heights = np.zeros((100, 100), np.float32)
    heights[44:56, 49:51] = 1.0  # along the robot, thin enough to fit between its feet
    planner = Planner(HeightMap(heights))
    x, y = planner.grid.center((50, 50))
    # An object that ends within the robot's footprint would be taken for the robot itself.
    plan = planner.plan((x, y, 0.0), (0.6, 0.6, 0.0), start_free=False)
    assert plan.status == Status.INVALID_START
    assert "the body would hit the ground that rises to 1.00 m at (1." in plan.explain()


def test_a_goal_in_a_wall_is_explained():
    plan = Planner(with_wall()).plan((1.9, 1.25, 0.0), (1.01, 1.25, 0.0))
    assert plan.status == Status.INVALID_GOAL
    assert "goal" in plan.explain() and "body" in plan.explain()


def test_feet_out_of_reach_or_on_unknown_ground_are_explained(flat):
    plan = flat.plan((*START, 0.6, 0, 0, 0), GOAL)
    assert plan.status == Status.INVALID_START
    assert "front_left foot is out of its reach" in plan.explain()
    plan = flat.plan((0.1, 0.1, 0.0), GOAL)
    assert "off the map" in plan.explain() and {cause.kind for cause in plan.causes} == {Kind.BORDER}


def test_a_wall_without_a_gap_is_proved_to_cut_off_the_goal():
    heights = np.zeros((40, 40), np.float32)
    heights[19:22] = 1.0
    rigid = toy(feet={"offset_min": 0.0, "offset_max": 0.0})
    plan = Planner(HeightMap(heights), rigid).plan((0.2, 0.5, 0), (0.8, 0.5, 0))
    assert plan.status == Status.INFEASIBLE
    assert "no way" in plan.explain()


def between_rooms(wall):
    """3 x 3 m, with a wall across: ``wall(y)`` gives its height at y (m)."""
    heights = np.zeros((120, 120), np.float32)
    heights[58:62] = wall(np.arange(120) * RESOLUTION)
    return Planner(HeightMap(heights), heuristic="manual")


def test_a_door_too_narrow_is_proved_and_explained_by_what_the_body_hits():
    planner = between_rooms(lambda y: abs(y - 1.5) > 0.25)
    plan = planner.plan((0.6, 1.5, 0.0), (2.4, 1.5, 0.0))
    assert plan.status == Status.INFEASIBLE and plan.stats["expansions"] == HARD
    words = plan.explain()
    assert words.startswith("there is no way: the robot cannot get from (") and "\n" not in words
    assert "the body would hit the ground that rises to 1.00 m at (1.4" in words


def test_a_wall_too_high_is_explained_by_the_foot_that_cannot_pass():
    plan = between_rooms(lambda y: 0.5).plan((0.6, 1.5, 0.0), (2.4, 1.5, 0.0))
    assert plan.status == Status.INFEASIBLE
    assert "foot gets nowhere from (1." in plan.explain() and "an edge of 50 cm" in plan.explain()


def test_limits_end_with_their_status_in_words(flat):
    least = flat.plan(START, GOAL).cost
    assert flat.plan(START, GOAL, cost=0.9 * least).status == Status.COST_LIMIT
    stopped = flat.plan(START, GOAL, expansions=10)
    assert stopped.status == Status.EXPANSION_LIMIT and "not decided: stopped after 10 expansions" in stopped.explain()
    full = flat.plan(*FAR, memory=300_000)
    assert full.status == Status.MEMORY_LIMIT and "MiB of states" in full.explain()
    late = flat.plan(*FAR, time=0.0)
    assert late.status == Status.TIME_LIMIT and "not decided: stopped after 0." in late.explain()


@pytest.mark.parametrize(
    "start, words",
    [
        ((math.nan, 0.9, 0.0), "start.*nan.*finite"),
        ((0.9, 0.9, math.inf), "start.*inf.*finite"),
        ((0.9, 0.9), "start.*need"),
        ((0.9, 0.9, 0.0, 0.0), "start.*4 foot offsets"),
        (("here", 0.9, 0.0), "start.*here"),
        (None, "start None"),
        ((7.0, 0.9, 0.0), "outside the map"),
    ],
)
def test_wrong_poses_are_named(flat, start, words):
    with pytest.raises(InputError, match=words) as error:
        flat.plan(start, GOAL)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("weight", [0.99, 0.0, -1.0, math.nan, math.inf])
def test_a_weight_below_one_is_refused(flat, weight):
    with pytest.raises(InputError, match="weight"):
        flat.plan(START, GOAL, weight=weight)


def test_a_planner_refuses_what_it_cannot_plan_on_or_with(flat):
    with pytest.raises(InputError, match=r"heuristic 'psychic'.*geometric"):
        Planner(flat.terrain, heuristic="psychic")
    with pytest.raises(InputError, match=r"0\.05 m.*0\.025 m"):
        Planner(HeightMap(np.zeros((80, 80), np.float32), resolution=0.05), conditioning=None)
    with pytest.raises(InputError, match=r"0\.5 m.*0\.2 m"):
        Planner(HeightMap(np.zeros((80, 80), np.float32), resolution=0.5))
    with pytest.raises(InputError, match="conditioning is 'strong'"):
        Planner(flat.terrain, conditioning="strong")
    with pytest.raises(InputError, match="unknown robot 'spot'"):
        Planner(flat.terrain, robot="spot")


class Counting(ManualCosts):
    """Manual costs that count the evaluated states."""

    asked = 0

    def edges(self, height_map, region=None, mask=None):
        self.asked += int(mask.sum())
        return super().edges(height_map, region, mask)


def with_doors(*doors):
    """A map of 8 x 6 m: a wall at x = 4 m with doors, each from y to y in cells."""
    heights = np.zeros((320, 240), np.float32)
    heights[158:162] = 1.0
    for first, end in doors:
        heights[158:162, first:end] = 0.0
    return HeightMap(heights)


def test_a_door_closed_in_the_map(monkeypatch):
    """An updated planner uses another door, or explains why there is no path, without being built again."""
    start, goal = (3.2, 1.4, 0.0), (4.8, 1.4, 0.0)
    near, far = (32, 80), (160, 208)
    costs, compiled = Counting("momaro"), []
    planner = Planner(with_doors(near, far), heuristic=costs)
    monkeypatch.setattr(world_update, "build_world", lambda part, of: compiled.append(part) or build_world(part, of))
    before = planner.plan(start, goal, 1.5, polish=0.0)
    assert before.solved and before.states[:, 1].max() < 2.5
    asked = costs.asked

    around = planner.update(with_doors(far)).plan(start, goal, 1.5, polish=0.0)
    assert 0 < costs.asked - asked < asked / 3
    fresh = Planner(with_doors(far), heuristic=ManualCosts("momaro")).plan(start, goal, 1.5, polish=0.0)
    assert around.solved and around.states[:, 1].max() > 4.2
    assert around.cost == fresh.cost > before.cost
    np.testing.assert_array_equal(around.states, fresh.states)

    planner.update(with_doors())
    closed = planner.plan(start, goal, 1.5, polish=0.0)
    assert closed.status == Status.INFEASIBLE
    assert "gets nowhere from" in closed.explain() and "an edge of 100 cm" in closed.explain()
    assert costs.asked - asked < asked
    assert len(compiled) == 2 and max(part.heights.size for part in compiled) < planner.terrain.heights.size / 2

    # With the door open again, the plan is the first plan.
    again = planner.update(with_doors(near, far)).plan(start, goal, 1.5, polish=0.0)
    np.testing.assert_array_equal(again.states, before.states)


@pytest.mark.parametrize("heuristic", ["geometric", "manual"])
def test_after_an_update_plans_are_those_of_a_new_planner(heuristic):
    start, goal = (0.9, 0.9, 0.0), (1.7, 1.0, 0.0)
    planner = Planner(HeightMap.flat((100, 80)), heuristic=heuristic)
    before = planner.plan(start, goal, 1.25)
    heights = np.zeros((100, 80), np.float32)
    heights[50:54, 20:60] = 0.02
    plan = planner.update(HeightMap(heights), (50, 20, 54, 60)).plan(start, goal, 1.25)
    fresh = Planner(HeightMap(heights), heuristic=heuristic).plan(start, goal, 1.25)
    assert plan.cost == fresh.cost != before.cost
    np.testing.assert_array_equal(plan.states, fresh.states)
    with pytest.raises(InputError, match=r"0\.5 m"):
        planner.update(HeightMap(heights, resolution=0.5))


def fails(*_, **__):
    raise MemoryError("no memory is left")


@pytest.mark.parametrize(
    ("place", "error"),
    [
        (None, InputError),  # a map too long for a planner
        ("hdsp.planning.shared_ground.build_world", MemoryError),
        ("hdsp.planning.shared_ground.updated_world", MemoryError),
        ("hdsp.planning.heuristics.abstract.uneven_cells", MemoryError),
        ("hdsp.terrain.conditioning.sampled", MemoryError),
        ("hdsp.terrain.conditioning.interpolated", MemoryError),
    ],
)
def test_a_failed_update_leaves_the_planner_as_it_was(place, error, monkeypatch):
    start, goal = (0.9, 0.9, 0.0), (1.7, 1.0, 0.0)
    cell = 0.05 if place and "interpolated" in place else 0.0125 if place and "sampled" in place else RESOLUTION
    nx, ny = round(2.5 / cell), round(2 / cell)
    before, heights = np.zeros((nx, ny), np.float32), np.zeros((nx, ny), np.float32)
    heights[nx // 2 : nx // 2 + round(0.1 / cell), ny // 4 : 3 * ny // 4] = 0.02
    after = HeightMap(heights, (1.0 if place and "build" in place else 0.0, 0.0), cell)
    costs = Counting("momaro")  # with manual costs beside it
    planner = Planner(HeightMap(before, resolution=cell), heuristic=costs)
    expected = planner.plan(start, goal, 1.25, polish=0.0)
    next(iter(planner.heuristic.others())).prepare()
    terrain = planner.terrain
    with monkeypatch.context() as patch:
        if place:
            patch.setattr(place, fails)
        for _ in range(2):
            with pytest.raises(error):
                planner.update(after if place else HeightMap(np.zeros((70000, 4))))
    found = planner.plan(start, goal, 1.25, polish=0.0)
    assert planner.terrain is found.terrain is terrain and planner.grid.shape == terrain.shape
    assert found.cost == expected.cost
    np.testing.assert_array_equal(found.states, expected.states)
    ends = [(x + after.origin[0], y, theta) for x, y, theta in (start, goal)]
    changed = planner.update(after).plan(*ends, 1.25, polish=0.0)
    fresh = Planner(after, heuristic=Counting("momaro")).plan(*ends, 1.25, polish=0.0)
    assert changed.cost == fresh.cost != expected.cost
    np.testing.assert_array_equal(changed.states, fresh.states)


def test_valid_tells_where_the_robot_can_stand(flat):
    assert flat.valid(START) and flat.valid((*START, 0.1, 0, 0, 0))
    assert not flat.valid((0.1, 0.1, 0.0))
    assert not flat.valid((*START, 0.9, 0, 0, 0))
    with pytest.raises(InputError, match="finite"):
        flat.valid((math.nan, 0, 0))


def test_feet_that_stand_on_each_other_are_no_valid_state(flat):
    plan = flat.plan((*START, -0.3, 0.3, 0, 0), GOAL)  # front and rear left foot 5 cm apart
    assert plan.status == Status.INVALID_START
    assert "left" in plan.explain()


def test_a_margin_keeps_the_body_off_walls_but_not_off_the_ground():
    wall = HeightMap(np.where(np.arange(100)[:, None] >= 60, 1.0, 0.0).astype(np.float32) * np.ones((1, 100)))
    near = (60 * RESOLUTION - 0.4625 - 0.025, 1.25, 0.0)  # 0.5 m from the centre of the first wall cell
    assert Planner(wall).valid(near) and Planner(wall, margin=0.03).valid(near)
    assert not Planner(wall, margin=0.06).valid(near)
    low = HeightMap(np.where(np.arange(100)[:, None] >= 60, 0.5, 0.0).astype(np.float32) * np.ones((1, 100)))
    assert Planner(low, margin=0.06).valid(near)  # it is lower than the base
    with pytest.raises(InputError, match=r"margin is 1\.0; the body of momaro is only 0\.3 m above the ground"):
        Planner(wall, margin=1.0)
    for margin in (-0.01, math.nan):
        with pytest.raises(InputError, match="margin is"):
            Planner(wall, margin=margin)


def test_progress_is_reported(flat):
    seen = []
    flat.plan(*FAR, progress=lambda expansions, seconds: seen.append((expansions, seconds)))
    assert len(seen) > 0 and sorted(seen) == seen


def test_the_readme_names_exist():
    assert hdsp.Planner is Planner and Planner(HeightMap.flat((80, 80))).prepare().heuristic.name == "geometric"

"""Searches on small maps against textbook searches; quick enough to run without the JIT, for mutation testing."""

from functools import cache

import numpy as np
import pytest

from hdsp.detailed.search import leaving
from hdsp.detailed.search.anytime import improve
from hdsp.detailed.search.backward import begin_toward, is_final, lower_bound, new_backward, settle
from hdsp.detailed.search.estimate import final_estimates, geometric_estimate, grid_estimate
from hdsp.detailed.search.life_cycle import GuideTurn, Search
from hdsp.detailed.search.multi_heuristic import solve_multi
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.reached import METRES_PER_RADIAN, reached_by
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.search.windows import Windows
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.world import build_world
from hdsp.robot.lattice import cells, heading_angle
from hdsp.terrain.height_map import HeightMap
from tests.detailed.instances import NIMBLE, action_tuple, costs_to_go
from tests.detailed.small_scenes import SCENES, by_scene, exact_costs, small_scene, some_goals
from tests.detailed.test_search import inconsistent
from tests.naive import Naive, dijkstra
from tests.naive_ground import INF
from tests.naive_relaxed import relaxed_edges

#: Costs in the store have single precision.
NEARLY = 1 + 1e-5
#: Scenes whose robots have no costs on even ground (``free_space``), which take long without the JIT.
WITHOUT_FREE_SPACE = [name for name in SCENES if name not in ("nimble", "ahead only")]


def asked(name, goal, **options):
    """Result of a search in a scene, by default with the geometric heuristic."""
    scene = small_scene(name)
    heuristic = options.pop("heuristic", None) or geometric_estimate(scene.world, np.array(goal))
    return solve(scene.world, np.array(scene.start), np.array(goal), heuristic, rules=scene.rules, **options)


def assert_legal(scene, path, goal):
    """A path from the start to the goal; costs are those of the twin."""
    states = [tuple(state) for state in path.states.tolist()]
    assert states[0] == scene.start and states[-1] == goal and len(path.actions) == len(path.costs) == len(states) - 1
    for state, reached, code, cost in zip(states, states[1:], path.actions, path.costs, strict=False):
        legal = {(action, to): price for action, to, price in scene.graph[state]}
        assert legal[action_tuple(int(code)), reached] == pytest.approx(cost, rel=1e-6)


@by_scene
def test_a_search_finds_the_optimum_with_no_more_expansions_than_astar(name):
    scene = small_scene(name)
    gone = dijkstra(scene.twin, scene.start).cost
    for goal in some_goals(name):
        result, least = asked(name, goal), exact_costs(name, goal)[scene.start]
        assert result.status == [Status.SOLVED] and result.bound == 1
        assert result.cost[0] == pytest.approx(least, rel=1e-5, abs=1e-6)
        assert least * (1 - 1e-4) <= result.lower_bound <= least * NEARLY
        assert_legal(scene, result.paths[0], goal)
        promising = sum(cost + scene.twin.geometric(state, goal) <= least * NEARLY for state, cost in gone.items())
        assert result.expansions <= promising <= result.seen + len(scene.graph)
        assert result.expansions <= result.seen <= len(scene.graph)


@by_scene
def test_weights_bounds_and_limits_hold(name):
    scene = small_scene(name)
    for goal in some_goals(name, 3)[1:]:
        least = exact_costs(name, goal)[scene.start]
        for weight, reopen in ((2.0, True), (2.0, False), (3.0, False)):
            result = asked(name, goal, weight=weight, reopen=reopen, paths=False)
            assert least <= result.cost[0] * NEARLY and result.cost[0] <= weight * least * NEARLY
            assert result.bound == weight and result.lower_bound <= least * NEARLY and result.paths == []
            assert reopen or result.expansions <= result.seen
        below = asked(name, goal, limits=Limits(cost=0.99 * least))
        assert below.status == [Status.COST_LIMIT]
        assert 0.99 * least * (1 - 1e-5) <= below.lower_bound <= 0.99 * least
        assert asked(name, goal, weight=2.0, limits=Limits(cost=1.001 * least)).status == [Status.SOLVED]
        needed = asked(name, goal).expansions
        some = asked(name, goal, limits=Limits(expansions=needed // 2))
        assert some.status == [Status.EXPANSION_LIMIT] and some.expansions == needed // 2


@by_scene
def test_unreachable_goals_are_proved_by_all_reachable_states(name):
    scene = small_scene(name)
    (missing,) = [state for state in beside(name) if state not in scene.graph][:1]
    result = asked(name, missing)
    assert result.status == [Status.INFEASIBLE] and np.isinf(result.lower_bound)
    assert result.seen == result.expansions == len(scene.graph)
    goals = np.array([missing, *some_goals(name, 3), (0, 0, 0, 0, 0, 0, 0), scene.start])
    blind = geometric_estimate(scene.world, goals[0])._replace(distance=0.0, turn=0.0, foot=0.0)
    together = asked(name, goals, heuristic=blind)
    assert together.status == [Status.INFEASIBLE, *[Status.SOLVED] * 4, Status.INVALID_GOAL, Status.SOLVED]
    expected = [exact_costs(name, tuple(goal)).get(scene.start, INF) for goal in goals.tolist()]
    assert together.cost == pytest.approx(expected, rel=1e-5, abs=1e-6)
    near = asked(name, goals[1:4], heuristic=blind, nearest=True)
    assert near.cost[0] == pytest.approx(min(expected[1:4]), rel=1e-5) and expected[1 + near.reached] == min(
        expected[1:4]
    )


def beside(name):
    """Valid states near those of a scene, in and out of reach."""
    scene = small_scene(name)
    turned = {(*state[:2], (state[2] + 9) % 64, *state[3:]) for state in scene.graph}
    return sorted(state for state in turned if scene.twin.valid(state))


@by_scene
def test_inconsistent_heuristics_lose_no_optimality_because_states_are_reopened(name):
    scene, rng = small_scene(name), np.random.default_rng(3)
    reopened = 0
    for goal in some_goals(name):
        to_go = exact_costs(name, goal)
        guide, least = inconsistent(scene.world, to_go, rng), to_go[scene.start]
        result, never = asked(name, goal, heuristic=guide), asked(name, goal, heuristic=guide, reopen=False)
        assert result.cost[0] == pytest.approx(least, rel=1e-5, abs=1e-6)
        assert never.expansions <= never.seen
        reopened += result.expansions > result.seen or result.expansions > never.expansions
        wrong = guide._replace(table=2 * guide.table)
        for share in (0.99, 1.001):
            options = {"heuristic": wrong, "admissible": False, "reopen": False, "limits": Limits(cost=share * least)}
            limited = asked(name, goal, **options)
            assert limited.status == [Status.SOLVED if least <= share * least else Status.COST_LIMIT]
            assert limited.bound == INF
    assert reopened > 0


@by_scene
def test_anytime_rounds_end_with_the_optimum_and_valid_bounds(name):
    scene = small_scene(name)
    for goal in some_goals(name, 3):
        least, ends = exact_costs(name, goal)[scene.start], (np.array(scene.start), np.array(goal))
        admissible = geometric_estimate(scene.world, ends[1])
        exaggerated = admissible._replace(distance=3 * admissible.distance, foot=4 * admissible.foot)
        for guide in (None, exaggerated):
            # Without the window of headings, the optimum may be lower.
            found = list(improve(scene.world, *ends, (3.0, 1.5, 1.0), admissible, guide))
            lower = min(least, found[-1].result.cost[0])
            assert [each.ended for each in found] == [None] * (len(found) - 1) + [Status.SOLVED]
            assert found[-1].result.bound == 1 and found[-1].result.cost[0] <= least * NEARLY
            for each in found:
                assert 0 <= each.result.lower_bound <= lower * NEARLY
                assert each.result.cost[0] <= each.result.bound * lower * NEARLY or each.result.paths == [None]


@by_scene
def test_a_multi_heuristic_search_keeps_its_bound(name):
    scene, rng = small_scene(name), np.random.default_rng(4)
    for goal in some_goals(name, 3):
        anchor, least = geometric_estimate(scene.world, np.array(goal)), exact_costs(name, goal)[scene.start]
        blind = anchor._replace(distance=0.0, turn=0.0, foot=0.0)
        guides = [
            anchor._replace(distance=4 * anchor.distance),
            inconsistent(scene.world, exact_costs(name, goal), rng),
        ]
        ends = np.array(scene.start), np.array(goal)
        for w1, w2, some in ((1.0, 1.0, guides), (1.5, 2.0, guides[:1]), (3.0, 1.0, [guides[1], blind])):
            result = solve_multi(
                scene.world, *ends, anchor, some, weight=w1, anchor_weight=w2, rules=scene.rules
            )  # fmt: skip
            assert result.status == [Status.SOLVED] and 1 <= result.bound <= w1 * w2
            assert least <= result.cost[0] * NEARLY and result.cost[0] <= result.bound * least * NEARLY
            assert result.lower_bound <= least * NEARLY and sum(result.expansions_by) == result.expansions
            assert result.expansions <= 2 * result.seen and len(result.expansions_by) == 1 + len(some)
            assert_legal(scene, result.paths[0], goal)
        limited = solve_multi(
            scene.world, *ends, anchor, guides, rules=scene.rules, limits=Limits(cost=0.99 * least)
        )  # fmt: skip
        assert limited.status == ([Status.COST_LIMIT] if least > 0 else [Status.SOLVED])
    (missing,) = [state for state in beside(name) if state not in scene.graph][:1]
    result = solve_multi(scene.world, ends[0], np.array(missing), anchor, guides, rules=scene.rules)
    assert result.status == [Status.INFEASIBLE] and result.seen == len(scene.graph)


def test_ends_without_standing_are_told_before_any_search():
    scene, (goal, *_) = small_scene("nimble"), some_goals("nimble")
    outside, anchor = (0, 0, 0, 0, 0, 0, 0), geometric_estimate(scene.world, np.array(goal))
    for ends, status in (((outside, goal), Status.INVALID_START), ((scene.start, outside), Status.INVALID_GOAL)):
        start, end = map(np.array, ends)
        (improved,) = improve(scene.world, start, end, (2.0, 1.0), anchor)
        together = solve_multi(scene.world, start, end, anchor, [anchor])
        for result in (solve(scene.world, start, end, anchor), improved.result, together):
            assert result.status == [status] and result.expansions == result.seen == 0
        assert improved.ended == status and improved.weight == 2.0 and improved.result.lower_bound >= 0


@pytest.mark.parametrize("name", ["fixed wheels", "forward", "short arcs"])
@pytest.mark.parametrize("turned", [0, 30])
def test_the_backward_search_finds_the_relaxed_costs(name, turned):
    """Exact costs-to-go over poses, in both layers; `tests.naive_relaxed` has the same problem in plain Python."""
    scene, goal = small_scene(name), some_goals(name)[-2]
    world = scene.world
    e = grid_estimate(world, np.array(goal), np.zeros(1, int), 1 << 28)
    follow, to_go = e.back.follow, relaxed_costs(name, goal, e.back.follow)
    back = new_backward(world, np.array([goal, goal]), e.distance, e.turn, follow, 1 << 28)
    begin_toward(world, back, *scene.start[:2], (scene.start[2] + turned) % 64)
    left = follow * (sum(goal[3:]) - 4 * world.tables.lowest)
    asked_for = sorted(to_go)[:: len(to_go) // 60 + 1]
    for node in [(0, *scene.start[:3]), *asked_for]:
        while not is_final(world, back, *node):
            before = lower_bound(world, back, *node)
            settle(world, back, *node, 20)
            assert before <= lower_bound(world, back, *node) <= to_go[node] + left + 1e-9
        assert lower_bound(world, back, *node) == pytest.approx(to_go[node] + left, rel=1e-5, abs=1e-6), node


@pytest.mark.parametrize("name", WITHOUT_FREE_SPACE)
def test_a_guide_that_comes_later_counts_from_its_expansion_on(name):
    scene, goal = small_scene(name), some_goals(name)[-2]
    alone, least = asked(name, goal), exact_costs(name, goal)[scene.start]

    def guided(after, **options):
        guide = grid_estimate(scene.world, np.array(goal), np.zeros(1, int), 1 << 28)
        return asked(name, goal, guide=guide, guide_from=after, **options)

    ends = [guided(after).expansions for after in (0, alone.expansions // 2, alone.expansions)]
    assert ends == sorted(ends) and ends[0] < ends[-1] == alone.expansions
    for after in (0, 5, alone.expansions // 2):
        found = guided(after)
        assert found.cost[0] == pytest.approx(least, rel=1e-5, abs=1e-6) and found.bound == 1
        assert_legal(scene, found.paths[0], goal)
        assert guided(after, limits=Limits(cost=0.99 * least)).status == [Status.COST_LIMIT]


@cache
def relaxed_costs(name, goal, follow):
    """Least costs to a goal from all poses from which the relaxed problem leads there."""
    scene = small_scene(name)
    twin = Naive(scene.twin.heights, scene.twin.robot)
    graph, missing = {}, [(0, *scene.start[:3]), (1, *goal[:3])]
    while missing:
        if (node := missing.pop()) not in graph:
            graph[node] = list(relaxed_edges(twin, follow, node))
            missing += [reached for reached, _ in graph[node]]
    return costs_to_go(graph, (int(any(goal[3:])), *goal[:3]))


@pytest.mark.parametrize("name", WITHOUT_FREE_SPACE)
def test_grid_estimates_are_admissible_and_lead_to_the_optimum(name):
    scene = small_scene(name)
    for goal in some_goals(name, 3):
        heuristic = grid_estimate(scene.world, np.array(goal), np.zeros(1, int), 1 << 28)
        result, to_go = asked(name, goal, heuristic=heuristic), exact_costs(name, goal)
        assert result.cost[0] == pytest.approx(to_go[scene.start], rel=1e-5, abs=1e-6)
        assert result.expansions <= asked(name, goal).expansions
        some = sorted(to_go)[:: len(to_go) // 20 + 1]
        found = final_estimates(scene.world, heuristic, pack_states(some, scene.world.tables.lowest))
        assert (found <= np.array([to_go[state] for state in some]) * NEARLY + 1e-6).all()


@by_scene
def test_windows_find_the_cheapest_paths_between_near_states(name):
    scene = small_scene(name)
    twin, searches = Naive(scene.twin.heights, scene.twin.robot), Windows(scene.world)
    for start in some_goals(name, 4):
        gone = dijkstra(twin, start, most=25)
        for goal in list(gone.cost)[1::8]:
            least, ends = gone.cost[goal], (np.array(start), np.array(goal))
            assert searches.least(*ends) == pytest.approx(twin.geometric(start, goal), abs=1e-9)
            path = searches.path(*ends, least * NEARLY, 1000, INF)
            assert path.cost == pytest.approx(least, rel=1e-5)
            assert (path.states[0] == start).all() and (path.states[-1] == goal).all()
            before = searches.expansions
            assert searches.path(*ends, least / NEARLY, 1000, INF) is None
            assert searches.path(*ends, least * NEARLY, 1000, -INF) is None
            between = searches.expansions - before
            assert searches.path(*ends, INF, 1, INF) is None or len(path.actions) <= 1
            assert searches.expansions <= before + between + 1


@by_scene
def test_a_search_outward_ends_at_the_farthest_state(name, monkeypatch):
    scene = small_scene(name)
    monkeypatch.setattr(leaving, "Rules", lambda: scene.rules)
    away = max(np.hypot(state[0] - scene.start[0], state[1] - scene.start[1]) for state in scene.graph)
    seen = leaving.leave(scene.world, np.array(scene.start), away + 1e-6)
    assert sorted(map(tuple, seen.tolist())) == sorted(scene.graph)
    assert leaving.leave(scene.world, np.array(scene.start), away) is None
    assert len(leaving.leave(scene.world, np.array(scene.start), away + 1e-6, expansions=5)) < len(scene.graph)


def test_a_search_outward_goes_straight_on_even_ground():
    world = build_world(HeightMap.flat((40, 40)), NIMBLE)
    assert leaving.leave(world, np.array((12, 20, 0, 0, 0, 0, 0)), 12.0, expansions=8) is None


@by_scene
def test_reached_states_are_told_by_pose_and_by_distance_to_a_goal(name):
    scene = small_scene(name)
    goals = beside(name)[:: len(beside(name)) // 4 + 1]
    search = Search(scene.world, np.array(scene.start), np.array(goals[:1]), scene.rules)
    ended = search.begin(geometric_estimate(scene.world, np.array(goals[0])), 1.0, True)
    while ended is None:
        ended = search.advance()
    assert (ended == Status.SOLVED) == (goals[0] in scene.graph)
    known = scene.graph if ended == Status.INFEASIBLE else None
    for goal in goals:
        found = reached_by(search, np.array(goal))
        if known is None:
            continue
        expected = np.zeros(scene.twin.shape, np.uint64)
        for x, y, heading, *_ in known:
            expected[x, y] |= np.uint64(1) << np.uint64(heading)
        np.testing.assert_array_equal(found.headings, expected)
        nearest = min(away(state, goal) for state in known)
        assert away(tuple(found.nearest.tolist()), goal) == pytest.approx(nearest, abs=1e-9)


@by_scene
def test_searches_in_turns_end_as_the_first_of_them_alone(name):
    scene = small_scene(name)
    goal = some_goals(name)[-2]
    plain = geometric_estimate(scene.world, np.array(goal))
    guides = [plain._replace(distance=0.0, turn=0.0, foot=0.0), plain, plain._replace(turn=0.0)]
    alone = [asked(name, goal, heuristic=guide) for guide in guides]
    for turns in ([(1, 3), (0, 4), (2, 2), (1, 5), (2, 900)], [(0, 5), (2, 10), (0, 1)], []):
        schedule = (GuideTurn(number, lambda _, number=number: guides[number], length) for number, length in turns)
        result = asked(name, goal, heuristic=guides[0], turns=schedule, first_turn=7)
        done, number = [0] * len(guides), 0
        for number, length in [(0, 7), *turns]:
            if done[number] + length > alone[number].expansions:
                break
            done[number] += length
        done[number] = alone[number].expansions
        assert result.expansions == sum(done) and result.cost[0] == alone[number].cost[0]
        assert result.status == alone[number].status and result.memory >= alone[number].memory
    late = asked(name, goal, heuristic=guides[0], turns=iter([GuideTurn(1, lambda _: None, 1)]), first_turn=1)
    assert late.status == [Status.TIME_LIMIT] and late.expansions == 1


def away(state, goal):
    """Distance (cells) between two states, where turns and feet count as well."""
    turn = abs(state[2] - goal[2])
    turned = cells(METRES_PER_RADIAN * float(heading_angle(1))) * min(turn, 64 - turn)
    feet = sum(abs(a - b) for a, b in zip(state[3:], goal[3:], strict=True))
    return np.hypot(state[0] - goal[0], state[1] - goal[1]) + turned + 1e-3 * feet

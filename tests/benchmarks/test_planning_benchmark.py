"""The planning benchmark: pairs of its maps, statistics, optima, and a small run from the command line."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.planning import __main__ as benchmark
from benchmarks.planning.cases import make_cases, read_case
from benchmarks.planning.edge_cache import KeptCosts
from benchmarks.planning.maps import Map, maps
from benchmarks.planning.optima import prove, read_optima
from benchmarks.planning.pairs import draw_pairs, ground_pieces, map_key, pair_key
from benchmarks.planning.runs import planner_for
from benchmarks.planning.statistics import bootstrap_mean, geometric_mean_ratio
from benchmarks.planning.summary import comparisons, counts, gather, rows
from hdsp.abstract import ManualCosts
from hdsp.planning.heuristics import standing_states
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap


def with_platform() -> HeightMap:
    """Ground of 3.5 x 4 m, whose farther half is one step higher."""
    heights = np.zeros((140, 160), np.float32)
    heights[:, 80:] = 0.12
    return HeightMap(heights)


def one_map(seed: int, count: int) -> list[Map]:
    return [Map("platform", "arena", with_platform())]


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner(with_platform(), heuristic="manual", conditioning=None)


def test_a_ratio_is_the_geometric_mean_of_its_pairs_and_its_interval_holds_whole_groups():
    over, under = [1.0, 2.0, 8.0], [2.0, 2.0, 1.0]
    found = geometric_mean_ratio(over, under, ["a", "a", "b"])
    assert found.mean == pytest.approx((0.5 * 1 * 8) ** (1 / 3), abs=1e-4)
    # Samples of groups: (a, a), (a, b), (b, b); the interval spans from the first to the last.
    assert found.low == pytest.approx(0.5**0.5, abs=1e-4)
    assert found.high == pytest.approx(8, abs=1e-4)


def test_with_a_group_for_each_value_the_interval_is_that_of_plain_numpy():
    values = np.random.default_rng(3).normal(size=40)
    found = bootstrap_mean(values, range(40))
    means = values[np.random.default_rng(4).integers(40, size=(20_000, 40))].mean(axis=1)
    assert found.mean == pytest.approx(values.mean())
    assert (found.low, found.high) == pytest.approx(np.quantile(means, [0.025, 0.975]), abs=0.02)
    assert bootstrap_mean([], []).mean is None


def test_pairs_spread_over_distances_and_levels(planner):
    pairs = draw_pairs(planner, 8, np.random.SeedSequence(5))
    assert len({pair.key for pair in pairs}) == 8
    assert all(planner.can_leave(pose) for pair in pairs for pose in (pair.start, pair.goal))
    distances = sorted(pair.distance for pair in pairs)
    assert distances[0] >= 0.8
    assert distances[-1] > 2 * distances[0]
    pieces = ground_pieces(planner.terrain, 0.05)
    assert pieces[60, 120] != pieces[60, 20] > 0
    at = [pieces[tuple((np.array(pose[:2]) / 0.025).astype(int))] for pose in (pairs[0].start, pairs[0].goal)]
    assert pairs[0].levels == (at[0] != at[1])
    assert any(pair.levels for pair in pairs)
    assert draw_pairs(planner, 8, np.random.SeedSequence(5)) == pairs


def test_maps_follow_from_the_seed():
    first, again, other = (next(maps(seed, 1)) for seed in (1000, 1000, 1001))
    assert map_key(first.terrain) == map_key(again.terrain) != map_key(other.terrain)


def test_a_pair_on_a_changed_map_has_no_optimum():
    robot, terrain = Robot.load("momaro"), with_platform()
    changed = terrain.heights.copy()
    changed[0, 0] += 0.01
    ends = (1.0, 1.0, 0.0), (2.0, 1.0, 0.0)
    keys = [pair_key(map_key(HeightMap(heights)), robot, *ends) for heights in (terrain.heights, changed)]
    assert keys[0] != keys[1]
    other = pair_key(map_key(terrain), Robot.load("go2w"), *ends)
    assert other != keys[0]
    entry = {"cost": 1.0, "proved": True}
    results = gather([], [], {keys[0]: entry})
    assert not results.optima and not results.best


def test_edges_are_kept_and_completed(tmp_path, planner):
    standing = standing_states(planner.world)
    half = standing.copy()
    half[:, :15] = False
    costs = ManualCosts(planner.robot)
    expected = costs.edges(planner.terrain, mask=standing)
    KeptCosts(costs, tmp_path).edges(planner.terrain, mask=half)
    np.testing.assert_array_equal(KeptCosts(costs, tmp_path).edges(planner.terrain, mask=standing), expected)
    kept = KeptCosts(costs, tmp_path)
    kept.costs = None  # everything is on disk
    np.testing.assert_array_equal(kept.edges(planner.terrain, mask=standing), expected)


def test_hard_pairs_and_limits():
    def run(pair, heuristic, expansions, cost):
        status = "solved" if cost else "expansion_limit"
        parts = dict.fromkeys(("cpu_s", "heuristic_s", "search_s", "proof_s", "polish_s"), 0.1)
        return {
            "pair": pair, "heuristic": heuristic, "weight": 1.25, "status": status, "expansions": expansions,
            "cost": cost, "polished_cost": cost, **parts,
        }  # fmt: skip

    runs = [
        run("a", "manual", 100, 2.0), run("a", "learned", 200, 2.2),
        run("b", "manual", 500_000, None), run("b", "learned", 5_000, 3.0),
        run("c", "manual", 500_000, None), run("c", "learned", 500_000, None),
    ]  # fmt: skip
    results = gather([], runs, {})._replace(maps={"a": "x", "b": "x", "c": "x"}, optima={"a": 2.0})
    assert results.solvable == ["a", "b"]
    assert results.hard() == ["b"]
    assert counts(results, None)["undecided"] == 1
    ratio = next(row for row in comparisons(results, None) if row["group"] == "hard")
    assert (ratio["expansions"], ratio["capped"], ratio["cost"]) == (0.01, [0, 1], None)
    learned = next(row for row in rows(results) if row["heuristic"] == "learned")
    assert (learned["solved"], learned["above_optimum"], learned["optima"]) == (2, 0.1, 1)


def test_a_small_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("benchmarks.planning.cases.maps", one_map)
    picture, page = tmp_path / "picture.png", tmp_path / "page.md"
    page.write_text("<!-- written by benchmarks.planning: begin -->\n<!-- written by benchmarks.planning: end -->\n")
    options = [
        "--seed", "1000", "--pairs", "4", "--heuristics", "manual", "geometric", "--weights", "1.25", "2", "--before",
        "none", "--expansions", "50000", "--out", str(tmp_path / "out"), "--picture", str(picture),
        "--page", str(page),
    ]  # fmt: skip
    result = benchmark.main(options)
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == result
    assert result["pairs"] == 4 == result["solvable"] + result["unsolvable_proved"] + result["undecided"]
    assert result["solvable"] >= 1 and result["contradictions"] == 0
    assert {(row["heuristic"], row["weight"]) for row in result["heuristics"]} == {
        (name, weight) for name in ("manual", "geometric") for weight in (1.25, 2.0)
    }
    assert picture.stat().st_size > 10_000
    assert "| manual | 1.25 |" in page.read_text()
    # A further run takes all searches from the folder: times are the same to the last digit.
    assert benchmark.main(options) == result


def test_cases_belong_to_a_robot(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.planning.cases.maps", lambda *_: [Map("flat", "arena", HeightMap.flat((100, 100)))])
    case = next(make_cases(1000, 1, 3, tmp_path, robot="go2w"))
    assert read_case(case.folder) == case
    assert planner_for(case, "manual").robot.name == "go2w"
    assert case.pairs[0].key not in {pair.key for pair in next(make_cases(1000, 1, 3, tmp_path)).pairs}


def test_optima_stay_those_of_a_robot_whose_motions_change():
    """Values that decide no plan are no part of the key, and the kept optima are those of the preset as it is."""
    robot, poses = Robot.load("momaro"), ((1.0, 1.0, 0.0), (2.0, 2.0, 0.0))
    key = pair_key("map", robot, *poses)
    assert key == pair_key("map", replace(robot, speeds=replace(robot.speeds, drive=2 * robot.speeds.drive)), *poses)
    assert key != pair_key("map", replace(robot, step=replace(robot.step, max_length=0.3)), *poses)
    arena = next(iter(maps(0, 1)))
    kept = [entry for key, entry in read_optima().items() if entry["map"].startswith("00 ")]
    terrain = map_key(Planner(arena.terrain, conditioning=None).terrain)
    assert kept and all(
        pair_key(terrain, robot, tuple(entry["start"]), tuple(entry["goal"])) in read_optima() for entry in kept
    )


def test_optima_are_proved_once(tmp_path, monkeypatch):
    flat = HeightMap.flat((100, 100))
    monkeypatch.setattr("benchmarks.planning.cases.maps", lambda seed, count: [Map("flat", "arena", flat)])
    case = next(make_cases(1000, 1, 3, tmp_path))
    pair = min(case.pairs, key=lambda pair: pair.distance)
    known = {pair.key: Planner(flat, heuristic="manual").plan(pair.start, pair.goal, 2.0).cost}
    path = tmp_path / "optima.json"
    others = {other.key for other in case.pairs if other != pair}
    found = prove([case], known, others, 60.0, 500_000, path)
    assert found == read_optima(path)
    assert found[pair.key]["proved"] and found[pair.key]["cost"] <= known[pair.key] + 1e-6
    written = path.stat().st_mtime_ns
    prove([case], known, others, 60.0, 500_000, path)
    assert path.stat().st_mtime_ns == written

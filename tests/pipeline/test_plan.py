"""The planning experiment: its terrain, and the record for each search."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.detailed.actions.action import Action, ActionKind
from hdsp.learning import LearnedAbstraction, LearnedCosts, ModelSettings, Provenance
from hdsp.learning.networks import build_network
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot
from hdsp.terrain.arenas import read_arena
from hdsp.terrain.height_map import HeightMap
from pipeline.config import configure
from pipeline.plan import (
    checked,
    collisions,
    describe,
    in_words,
    read_ground,
    read_tasks,
    search_tasks,
    series_to_show,
    timed,
)
from pipeline.side_by_side import side_by_side, with_threads
from pipeline.stage import Folders
from tests.learning.synthetic import TINY_MODEL

ROBOT = Robot.load("momaro")


@pytest.fixture(scope="module")
def config():
    return configure(["planner.repeats=3"])


def test_the_scan_is_planned_on_and_the_description_is_the_truth(config, tmp_path):
    (tmp_path / "data/arena").mkdir(parents=True)
    scan = HeightMap.flat((400, 400))
    scan.save(tmp_path / "data/arena/scanned.npz")
    ground = read_ground(config.arena, Folders(tmp_path, tmp_path))
    np.testing.assert_array_equal(ground.terrain.heights, scan.heights)
    assert ground.about == "the scanned arena"
    assert ground.truth == read_arena(config.arena)


def test_without_a_scan_the_arena_itself_is_planned_on(config, tmp_path):
    (tmp_path / "data/arena").mkdir(parents=True)
    (tmp_path / "data/arena/absent.json").write_text(json.dumps({"reason": "no MuJoCo"}))
    ground = read_ground(config.arena, Folders(tmp_path, tmp_path))
    np.testing.assert_array_equal(ground.terrain.heights, ground.truth.height_map().heights)
    assert "not scanned (no MuJoCo)" in ground.about


def test_before_the_scan_and_with_another_source_there_is_no_ground(config, tmp_path):
    with pytest.raises(InputError, match=r"scanned\.npz"):
        read_ground(config.arena, Folders(tmp_path, tmp_path))
    with pytest.raises(InputError, match=r"arena\.source is 'elsewhere'; need one of scanned, random"):
        configure(["arena.source=elsewhere"])


def test_a_path_of_the_arena_is_checked_against_its_blocks(config):
    arena = read_arena(config.arena)
    planner = Planner(arena.height_map(), ROBOT, margin=config.planner.margin)
    tasks = read_tasks(planner.terrain, config)
    assert list(tasks) == ["I", "II", "III", "IV", "V", "VI", "VII"]
    result, seconds = timed(planner, *tasks["VII"], 2.0, config.planner)
    assert result.solved and seconds > 0
    run = describe("VII", "geometric", 2.0, result, seconds) | checked(arena, result, ROBOT)
    assert run["collision_free"] is True and run["body_clearance"] > 0
    assert in_words(run).startswith("VII, geometric, W = 2: solved, cost") and in_words(run).endswith(", free")

    states = np.array([[5.2, y, np.pi / 2, 0, 0, 0, 0] for y in np.arange(5.0, 9.99, 0.1)])
    through = replace(result, states=states, actions=(Action(ActionKind.DRIVE),) * 49)
    wall = describe("I", "manual", 2.0, through, 1.0) | checked(arena, through, ROBOT)
    assert wall["collision_free"] is False and "1.20 m high" in wall["collisions"][0]
    assert "COLLIDES" in in_words(wall)
    found = collisions([run, wall, {"collision_free": None}])
    assert (found["checked"], found["free"]) == (2, 1)
    assert found["least_body_clearance"] == wall["body_clearance"] < 0


def test_the_picture_of_all_paths_shows_the_last_heuristic_at_the_papers_weight():
    runs = [{"heuristic": name, "weight": weight} for name in ("geometric", "trained") for weight in (1.0, 1.25, 2.0)]
    assert series_to_show(runs) == ("trained", 1.25)
    assert series_to_show([*runs, {**runs[0], "heuristic": "shipped"}]) == ("trained", 1.25)


def test_a_network_without_a_dense_map_judges_the_states_that_queries_need(tmp_path):
    config = configure(["profile=tiny", "planner.repeats=1"])
    model = load_settings(ModelSettings, TINY_MODEL)
    torch.manual_seed(0)
    abstraction = LearnedAbstraction(build_network(model), model, Provenance.of(ROBOT, ""))
    abstraction.save_pretrained(tmp_path / "models/abstraction", picture=False)
    folders = Folders(tmp_path, tmp_path)
    terrain = read_ground(config.arena, folders).terrain
    tasks = read_tasks(terrain, config)
    found = search_tasks(config, folders, "trained", tasks)
    assert found.edges is not None and 0 < found.edges["share"] < 1 and found.edges["seconds"] > 0
    planner = Planner(terrain, ROBOT, LearnedCosts(abstraction, robot=ROBOT), config.planner.margin).prepare()
    for run in found.runs:
        plan = planner.plan(*tasks[run["pair"]], weight=run["weight"], polish=0.0)
        assert (run["cost"], run["expansions"]) == (plan.cost, plan.stats.expansions)


def test_jobs_run_side_by_side_and_their_results_are_in_order(config):
    assert side_by_side([partial(pow, 2, k) for k in range(3)], 2) == [1, 2, 4]
    assert with_threads(config, 3).runtime.hardware.threads == 3
    assert with_threads(configure(["runtime.hardware.threads=1"]), 3).runtime.hardware.threads == 1

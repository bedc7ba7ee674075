"""Values show themselves in a line: no contents of arrays, no addresses in memory."""

import enum
import importlib
import inspect
from dataclasses import replace

import numpy as np
import pytest

from hdsp import HeightMap, Planner, Robot, Status
from hdsp.abstract.manual import ManualCosts
from hdsp.detailed.causes import Cause, Kind
from hdsp.labels import (
    CoursePatchSettings,
    LabelCounts,
    LabelReason,
    LabelSettings,
    MapTasks,
    PatchRun,
    ScanFolder,
    ScannedCourse,
    Shard,
)
from hdsp.labels.shards import write_shard
from hdsp.learning import LearnedAbstraction, LearnedCosts, ModelSettings, TaskStream, TrainResult, build_network
from hdsp.learning.learning_settings import BatchSettings
from hdsp.planning import AbstractHeuristic, Collision, PlanCheck, PlanStatistics
from hdsp.planning.answers.findings import Findings
from hdsp.terrain import (
    Arena,
    Bank,
    Block,
    Ramp,
    RandomArena,
    Scan,
    ScanFile,
    Scene,
    Staircase,
    TerrainSettings,
    Tiles,
    Tilted,
)
from hdsp.terrain.cost_maps import cost_maps
from hdsp.terrain.obstacles import TiltedGround
from hdsp.terrain.simulation import CourseSettings, Lidar, random_course
from tests.labels.task_sets import random_tasks

PACKAGES = "hdsp", "hdsp.terrain", "hdsp.planning", "hdsp.labels", "hdsp.learning"
#: PyTorch shows the layers of a module, as its users expect.
LAYERS = {"AbstractionModule", "TaskNetwork"}


def public_classes():
    for package in PACKAGES:
        face = importlib.import_module(package)
        for found in [getattr(face, name) for name in face.__all__ if name not in LAYERS]:
            if inspect.isclass(found) and not (inspect.isabstract(found) or issubclass(found, enum.Enum | Exception)):
                yield found


CLASSES = {each.__name__: each for each in public_classes()}


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """Large values of public classes, by class name."""
    rng = np.random.default_rng(0)

    def numbers(count):
        return rng.random(count).tolist()

    heights = rng.random((300, 200)) * 0.01
    heights[:10] = np.nan
    terrain, robot, tasks = HeightMap(heights, (412345.678, 5654321.123)), Robot.load("momaro"), random_tasks(300)
    planner = Planner(HeightMap.flat((120, 120)))
    planner.plan((1.2, 1.2, 0), (1.5, 1.2, 0))
    plan = planner.plan((1.2, 1.2, 0), (1.5, 1.2, 0))
    cause = Cause(Kind.EDGE, (1.0, 2.0), 0.2, 0.05, "front_left", (1.0, 1.9), tuple(numbers(7)))
    words = {f"a long name of a place {k}": "x" * 90 for k in range(40)}
    block = Block(*numbers(6))
    scan = {"name": "x" * 30, "place": "y" * 60, "what": "z" * 60, "sensor": "s" * 60, "licence": "l" * 60}
    scan_file = ScanFile("a" * 60, "0" * 64, pose=tuple(numbers(7)))
    abstraction = LearnedAbstraction(build_network(ModelSettings()), ModelSettings())
    folder = tmp_path_factory.mktemp("shards")
    write_shard(folder / "0.h5", tasks[:2], {"labels_hash": "x"})
    patches = CoursePatchSettings(0, 4, 40, tuple(range(4)))
    made = [
        terrain, robot, tasks, planner, plan, plan.stats, plan.refine(), abstraction, block, patches,
        planner.heuristic, cause, cost_maps(terrain, robot), terrain.conditioned(), planner.conditioning,
        AbstractHeuristic(planner.world, planner.terrain, ManualCosts(robot)), Bank(*numbers(7)),
        Arena(6.0, Scene((block,) * 90)), Scene((block,) * 90, TiltedGround(0.1, 0.2)), TiltedGround(0.1, 0.2),
        Tiles(*numbers(7), tuple(tuple(tuple(numbers(3)) for _ in range(9)) for _ in range(9))),
        Ramp(*numbers(6)), Staircase(1.0, 2.0, 0.5, 4, 0.15, 0.3, 1.2, 1.2), Tilted(*numbers(8)),
        RandomArena(6.0, 3), Scan(**scan, source="s" * 90, address="a" * 90, files=(scan_file,) * 9), scan_file,
        Collision(12, "front_left foot", "w" * 60, 0.02),
        PlanCheck([Collision(1, "p", "w" * 60, 0.1)] * 90, 0.1, 0.1, 9),
        LabelCounts.of(tasks.feasible, tasks.cost, tasks.reason),
        LabelReason(Status.INFEASIBLE, "w" * 200, (cause,) * 20),
        MapTasks(**{name: array[0] for name, array in tasks.arrays().items() if name in MapTasks._fields}),
        PatchRun(patches, CourseSettings(), Lidar(), robot, LabelSettings()), ScanFolder(tasks, words, words),
        ScannedCourse(3, random_course(1, 1), terrain, []), Shard(tasks, words), LearnedCosts(abstraction, robot=robot),
        TaskStream(folder, BatchSettings()), Findings((cause,) * 9, reached=rng.random((99, 99)) > 0.5),
        TrainResult(folder, 7, dict.fromkeys(words, 1.0), [dict.fromkeys(words, 1.0)] * 100, 1.0, 0, 9),
    ]  # fmt: skip
    return {type(each).__name__: each for each in made}


@pytest.mark.parametrize("name", [*CLASSES, "Cause", "Findings"])
def test_a_value_shows_itself_in_a_short_line(name, samples):
    if name == "ArenaDescription":
        value = CLASSES[name](6.0, 1.0, 0.1, walls=((0.0, 0.0, 1.0, 1.0),) * 90)
    else:
        value = samples[name] if name in samples else CLASSES[name]()
    text = repr(value)
    assert len(text) <= 300 and text.count("\n") <= 2
    assert "array(" not in text and " at 0x" not in text
    assert text.startswith(f"{name}(")


def test_representations_name_the_main_figures(samples):
    ground = "300 x 200 cells of 0.025 m, 7.50 x 5.00 m from (412345.68, 5654321.12), 3.33% unknown"
    assert repr(samples["HeightMap"]) == f"HeightMap({ground}, heights 0.00 to 0.01 m)"
    assert repr(HeightMap(np.full((4, 4), np.nan))).endswith("100% unknown)")
    assert "x=412345.678, y=5654321.123, yaw=0.123457" in repr(
        replace(samples["Tiles"], x=412345.678123, y=5654321.123456, yaw=0.12345678)
    )
    plan, motion, tasks = samples["Plan"], repr(samples["Motion"]), repr(samples["TaskSet"])
    expected = f"Plan(solved: {len(plan.actions)} actions, cost {plan.cost:.3f}, at most 1 times the optimum, "
    assert repr(plan).startswith(expected)
    assert motion.startswith(f"Motion(momaro: {len(plan.refine())} configurations, {len(plan.actions)} actions")
    assert tasks.startswith("TaskSet(300 maps: ") and "% of tasks feasible" in tasks
    assert repr(samples["Planner"]).startswith("Planner(momaro, heuristic geometric, HeightMap(120 x 120 cells")


def test_a_plan_that_failed_shows_its_status_without_a_search_for_reasons(samples):
    heights = np.zeros((120, 120))
    heights[60:64] = 1.0
    plan = Planner(HeightMap(heights)).plan((0.6, 1.2, 0), (2.4, 1.2, 0))
    assert repr(plan).startswith("Plan(infeasible, ") and "findings" not in plan.__dict__


def test_long_settings_show_the_values_that_are_not_their_defaults():
    assert repr(BatchSettings(size=5)) == "BatchSettings(by='map', size=5)"
    assert repr(TerrainSettings()) == "TerrainSettings()"
    assert repr(TerrainSettings(area=2.5)) == "TerrainSettings(area=2.5)"
    assert repr(PlanStatistics("grid", 1.0)) == "PlanStatistics(heuristic='grid', weight=1.0)"

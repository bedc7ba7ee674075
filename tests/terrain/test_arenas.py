"""Arena descriptions: blocks from plain values, true height maps, errors. No MuJoCo."""

import math

import numpy as np
import pytest
import yaml

from hdsp.base.errors import InputError
from hdsp.planning.planner import Planner
from hdsp.terrain.arenas import Arena, read_arena
from hdsp.terrain.obstacles import Block, Ramp, Scene, Staircase
from tests import ROOT

PAPER = ROOT / "conf/arena/paper.yaml"
ROOM = {"size": 3.0, "wall_height": 1.0, "wall_thickness": 0.1}


def test_the_height_map_has_the_analytic_heights():
    staircase = {"x": 0.5, "y": 2.0, "steps": 2, "rise": 0.2, "tread": 0.3, "width": 0.8, "depth": 0.9}
    block = {"x": 1.5, "y": 0.6, "yaw": math.pi / 4, "length": 0.4, "width": 0.4, "height": 0.15}
    ramp = {"x": 2.4, "y": 0.8, "yaw": math.pi / 2, "length": 1.0, "width": 0.5, "height": 0.25}
    values = {**ROOM, "blocks": [block], "staircases": [staircase], "ramps": [ramp], "walls": [[2.0, 2.0, 2.0, 2.95]]}
    terrain = read_arena(values).height_map()
    assert terrain.shape == (120, 120) and terrain.origin == (0.0, 0.0)
    x, y = np.meshgrid((np.arange(120) + 0.5) * 0.025, (np.arange(120) + 0.5) * 0.025, indexing="ij")
    expected = np.zeros((120, 120))
    expected[abs(x - 1.5) + abs(y - 0.6) <= 0.2 * math.sqrt(2)] = 0.15
    expected[(abs(y - 2.0) <= 0.4) & (x >= 0.5) & (x <= 1.4)] = 0.2
    expected[(abs(y - 2.0) <= 0.4) & (x >= 0.8) & (x <= 1.7)] = 0.4
    on_ramp = (abs(x - 2.4) <= 0.25) & (abs(y - 0.8) <= 0.5)
    expected[on_ramp] = 0.25 * (y[on_ramp] - 0.3)
    expected[(abs(x - 2.0) <= 0.05) & (y >= 1.95)] = 1.0
    expected[(np.minimum(x, y) < 0.1) | (np.maximum(x, y) > 2.9)] = 1.0
    np.testing.assert_allclose(terrain.heights, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"size": None}, "arena.size is None"),
        ({"size": 3.01}, "multiple of 0.025"),
        ({"wall_height": -1.0}, "arena.wall_height is -1.0"),
        ({"walls": [[0.0, 1.0, 2.0]]}, r"arena\.walls\[0\]\[3\] is missing"),
        (
            {"blocks": [{"x": 1.0, "y": 1.0, "length": 1.0, "width": 1.0}]},
            r"arena\.blocks\[0\]: key 'height' is missing",
        ),
        (
            {"blocks": [{"x": 1.0, "y": 1.0, "length": 1.0, "width": 1.0, "hight": 1.0}]},
            "unknown key 'hight'; did you mean 'height'",
        ),
        ({"ramps": [{"x": math.nan, "y": 1.0, "length": 1.0, "width": 1.0, "height": 1.0}]}, "x is nan"),
        ({"ramps": [{"x": 1.0, "y": 1.0, "length": 0.0, "width": 1.0, "height": 1.0}]}, "length is 0.0"),
    ],
)
def test_what_is_wrong_in_a_description_is_named(change, says):
    with pytest.raises(InputError, match=says):
        read_arena({**ROOM, **change})


def test_an_arena_lists_the_blocks_of_its_obstacles():
    stairs = Staircase(1.0, 1.0, 0.0, steps=3, rise=0.2, tread=0.3, width=1.0, depth=0.5)
    arena = Arena(3.0, Scene((Block(2.0, 2.0, 0.0, 0.1, 0.1, 0.3), stairs, Ramp(1.0, 2.5, 0.0, 0.5, 0.3, 0.1))))
    assert [block.height for block in arena.blocks()] == pytest.approx([0.3, 0.2, 0.4, 0.6, 0.1])


def test_the_robot_can_stand_at_start_and_goals_of_the_papers_arena():
    description = yaml.safe_load(PAPER.read_text())
    arena = read_arena(description)
    assert arena.size == 10.0
    planner = Planner(arena.height_map())
    tasks = description["tasks"]
    assert [task["name"] for task in tasks] == ["I", "II", "III", "IV", "V", "VI", "VII"]
    assert all(planner.valid(task["start"]) and planner.valid(task["goal"]) for task in tasks)
    on_top = {task["name"]: float(arena.scene.heights_at(*np.array(task["goal"][:2]))) for task in tasks}
    assert on_top["III"] > 0.5 and 0.1 < on_top["V"] <= 0.3
    assert {name: height for name, height in on_top.items() if height > 0}.keys() == {"III", "V"}

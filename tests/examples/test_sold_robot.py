"""The example with a robot that is sold produces the results on its documentation page."""

import pytest

from examples import sold_robot
from hdsp import Robot
from tests import ROOT

pytestmark = pytest.mark.xdist_group("sold robot")  # all tests here share one run of the planner


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("figures")
    return sold_robot.run(folder), sorted(path.name for path in folder.iterdir())


def test_it_climbs_a_kerb_a_ramp_and_stairs_and_its_motions_are_possible(found):
    tasks, pictures = found
    margin = Robot.load(sold_robot.ROBOT).stance.margin
    for name, steps in (("kerb", 4), ("ramp", 0), ("stairs", 16), ("flight", 32)):
        one = tasks[name]
        assert one["solved"] and one["steps"] == steps, name
        assert one["problems"] == 0 and one["least_margin"] >= margin, name
        assert f"go2w_{name}_side.png" in pictures
    assert "go2w_stairs_top.png" in pictures


def test_it_tells_why_it_climbs_no_more(found):
    steep, high = (found[0][name] for name in ("steep_ramp", "high_stairs"))
    assert steep["status"] == high["status"] == ["infeasible"]
    assert "a slope of 40.0 degrees (the robot takes 35.0)" in steep["words"][0]
    assert "foot gets nowhere" in high["words"][0]


def test_the_page_says_what_came_out(found):
    text = sold_robot.page(found[0])
    assert "| up a kerb of 0.12 m |" in text and text.count("no way | | |") == 2
    shown = (ROOT / "docs/own-robot.md").read_text()
    assert shown.count("<!-- written by examples.sold_robot: begin -->") == 1
    assert all(one["title"] in shown for one in found[0].values())

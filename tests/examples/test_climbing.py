"""The climbing example produces the results on its documentation page."""

import pytest

from examples import climbing

pytestmark = pytest.mark.xdist_group("climbing")  # all tests here share one run of the planner


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("figures")
    return climbing.run(folder), sorted(path.name for path in folder.iterdir())


def test_all_tasks_end_as_they_should(found):
    tasks, pictures = found
    assert [name for name, one in tasks.items() if not one["solved"]] == ["door_narrow"]
    for name, steps in (("stairs_over", 32), ("stairs_back", 32), ("bar", 4), ("door_wide", 0)):
        one = tasks[name]
        assert one["steps"] == steps and one["problems"] == 0 and one["least_margin"] >= 0.03, name
    assert "16 up, 16 down" in tasks["stairs_over"]["words"][0]
    assert "4 across) over up to 0.20 m" in tasks["bar"]["words"][0]
    assert {"stairs_over_top.png", "stairs_over_side.png", "stairs_back_2_side.png", "bar_side.png",
            "door_wide_top.png", "door_narrow_top.png"} <= set(pictures)  # fmt: skip


def test_no_way_through_the_narrow_door_is_proved_quickly(found):
    one = found[0]["door_narrow"]
    assert one["status"] == ["infeasible"] and one["seconds"] < 20
    assert (
        "no way" in one["words"][0] and "the body would hit the ground that rises to 1.00 m at (4.9" in one["words"][0]
    )


def test_the_page_says_what_came_out(found):
    text = climbing.page(found[0])
    assert "| over a bar of 0.2 m |" in text and "no way" in text and "*solved: drives" in text
    shown = (climbing.DOCS / "climbing.md").read_text()
    assert shown.count("<!-- written by examples.climbing: begin -->") == 1
    assert all(one["title"] in shown for one in found[0].values())

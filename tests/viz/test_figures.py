import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.detailed.actions.action import Action, ActionKind
from hdsp.labels.tasks import FIELDS, TaskSet
from hdsp.robot.lattice import robot_frame_goals
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.viz import (
    DrawnPath,
    Failure,
    Mark,
    ScanPicture,
    draw_terrain,
    planned_path_figure,
    save_arena,
    save_example_patches,
    save_map,
    save_note,
    save_pareto,
    save_planned_path,
    save_planned_paths,
    save_planning_bars,
    save_quality_bars,
    save_scan_sheet,
    save_training_curves,
)
from hdsp.viz.notebook_views import small_png
from hdsp.viz.patch_figure import JUDGEMENTS, label_figure, spread
from hdsp.viz.style import figure

MOMARO = Robot.load("momaro")
DRIVE, STEP = Action(ActionKind.DRIVE), Action(ActionKind.STEP, "front_left", 0.2)


def is_picture(path, least_side=200):
    from matplotlib.image import imread

    pixels = imread(path)[..., :3]
    return min(pixels.shape[:2]) >= least_side and pixels.std() > 0.02


def some_tasks(categories, share=0.5):
    rng = np.random.default_rng(1)
    n = len(categories)
    arrays = {name: np.zeros((n, *shape), dtype) for name, (dtype, shape) in FIELDS.items()}
    arrays["heights"][:, 50:60, 10:40] = 0.3
    arrays["heights"][:, :8, :8] = np.nan
    arrays["goals"] = np.stack([robot_frame_goals(k % 4) for k in range(n)])
    arrays["feasible"] = rng.random((n, 22)) < share
    arrays["cost"] = np.where(arrays["feasible"], 0.3, 0)
    return TaskSet(category=categories, **arrays)


def test_feet_stand_where_the_state_says():
    x, y = MOMARO.feet.neutral_x, MOMARO.feet.neutral_y
    feet = MOMARO.foot_positions([1.0, 2.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(feet, [(1 + x + 0.1, 2 + y), (1 - x, 2 + y), (1 - x, 2 - y), (1 + x, 2 - y)])
    turned = MOMARO.foot_positions([0.0, 0.0, np.pi / 2, 0.1, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(turned[0], (-y, x + 0.1), atol=1e-12)


def test_x_is_to_the_right_and_y_up():
    heights = np.zeros((40, 20), np.float32)
    heights[35:, :3] = 1.0  # large x, small y
    axes = figure(4, 4).subplots()
    image = draw_terrain(axes, HeightMap(heights, origin=(1.0, 2.0)))
    assert image.get_extent() == pytest.approx((1.0, 2.0, 2.0, 2.5))
    assert image.origin == "lower"
    pixels = image.get_array()
    assert pixels.shape == (20, 40)
    assert pixels[0, -1] == 1.0 and pixels[-1, 0] == 0.0
    assert axes.get_aspect() == 1.0


def test_axes_name_whole_projected_coordinates():
    made = figure(4, 4)
    axes = made.subplots()
    draw_terrain(axes, HeightMap.flat((80, 80), (412345.678, 5654321.123)))
    made.canvas.draw()
    for axis, first in ((axes.xaxis, "41234"), (axes.yaxis, "565432")):
        assert axis.get_offset_text().get_text() == ""
        assert {label.get_text()[: len(first)] for label in axis.get_ticklabels()} == {first}


def test_unknown_ground_has_its_own_colour():
    heights = np.zeros((4, 4), np.float32)
    heights[0, 0] = np.nan
    image = draw_terrain(figure(3, 3).subplots(), HeightMap(heights))
    colors = image.to_rgba(image.get_array())
    assert tuple(colors[0, 0]) != tuple(colors[1, 1])


def test_colours_span_the_heights_of_a_map_far_from_height_0():
    """With 0 in the range, all ground at 500 m has one colour."""
    heights = np.full((40, 20), 500.0, np.float32)
    heights[20:], heights[:5, :5] = 500.4, np.nan
    for shift in (0.0, -1000.0):
        axes = figure(3, 3).subplots()
        image = draw_terrain(axes, HeightMap(heights + shift))
        assert image.get_clim() == pytest.approx((500 + shift, 500.4 + shift), abs=1e-3)
        darker = axes.images[1].get_array()[..., 3]
        assert darker[10, 19] > 0.4 and darker[:10, :10].max() == 0  # unknown ground is no edge
    assert draw_terrain(figure(3, 3).subplots(), HeightMap(heights * np.nan)).get_clim() == (0.0, 0.1)


@pytest.mark.parametrize("level", [0.0, 500.0])
def test_patches_and_scans_are_drawn_above_their_floor(level, monkeypatch, tmp_path):
    tasks = some_tasks(["wall_1", "staircase"])
    tasks.heights[:] += level
    scan = ScanPicture("a", "b", "c", HeightMap(np.full((80, 80), level)), np.zeros((1, 3), int), tasks)
    drawn = []
    for module in ("patch_figure", "scan_figure"):
        monkeypatch.setattr(f"hdsp.viz.{module}.save", lambda made, path: drawn.append(made))
    save_example_patches(tasks, (tasks.feasible, tasks.cost), tmp_path / "a.png", 2)
    save_scan_sheet([scan], tmp_path / "b.png")
    images = [image for made in (*drawn, label_figure(tasks)) for axes in made.axes for image in axes.images]
    heights = [image for image in images if image.get_array().ndim == 2 and image.get_array().shape[0] > 60]
    assert len(heights) == 7
    for image in heights:
        (low, high), values = image.get_clim(), image.get_array().compressed()
        assert low <= values.min() and values.max() <= high + 1e-3 and high - low < 1.6


def test_a_dollar_in_a_name_is_no_formula(tmp_path):
    """Matplotlib reads text between two dollars as a formula, and refuses this one."""
    name, terrain = "map$_^$2", HeightMap.flat((80, 80))
    states = np.array([[1.0, 1.0, 0.0, 0, 0, 0, 0], [1.1, 1.0, 0.0, 0, 0, 0, 0]])
    task = {name: ((1.0, 1.0, 0.0), (1.1, 1.0, 0.0))}
    run = {"pair": name, "heuristic": name, "weight": 1.0, "status": "solved", "seconds": 0.1, "cost": 3.0}
    result = {"tasks": 220, "methods": {name: {"feasibility_accuracy": 0.95, "cost_error": 0.03}}}
    tasks, path = some_tasks([name]), tmp_path / "picture.png"
    scan = ScanPicture(name, name, name, terrain, np.zeros((1, 3), int), tasks)
    save_map(terrain, path, name)
    save_note(name, path)
    save_planned_path(terrain, states, (DRIVE,), MOMARO, path, name)
    save_planned_paths(terrain, {name: DrawnPath(states, (DRIVE,), 0.4)}, task, MOMARO, path, name)
    save_quality_bars({name: result}, path)
    save_planning_bars([run], path)
    save_pareto({name: 1.0}, {name: {name: 0.1}}, path)
    save_scan_sheet([scan], path)
    save_example_patches(tasks, (tasks.feasible, tasks.cost), path, 1)
    save_arena(None, terrain, terrain, task, path)
    small_png(label_figure(tasks))
    made = figure(2, 2)
    axes = made.subplots()
    axes.set_yscale("log")
    for _ in range(2):
        made.canvas.draw()
    assert all(label.get_parse_math() for label in axes.get_yticklabels())  # 10² is a formula


def test_training_curves(tmp_path):
    history = [
        {"epoch": epoch, "loss/cost": 0.3, "loss_weight/cost": 0.2**epoch, "cost_error/val": [None, 0.05][epoch > 0]}
        for epoch in range(4)
    ]
    assert is_picture(save_training_curves(history, tmp_path / "new" / "curves.png"))
    with pytest.raises(InputError, match="no epoch"):
        save_training_curves([], tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


def test_quality_bars_leave_out_sets_without_figures(tmp_path):
    methods = {
        "trained": {"feasibility_accuracy": 0.95, "cost_error": 0.03},
        "flat": {"feasibility_accuracy": 0.6, "cost_error": None},
    }
    sets = {"random": {"tasks": 220, "methods": methods}, "real": {"available": False, "reason": "no scans"}}
    assert is_picture(save_quality_bars(sets, tmp_path / "bars.png"))
    with pytest.raises(InputError, match="no set"):
        save_quality_bars({"real": sets["real"]}, tmp_path / "none.png")


def test_planning_bars_show_solved_and_unsolved_searches(tmp_path):
    runs = [
        {
            "pair": pair,
            "heuristic": heuristic,
            "weight": weight,
            "status": "solved",
            "seconds": 0.1 * weight,
            "cost": 3.0,
        }
        for pair in (0, 1)
        for heuristic in ("geometric", "trained")
        for weight in (1.0, 2.0)
    ]
    runs[0] |= {"status": "time_limit", "cost": None}
    assert is_picture(save_planning_bars(runs, tmp_path / "planning.png"))
    with pytest.raises(InputError, match="no runs"):
        save_planning_bars([], tmp_path / "none.png")


def test_all_paths_of_an_arena_are_drawn_and_tasks_without_one_are_named(tmp_path):
    states = np.array([[1.0, 1.0, 0.0, 0, 0, 0, 0], [1.1, 1.0, 0.0, 0, 0, 0, 0], [1.1, 1.0, 0.0, 0.2, 0, 0, 0]])
    found, none = DrawnPath(states, (DRIVE, STEP), 0.4), DrawnPath(np.empty((0, 7)), (), np.inf)
    tasks = {"I": ((1.0, 1.0, 0.0), (1.1, 1.0, 0.0)), "II": ((1.0, 1.0, 0.0), (1.8, 1.5, 1.0))}
    terrain = HeightMap.flat((80, 80))
    picture = save_planned_paths(terrain, {"I": found, "II": none}, tasks, MOMARO, tmp_path / "paths.png", "trained")
    assert is_picture(picture)
    with pytest.raises(InputError, match="no task"):
        save_planned_paths(terrain, {}, {}, MOMARO, tmp_path / "none.png")


@pytest.mark.parametrize("count", [1, 3])
def test_example_patches(tmp_path, count):
    tasks = some_tasks(["wall_1", "staircase", "cuboid_1"])
    judged = ~tasks.feasible, np.full(tasks.cost.shape, 0.4)
    assert is_picture(save_example_patches(tasks, judged, tmp_path / "examples.png", count))


def test_examples_are_spread_over_categories_and_show_mixed_tasks():
    tasks = some_tasks(["a"] * 3 + ["b"] * 3 + ["c"] * 3)
    tasks.feasible[[0, 3, 4]] = True
    assert spread(tasks, 3).tolist() == [1, 5, 6]
    assert spread(tasks, 2).tolist() == [1, 6]
    assert spread(tasks, 100).tolist() == list(range(9))
    assert len({color for color, _ in JUDGEMENTS.values()}) == 4


def test_a_planned_path_with_steps(tmp_path):
    terrain = HeightMap.flat((80, 60))
    states = np.zeros((12, 7))
    states[:, 0] = np.linspace(0.4, 1.5, 12)
    states[:, 1] = 0.7
    states[6:, 3] = 0.2
    actions = [DRIVE] * 5 + [STEP] + [DRIVE] * 5
    assert is_picture(save_planned_path(terrain, states, actions, MOMARO, tmp_path / "path.png", "a step"))


def test_without_a_path_start_and_goal_are_drawn(tmp_path):
    terrain, plan = HeightMap.flat((80, 60)), (np.empty((0, 7)), ())
    picture = tmp_path / "none.png"
    with pytest.raises(InputError, match="start"):
        save_planned_path(terrain, *plan, MOMARO, picture)
    assert is_picture(save_planned_path(terrain, *plan, MOMARO, picture, start=(0.5, 0.5, 0.0), goal=(1.5, 1.0, 1.0)))


def test_q2_the_picture_of_a_failure_shows_the_area_in_reach_and_names_each_cause():
    terrain, place = HeightMap.flat((80, 60)), (1.2, 0.7)
    reached = np.zeros((80, 60), bool)
    reached[10:30, 20:40] = True
    marks = [Mark(place, "unknown ground", (1.0, 0.7, 0.0, 0, 0, 0, 0)), Mark((1.5, 0.7), "an edge of 9 cm")]
    failure = Failure(marks, reached, (0.7, 0.7, 0.0, 0, 0, 0, 0), 0.9)
    made = planned_path_figure(
        terrain, np.empty((0, 7)), (), MOMARO, start=(0.5, 0.7, 0.0), goal=(1.6, 0.7, 0.0), failure=failure
    )
    axes = made.axes[0]
    _, labels = axes.get_legend_handles_labels()
    assert "1  unknown ground at (1.20, 0.70) m" in labels and "2  an edge of 9 cm at (1.50, 0.70) m" in labels
    assert "nearest pose reached, 0.90 m from the goal" in labels and "base positions in reach" in labels
    assert {"1", "2"} <= {text.get_text() for text in axes.texts}
    drawn = [image.get_array() for image in axes.images if np.ndim(image.get_array()) == 3]
    assert any((np.asarray(colours)[..., 3] > 0).T.tolist() == reached.tolist() for colours in drawn)
    assert any(tuple(line.get_xydata()[0]) == place for line in axes.lines if len(line.get_xydata()) == 1)

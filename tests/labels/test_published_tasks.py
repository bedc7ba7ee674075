import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.base.errors import InputError
from hdsp.labels import published_tasks as published
from hdsp.labels.published_tasks import find_published, read_published, write_published
from hdsp.labels.shards import read_tasks, write_shard
from hdsp.labels.tasks import REASON_UNKNOWN, TaskSet
from hdsp.robot.lattice import ABSTRACT_ACTIONS
from tests.labels.task_sets import random_tasks


def published_tasks(maps, seed=0):
    """Random tasks without unknown cells, as in a simulated height map."""
    tasks = random_tasks(maps, seed)
    return TaskSet(**{**tasks.arrays(), "heights": np.nan_to_num(tasks.heights)})


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 3), st.integers(0, 100))
def test_what_is_written_is_read_to_six_digits(tmp_path_factory, maps, seed):
    tasks = published_tasks(maps, seed)
    read = read_published(write_published(tmp_path_factory.mktemp("text") / "tasks.txt", tasks))
    np.testing.assert_allclose(read.heights, tasks.heights, atol=1e-6)
    np.testing.assert_allclose(read.cost, tasks.cost, atol=1e-6)
    for name in ("goals", "feasible", "index"):
        np.testing.assert_array_equal(read.arrays()[name], tasks.arrays()[name])
    np.testing.assert_allclose(read.goal, tasks.goal, atol=1e-6)


def test_heights_are_written_with_x_as_the_slow_axis(tmp_path):
    tasks = published_tasks(1)
    line = write_published(tmp_path / "tasks.txt", tasks).read_text().splitlines()[5]
    assert float(line.split()[3 * 72 + 5]) == pytest.approx(tasks.heights[0, 3, 5], abs=1e-6)


def test_infeasible_tasks_have_cost_0_and_an_unknown_reason(tmp_path):
    read = read_published(write_published(tmp_path / "tasks.txt", published_tasks(4)))
    assert (read.cost[~read.feasible] == 0).all()
    assert set(read.reason[~read.feasible]) == {REASON_UNKNOWN}
    assert set(read.category) == {"published"}


@pytest.fixture
def text(tmp_path):
    return write_published(tmp_path / "good.txt", published_tasks(2)).read_text()


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda text: text[: len(text) // 3], "numbers; need 5184: heights of map 0"),
        (lambda text: text[: text.rindex("\n", 0, -1)], "ends after line .* where x y yaw cost of goal 21 of map 1"),
        (lambda text: text + "\n2\n", "more lines than the stated number"),
        (lambda text: text.replace("inf", "much", 1), "could not convert"),
        (lambda text: text.replace("inf", "-1.0", 1), "below 0"),
        (
            lambda text: text.replace("0.200000 0.100000", "0.200000 0.300000", 1),
            "goal 9 of map 0 .* is not the action",
        ),
        (lambda text: "height maps\n", "no line 'Num maps:'"),
        (lambda text: text.replace("Num maps:\n2", "Num maps:\nnan"), "number of maps"),
        (lambda text: text + "é", "cannot be read"),
    ],
)
def test_damaged_files_are_refused_with_the_place(tmp_path, text, damage, words):
    path = tmp_path / "bad.txt"
    path.write_text(damage(text), encoding="utf-8")
    with pytest.raises(InputError, match=words) as error:
        read_published(path)
    assert "bad.txt" in str(error.value)
    assert "\n" not in str(error.value)


def test_goals_at_other_headings_cannot_be_written(tmp_path):
    tasks = published_tasks(1)
    with pytest.raises(InputError, match="goals equal to the abstract actions"):
        write_published(tmp_path / "x.txt", TaskSet(**{**tasks.arrays(), "goals": tasks.goals + 0.5}))


def test_shards_go_to_text_and_back(tmp_path, capsys):
    """Uses the command line, from a shard folder and to a store."""
    write_shard(tmp_path / "labels/00000-a.h5", published_tasks(2, 1), {"labels_hash": "a"})
    write_shard(tmp_path / "labels/00001-a.h5", published_tasks(3, 2), {"labels_hash": "a"})
    published.main(["export", str(tmp_path / "labels"), str(tmp_path / "tasks.txt")])
    published.main(["import", str(tmp_path / "tasks.txt"), "memory://published/back.h5"])
    assert capsys.readouterr().out.count("5 maps, 110 tasks") == 2
    before, after = read_tasks(tmp_path / "labels"), read_tasks("memory://published")
    for name in ("heights", "goals", "feasible", "cost", "index", "goal"):
        np.testing.assert_allclose(after.arrays()[name], before.arrays()[name], atol=1e-6, err_msg=name)
    with pytest.raises(SystemExit, match=r"error: shard .*none\.h5: no such file"):
        published.main(["export", str(tmp_path / "none.h5"), str(tmp_path / "x.txt")])


def test_the_file_is_found_in_the_named_folder_then_in_the_environment(tmp_path, monkeypatch):
    monkeypatch.setattr(published, "_fetch", lambda timeout: pytest.fail("fetched though the file is there"))
    for name in ("one", "two"):
        (tmp_path / name / "published").mkdir(parents=True)
        (tmp_path / name / published.PLACES[1]).touch()
    monkeypatch.setenv(published.DATA_DIR_VARIABLE, str(tmp_path / "two"))
    assert find_published(tmp_path / "one") == (tmp_path / "one" / published.PLACES[1], "")
    assert find_published() == (tmp_path / "two" / published.PLACES[1], "")
    (tmp_path / "two" / published.PLACES[0]).touch()
    assert find_published()[0] == tmp_path / "two" / published.PLACES[0]


def test_where_it_cannot_be_had_the_reason_says_how_to_get_it(tmp_path, monkeypatch):
    def no_network(timeout):
        raise OSError("network\nis unreachable")

    monkeypatch.setattr(published, "_fetch", no_network)
    path, reason = find_published(tmp_path)
    assert path is None
    assert published.URL in reason and published.DATA_DIR_VARIABLE in reason and str(tmp_path) in reason
    assert "\n" not in reason


def test_the_authors_file_is_what_the_facts_say():
    path, reason = find_published(timeout=5)
    if path is None:
        pytest.skip(reason)
    tasks = read_published(path)
    assert len(tasks) in (39, 77)
    flat = tasks[tasks.index == 22]
    assert (flat.heights == 0).all() and flat.feasible.all()
    np.testing.assert_allclose(flat.cost[0, [0, 2, 4]], [0.1, 0.3, 0.25], atol=1e-6)
    np.testing.assert_array_equal(tasks.goals[0], ABSTRACT_ACTIONS)
    # Map 0 has a wall behind, map 64 a wall to the left. Costs rise only in this direction, so the axes are correct.
    behind, left = tasks[tasks.index == 0], tasks[tasks.index == 64]
    assert behind.heights[0, :20].max() > 1 and behind.heights[0, 20:].max() == 0
    assert behind.feasible[0, 0] and not behind.feasible[0, 4]
    assert left.heights[0, 20:52, :36].max() == 0 and left.heights[0, 20:52, 36:].max() > 0
    assert left.cost[0, 2] > left.cost[0, 6] == pytest.approx(0.3)

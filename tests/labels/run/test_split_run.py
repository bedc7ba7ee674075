import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from hdsp.abstract.transform import feet_at
from hdsp.base.errors import InputError
from hdsp.base.storage import open_folder
from hdsp.detailed.search.outcome import Status
from hdsp.detailed.world.world import build_world
from hdsp.labels.counts import LabelCounts, split_summary
from hdsp.labels.rules import LabelSettings
from hdsp.labels.run.set_listing import stored_sets
from hdsp.labels.run.split_run import ClusterSettings, LabelRun, SplitSettings, label_split
from hdsp.labels.shard_index import complete_indices, read_index
from hdsp.labels.shards import read_shard, read_tasks, shard_paths, write_shard
from hdsp.robot.lattice import robot_frame_goals
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import CATEGORIES, TerrainSettings, random_map
from tests import ROOT
from tests.labels.task_sets import (
    assert_same_tasks,
    failing_label,
    fake_label,
    modules_label,
    random_tasks,
    slow_fake_label,  # noqa: F401 - the scripts of the killed runs take it from here
)

linux = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes through /proc")
ROBOT = Robot.load("momaro")
HASH = {"labels_hash": "0"}
SPLIT = SplitSettings(seed=1, maps_per_category=4, heading_residues=(0, 1), maps_per_shard=8)  # 36 maps, 5 shards


@dataclass(frozen=True)
class FakeSettings:
    """Settings for the fake label functions."""

    folder: str = ""


def label(folder, split=SPLIT, workers=1, function=fake_label, settings=None, verify=False):
    """Calls `label_split` with defaults for arguments that do not matter."""
    run = LabelRun(split, ROBOT, TerrainSettings(), settings or FakeSettings())
    cluster = ClusterSettings(workers, dashboard=None)
    return label_split(run, folder, cluster, progress=False, label=function, verify=verify).summary


def finished(folder):
    """All shards below a folder, also of unfinished label sets."""
    return sorted(path for path in Path(folder).rglob("*.h5") if not path.name.startswith("."))


def index_of(folder):
    """The only complete index below a folder."""
    (place,) = complete_indices(folder)
    return place


def contents(folder, paths=None):
    """Bytes of every dataset in every shard, and the attributes.

    The files themselves are not compared, because LZF may compress equal bytes differently.
    """
    found = {}
    for path in finished(folder) if paths is None else paths:
        shard = read_shard(path)
        found[path.name] = {**{name: a.tobytes() for name, a in shard.tasks.arrays().items()}, **shard.attributes}
    return found


def test_all_maps_of_a_split_are_labelled_and_described(tmp_path):
    label(tmp_path)
    tasks = read_tasks(tmp_path)
    assert len(shard_paths(tmp_path)) == 5
    for row in range(len(tasks)):
        category, index, heading = tasks.category[row], int(tasks.index[row]), int(tasks.heading[row])
        assert heading == 4 * (index % 2)
        cells = 72 if heading == 0 else 104
        terrain = random_map(1, category, index, cells=cells, heading=heading)
        expected = fake_label(terrain, ROBOT, None, heading)
        np.testing.assert_array_equal(tasks.heights[row], expected.heights)
        np.testing.assert_allclose(tasks.cost[row], expected.cost, rtol=1e-6)
    kept = {(category, index) for category, index in zip(tasks.category.tolist(), tasks.index.tolist(), strict=True)}
    run = LabelRun(SPLIT, ROBOT, TerrainSettings(), FakeSettings())
    for number in range(SPLIT.maps):
        category, index, heading = run.map_of(number)
        dropped = fake_label(run.terrain_of(number), ROBOT, None, heading) is None
        assert ((category, index) in kept) != dropped


def test_the_summary_counts_what_was_kept_and_dropped(tmp_path):
    found = label(tmp_path)
    tasks = read_tasks(tmp_path)
    assert found["maps"] == len(tasks) and found["maps"] + found["maps_dropped"] == 36
    assert found["tasks"] == len(tasks) * 22
    assert set(found["maps_per_category"]) == set(CATEGORIES)
    for category in CATEGORIES:
        assert found["maps_per_category"][category] + found["maps_dropped_per_category"][category] == 4
    cost = tasks.cost[tasks.feasible].astype(float)
    assert found["feasible_share"] == pytest.approx(tasks.feasible.mean())
    assert (found["cost_mean"], found["cost_std"]) == (pytest.approx(cost.mean()), pytest.approx(cost.std()))
    assert found["share_per_reason"] == pytest.approx(
        {"solved": tasks.feasible.mean(), "infeasible": 1 - tasks.feasible.mean()}
    )
    assert split_summary({"cuboid_1": LabelCounts()}, 2)["feasible_share"] is None


def test_several_workers_give_the_same_datasets_as_one(tmp_path):
    one = label(tmp_path / "one")
    assert label(tmp_path / "two", workers=2) == one
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def test_a_second_run_labels_nothing(tmp_path):
    first = label(tmp_path)
    before = contents(tmp_path)
    assert label(tmp_path, function=failing_label) == first
    assert contents(tmp_path) == before


def test_more_maps_keep_the_full_shards_that_are_there(tmp_path):
    label(tmp_path / "grown")
    short = index_of(tmp_path / "grown")
    times = {path.name: path.stat().st_mtime_ns for path in shard_paths(short)}
    before = read_tasks(short)
    label(tmp_path / "grown", replace(SPLIT, maps_per_category=6))
    kept = [path for path in shard_paths(tmp_path / "grown") if path.stat().st_mtime_ns == times.get(path.name)]
    assert len(kept) == 4, "all but the last, which was not full"
    label(tmp_path / "fresh", replace(SPLIT, maps_per_category=6))
    assert contents(tmp_path / "fresh").items() <= contents(tmp_path / "grown").items()
    assert_same_tasks(read_tasks(tmp_path / "grown"), read_tasks(tmp_path / "fresh"))
    assert_same_tasks(read_tasks(short), before)
    assert label(tmp_path / "grown", function=failing_label)["maps"] == len(before)


def test_damaged_shards_are_named_and_made_again_and_foreign_files_stay(tmp_path, capsys):
    folder = tmp_path / "labels"
    label(folder)
    good, tasks = contents(folder), read_tasks(folder)
    first, second, third, *_ = shard_paths(folder)
    first.write_bytes(first.read_bytes()[:-10])
    content = bytearray(second.read_bytes())
    content[3000] ^= 1
    second.write_bytes(content)
    write_shard(third, random_tasks(3), {"labels_hash": "of other settings", "maps": 8})
    mine = write_shard(first.with_name("mine.h5"), random_tasks(2), HASH)
    foreign = {"foreign.h5": b"another's work", "000000900-8.h5": b"", ".0.77-ff.tmp.h5": b"half"}
    for name, content in foreign.items():
        first.with_name(name).write_bytes(content)
    foreign["mine.h5"] = mine.read_bytes()
    label(folder)
    assert contents(folder, shard_paths(folder)) == good
    assert_same_tasks(read_tasks(folder), tasks)
    assert {name: first.with_name(name).read_bytes() for name in foreign} == foreign
    said = capsys.readouterr().err
    assert all(path.name in said for path in (first, second, third))
    assert "damaged" in said and "other settings" in said


def test_damage_that_left_the_time_of_a_file_is_found_on_request(tmp_path, capsys):
    label(tmp_path)
    good, damaged = contents(tmp_path), shard_paths(tmp_path)[1]
    times, content = damaged.stat(), bytearray(damaged.read_bytes())
    content[3000] ^= 1
    damaged.write_bytes(content)
    os.utime(damaged, ns=(times.st_atime_ns, times.st_mtime_ns))
    label(tmp_path, function=failing_label)
    with pytest.raises(InputError, match="damaged"):
        read_tasks(tmp_path)
    label(tmp_path, verify=True)
    assert damaged.name in capsys.readouterr().err and contents(tmp_path) == good


@pytest.mark.parametrize(
    "change",
    [
        {"split": replace(SPLIT, seed=2)},
        {"split": replace(SPLIT, heading_residues=(0,))},
        {"robot": Robot.load({**ROBOT.to_dict(), "turn": {"cost": 0.5, "unevenness_cost": 0.1}})},
        {"terrain": TerrainSettings(area=1.0)},
        {"settings": FakeSettings("other")},
    ],
    ids=lambda change: next(iter(change)),
)
def test_the_hash_covers_all_that_labels_depend_on(change):
    run = LabelRun(SPLIT, ROBOT, TerrainSettings(), FakeSettings())
    assert replace(run, **change).inputs() != run.inputs()


def test_labels_of_other_settings_stay_beside_these(tmp_path, capsys):
    other = replace(SPLIT, seed=9)
    label(tmp_path)
    mine = index_of(tmp_path)
    before = read_tasks(mine)
    label(tmp_path, other)
    with pytest.raises(InputError, match=r"holds several label sets; name one: .*36-maps, .*36-maps"):
        read_tasks(tmp_path)
    indices = {read_index(place).labels_hash: read_tasks(place) for place in complete_indices(tmp_path)}
    assert [set(tasks.seed) for tasks in indices.values()] in ([{1}, {9}], [{9}, {1}])
    assert_same_tasks(read_tasks(mine), before)
    for split in (SPLIT, other, SPLIT):
        label(tmp_path, split, function=failing_label)
    assert not capsys.readouterr().err
    for place in complete_indices(tmp_path):
        index = read_index(place)
        assert {read_shard(path).attributes["labels_hash"] for path in index.places} == {index.labels_hash}


def test_two_settings_in_one_store_of_objects_lose_nothing():
    place, other = "memory://side/by/side", replace(SPLIT, seed=9)
    label(place)
    label(place, other)
    found = [read_tasks(index) for index in complete_indices(place)]
    for split in (SPLIT, other):
        label(place, split, function=failing_label)
    for before, index in zip(found, complete_indices(place), strict=True):
        assert_same_tasks(read_tasks(index), before)
    first, second = stored_sets(place)
    assert first.differs_in(second.inputs) == ["split.seed"] and first.maps == (36,) and first.shards == 5
    open_folder(first.place).write("36-maps/index.json", b"{")
    damaged, _ = stored_sets(place)
    assert damaged.maps == (36,) and damaged.shards == 5 and not damaged.differs_in(second.inputs)
    damaged.remove()
    assert [stored.place for stored in stored_sets(place)] == [second.place]
    assert len(read_tasks(place)) in map(len, found)


@linux
def test_a_run_killed_in_the_middle_leaves_whole_shards_and_is_continued(tmp_path):
    split = replace(SPLIT, maps_per_category=8)
    label(tmp_path / "undisturbed", split)
    folder = tmp_path / "killed"
    script = (
        "from tests.labels.run.test_split_run import *; from pathlib import Path; "
        f"label(Path({str(folder)!r}), replace(SPLIT, maps_per_category=8), 2, slow_fake_label)"
    )
    run = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT)
    deadline = time.time() + 60
    while len(finished(folder)) < 2 and time.time() < deadline:
        time.sleep(0.02)
    workers = children(run.pid)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    done = finished(folder)
    assert 2 <= len(done) < 9, "killed in the middle"
    kept = {path.name: (path.stat().st_mtime_ns, len(read_shard(path).tasks)) for path in done}
    assert workers and wait_for(lambda: not any(alive(pid) for pid in workers)), "workers end with their parent"
    label(folder, split)
    assert contents(folder) == contents(tmp_path / "undisturbed")
    times = {path.name: path.stat().st_mtime_ns for path in finished(folder)}
    assert all(times[name] == time_ns for name, (time_ns, _) in kept.items())


@linux
def test_an_interrupt_ends_a_run_and_its_workers(tmp_path):
    # A shell starts background processes with interrupts ignored, and child processes inherit this.
    script = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from tests.labels.run.test_split_run import *; from pathlib import Path; "
        f"label(Path({str(tmp_path)!r}), replace(SPLIT, maps_per_category=120), 2, slow_fake_label)"
    )
    run = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT, start_new_session=True, stderr=subprocess.PIPE)
    assert wait_for(lambda: finished(tmp_path))
    workers = children(run.pid)
    os.killpg(run.pid, signal.SIGINT)  # like Ctrl-C: all processes receive it
    _, said = run.communicate(timeout=20)
    assert run.returncode != 0
    assert b"KeyboardInterrupt" in said and b"Process Spawn" not in said, "one process reports, not all"
    assert wait_for(lambda: not any(alive(pid) for pid in workers))
    assert all(read_shard(path) for path in finished(tmp_path))
    assert len(finished(tmp_path)) == sum(path.is_file() for path in tmp_path.rglob("*"))
    with pytest.raises(InputError, match="holds no shard"):
        read_tasks(tmp_path)  # unfinished labels are no split


def test_a_worker_imports_neither_torch_nor_mlflow(tmp_path):
    (tmp_path / "modules").mkdir()
    label(tmp_path / "labels", workers=2, function=modules_label, settings=FakeSettings(str(tmp_path / "modules")))
    imported = [set(path.read_text().split()) for path in (tmp_path / "modules").iterdir()]
    assert len(imported) == 2
    for modules in imported:
        assert "hdsp.terrain.scenes" in modules
        assert not modules & {"torch", "mlflow", "lightning", "matplotlib", "h5py.tests"}


def test_a_fault_in_the_search_names_the_map(tmp_path):
    for workers in (1, 2):
        with pytest.raises(RuntimeError, match="seed 1, category cuboid_1, index 0, heading 0: a fault in the search"):
            label(tmp_path, workers=workers, function=failing_label)


def test_a_place_that_cannot_be_written_to_is_named_before_work_begins(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"cannot write to .*file/labels"):
        label(tmp_path / "file" / "labels", function=failing_label)


def test_a_full_disk_keeps_finished_shards(tmp_path):
    label(tmp_path / "all")
    sizes = [path.stat().st_size for path in shard_paths(tmp_path / "all")]
    assert max(sizes) > sizes[0], "the limit lets the first shard through, and stops a later one"
    script = (
        "import resource, signal; from tests.labels.run.test_split_run import *; from pathlib import Path\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({sizes[0]}, resource.RLIM_INFINITY))\n"
        f"try: label(Path({str(tmp_path / 'full')!r}))\n"
        "except InputError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert "cannot write" in done.stdout and "File too large" in done.stdout, done.stderr
    assert done.stdout.count("\n") == 1
    kept = contents(tmp_path / "full")
    assert 0 < len(kept) < 5
    assert kept.items() <= contents(tmp_path / "all").items()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"seed": -1}, "seed is -1"),
        ({"maps_per_category": 0}, "maps_per_category is 0"),
        ({"maps_per_shard": 2.5}, "maps_per_shard is 2.5"),
        ({"heading_residues": (16,)}, r"heading_residues\[0\] is 16; need less than 16"),
        ({"heading_residues": ()}, "heading_residues"),
        (
            {"categories": ("cuboid1",)},
            r"categories\[0\] is 'cuboid1'; need one of cuboid_1, .*; did you mean 'cuboid_1'",
        ),
    ],
)
def test_wrong_splits_are_refused_by_name(values, words):
    with pytest.raises(InputError, match=words):
        SplitSettings(**{"seed": 1, "maps_per_category": 1, **values})
    with pytest.raises(InputError, match="workers is 0"):
        ClusterSettings(workers=0)
    with pytest.raises(InputError, match=r"scheduler is 'cluster'; need null .*, slurm, or an address"):
        ClusterSettings(scheduler="cluster")
    with pytest.raises(InputError, match="memory is 'much'; need a number of bytes, such as 2GB"):
        ClusterSettings(memory="much")
    with pytest.raises(InputError, match=r"slurm\.jobs is 'four'; need a whole number"):
        ClusterSettings(slurm={"jobs": "four"})


def test_the_bar_shows_speed_and_the_infeasible_share(tmp_path, capsys):
    run = LabelRun(SPLIT, ROBOT, TerrainSettings(), FakeSettings())
    label_split(run, tmp_path, ClusterSettings(workers=1), label=fake_label)
    shown = capsys.readouterr().err
    assert "task/s" in shown and "% infeasible;" in shown and "maps dropped" in shown and "792/792" in shown


def children(pid: int) -> list[int]:
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        found += [int(child) for child in (task / "children").read_text().split()]
    return found


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def wait_for(condition, seconds: float = 30) -> bool:
    deadline = time.time() + seconds
    while time.time() < deadline:
        if condition():
            return True
        time.sleep(0.05)
    return False


def test_maps_where_the_robot_cannot_stand_are_what_the_others_drop(tmp_path):
    split = SplitSettings(seed=31, maps_per_category=2, heading_residues=(0, 1))
    settings = LabelSettings(cost_limit_factor=0.01)
    kept = {}
    for standable in (True, False):
        run = LabelRun(replace(split, standable=standable), ROBOT, TerrainSettings(), settings)
        folder = tmp_path / str(standable)
        label_split(run, folder, ClusterSettings(1, dashboard=None), progress=False)
        kept[standable] = read_tasks(folder)
    numbers = {key: set(zip(tasks.category, tasks.index, strict=True)) for key, tasks in kept.items()}
    assert not numbers[True] & numbers[False]
    assert len(numbers[True]) + len(numbers[False]) == split.maps
    blocked = kept[False]
    assert len(blocked) and not blocked.feasible.any()
    assert (blocked.reason == Status.INVALID_START).all()
    assert set(blocked.heading) == {0, 4}
    for tasks in kept.values():
        for heading in set(tasks.heading):
            of_it = tasks.heading == heading
            np.testing.assert_array_equal(
                tasks.goals[of_it], np.broadcast_to(robot_frame_goals(heading // 4), (of_it.sum(), 22, 3))
            )
    for heights, start, goal in zip(blocked.heights, blocked.start, blocked.goal, strict=True):
        world = build_world(HeightMap(heights), ROBOT)
        assert feet_at(world, (36, 36, 0)) is None, "the patch shows it, whatever the heading of the start"
        np.testing.assert_array_equal(goal, np.broadcast_to(start, goal.shape))


def test_maps_where_the_robot_cannot_stand_have_shards_of_their_own():
    run = LabelRun(SPLIT, ROBOT, TerrainSettings(), LabelSettings())
    assert replace(run, split=replace(SPLIT, standable=False)).labels_hash != run.labels_hash
    with pytest.raises(InputError, match="standable is 'no'"):
        replace(SPLIT, standable="no")

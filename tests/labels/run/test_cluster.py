"""Label runs on many processes, with killed processes among them."""

import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import psutil
import pytest

from hdsp.base.errors import InputError
from hdsp.base.workers import connected
from hdsp.labels.rules import LabelSettings
from hdsp.labels.run.split_run import ClusterSettings, LabelRun, SplitSettings, label_split
from hdsp.labels.shards import read_tasks
from hdsp.terrain.scenes import TerrainSettings
from tests.labels.run.test_split_run import ROBOT, ROOT, SPLIT, FakeSettings, contents, finished, label, wait_for
from tests.labels.task_sets import (
    assert_same_tasks,
    fake_label,
    slow_fake_label,  # noqa: F401 - the scripts of the killed runs take it from here
    suicidal_label,
    unlucky_label,
)

pytestmark = [
    pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes through /proc"),
    pytest.mark.xdist_group("dask"),
]
KILLS = 20
LONG = SplitSettings(seed=1, maps_per_category=60, maps_per_shard=20)  # 540 maps, 16 s of slow labels


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """Address of a scheduler with two workers, all started by hand."""
    file = tmp_path_factory.mktemp("dask") / "scheduler.json"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}

    def start(*arguments: str) -> subprocess.Popen:
        command = [sys.executable, "-m", "dask", *arguments, "--scheduler-file", str(file), "--no-dashboard"]
        return subprocess.Popen(command, env=environment, cwd=file.parent, stderr=subprocess.DEVNULL)

    started = [start("scheduler", "--host", "127.0.0.1", "--port", "0")]
    started += [start("worker", "--nthreads", "1", "--host", "127.0.0.1") for _ in range(2)]
    try:
        assert wait_for(file.exists)
        from distributed import Client

        with Client(scheduler_file=str(file)) as client:
            client.wait_for_workers(2, timeout=60)
            yield client.scheduler.address
    finally:
        for process in started:
            kill_with_children(process.pid)
            process.wait()


def on(address: str, folder, split=SPLIT, function=fake_label, settings=None) -> dict:
    run = LabelRun(split, ROBOT, TerrainSettings(), settings or FakeSettings())
    return label_split(run, folder, ClusterSettings(scheduler=address), progress=False, label=function).summary


def test_workers_started_by_hand_give_what_one_process_gives(scheduler, tmp_path):
    split = SplitSettings(seed=5, maps_per_category=3, categories=("cuboid_1", "staircase"), maps_per_shard=3)
    settings = LabelSettings(max_expansions=2000)
    run = LabelRun(split, ROBOT, TerrainSettings(), settings)
    here = label_split(run, tmp_path / "here", ClusterSettings(workers=1), progress=False)
    there = label_split(run, tmp_path / "there", ClusterSettings(scheduler=scheduler), progress=False)
    assert here.summary == there.summary and there.summary["maps"] > 0
    assert contents(tmp_path / "here") == contents(tmp_path / "there")
    assert there.record["workers"] == 2 and there.record["tasks"] == 6 * 22
    assert 50e6 < there.record["peak_memory"] < 1.5e9


def test_a_worker_that_dies_for_good_leaves_its_work_to_the_others(scheduler, tmp_path):
    """Runs late, because afterwards the scheduler has only one worker."""
    label(tmp_path / "here")
    worker = next(p for p in psutil.process_iter(["cmdline"]) if is_worker_of(p, scheduler))
    run = subprocess.Popen(
        [sys.executable, "-c", f"from tests.labels.run.test_cluster import *; {call(tmp_path / 'there', scheduler)}"],
        cwd=ROOT,
    )
    assert wait_for(lambda: finished(tmp_path / "there"))
    kill_with_children(worker.pid)
    assert run.wait(60) == 0
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


def test_a_scheduler_that_dies_ends_the_run_with_what_is_finished(tmp_path):
    file = tmp_path / "scheduler.json"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "dask", "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    dask = subprocess.Popen(
        [*command, "--scheduler-file", str(file)], env=environment, cwd=tmp_path, stderr=subprocess.DEVNULL
    )
    worker = None
    try:
        assert wait_for(file.exists)
        address = json.loads(file.read_text())["address"]
        command = [sys.executable, "-m", "dask", "worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
        worker = subprocess.Popen(command, env=environment, cwd=tmp_path, stderr=subprocess.DEVNULL)
        script = (
            "from tests.labels.run.test_cluster import *\n"
            f"try: {call(tmp_path / 'labels', address)}\n"
            "except InputError as error: print(error)"
        )
        run = subprocess.Popen(
            [sys.executable, "-c", script], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert wait_for(lambda: finished(tmp_path / "labels"))
        kill_with_children(dask.pid)
        said, errors = run.communicate(timeout=60)
        assert "the Dask scheduler is gone; finished shards stay" in said, errors
        assert contents(tmp_path / "labels")
    finally:
        for process in (dask, worker):
            if process is not None:
                kill_with_children(process.pid)
                process.wait()


def test_no_answer_at_an_address_is_said(tmp_path):
    with pytest.raises(InputError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        on("tcp://127.0.0.1:9", tmp_path)


@pytest.mark.nightly
def test_twenty_kills_of_workers_and_of_the_whole_run_lose_nothing(tmp_path):
    label(tmp_path / "undisturbed", LONG)
    folder, chance = tmp_path / "killed", random.Random(0)
    script = (
        "from tests.labels.run.test_cluster import *; from pathlib import Path; "
        f"label(Path({str(folder)!r}), LONG, 2, slow_fake_label)"
    )
    run, kills, stages, log = None, 0, 0, (tmp_path / "log").open("w")
    try:
        while kills < KILLS:
            if run is None:
                run = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT, stderr=log)
            assert wait_for(lambda run=run: workers_of(run.pid) or run.poll() is not None)
            assert run.poll() is None, f"the run ended with {run.returncode} after {kills} kills; it has to be longer"
            time.sleep(chance.uniform(0, 1.0))
            if chance.random() < 0.2:
                run.kill()
                run.wait()
                run, stages = None, stages + 1
            else:
                chosen = chance.choice(workers_of(run.pid) or [None])
                if chosen is None:
                    continue
                chosen.kill()
            kills += 1
        assert 0 < stages < kills
        assert contents_so_far(folder).items() <= contents(tmp_path / "undisturbed").items()
        if run is None:
            run = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT)
        assert run.wait(120) == 0
    finally:
        if run is not None:
            run.kill()
    assert contents(folder) == contents(tmp_path / "undisturbed")


@pytest.mark.nightly
def test_a_map_that_ends_its_workers_is_named(tmp_path):
    with pytest.raises(InputError, match=r"seed 1, category cuboid_1, index 0, heading 0; .*fewer workers"):
        label(tmp_path, workers=2, function=suicidal_label)


def test_maps_that_lost_several_workers_by_bad_luck_are_labelled_all_the_same(tmp_path, capsys):
    (tmp_path / "deaths").mkdir()
    label(tmp_path / "labels", workers=2, function=unlucky_label, settings=FakeSettings(str(tmp_path / "deaths")))
    label(tmp_path / "undisturbed")
    assert_same_tasks(read_tasks(tmp_path / "labels"), read_tasks(tmp_path / "undisturbed"))
    assert "have lost several workers; labelling them one by one" in capsys.readouterr().err


def test_workers_that_are_slow_to_end_do_not_undo_what_is_done(monkeypatch):
    from distributed import LocalCluster

    close = LocalCluster.close

    def slow(cluster, *arguments, **options):
        close(cluster, *arguments, **options)
        raise TimeoutError

    with connected(ClusterSettings(workers=1, dashboard=None), jobs=1) as client:
        monkeypatch.setattr(LocalCluster, "close", slow)
        assert client.submit(sum, [1, 2]).result() == 3


def test_a_store_of_one_process_takes_no_labels_of_others(tmp_path):
    place = "memory://labels/shared"
    with pytest.raises(InputError, match="seen by one process alone"):
        label(place, workers=2)
    label(place)
    label(tmp_path)
    assert_same_tasks(read_tasks(place), read_tasks(tmp_path))


def test_slurm_jobs_are_asked_for_with_the_given_options(monkeypatch):
    asked = {}

    class Jobs:
        def __init__(self, **options):
            from distributed import LocalCluster

            asked.update(options)
            self.local = LocalCluster(n_workers=0, processes=False, dashboard_address=None)

        def scale(self, jobs):
            asked["scaled to"] = jobs
            self.local.scale(1)

        def __getattr__(self, name):
            return getattr(self.local, name)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self.local.close()

    monkeypatch.setitem(sys.modules, "dask_jobqueue", ModuleType("dask_jobqueue"))
    sys.modules["dask_jobqueue"].SLURMCluster = Jobs
    options = {"jobs": 3, "cores": 8, "memory": "16GB", "queue": None}
    with connected(ClusterSettings(scheduler="slurm", slurm=options), 100) as client:
        assert client.submit(sum, [1, 2]).result() == 3
    assert asked == {"cores": 8, "processes": 8, "memory": "16GB", "scaled to": 3}
    with (
        pytest.raises(InputError, match="memory of a job is not set"),
        connected(ClusterSettings(scheduler="slurm", slurm={"cores": 2}), 1),
    ):
        pass
    monkeypatch.setitem(sys.modules, "dask_jobqueue", None)
    with (
        pytest.raises(InputError, match="needs the package dask-jobqueue"),
        connected(ClusterSettings(scheduler="slurm"), 1),
    ):
        pass


def test_peak_memory_is_that_of_this_process():
    script = """
from hdsp.base.workers import peak_memory
before = peak_memory()
block = bytearray(200_000_000)
print(before, peak_memory())
"""
    # A new process: the peak memory of this process may be higher from earlier tests.
    before, after = map(int, subprocess.check_output([sys.executable, "-c", script], cwd=ROOT).split())
    assert before + 150_000_000 < after < before + 400_000_000


def call(folder: Path, address: str) -> str:
    return f"on({address!r}, Path({str(folder)!r}), function=slow_fake_label)"


def workers_of(pid: int) -> list[psutil.Process]:
    """Worker processes of a run, including workers that are still starting."""
    try:
        return [p for p in psutil.Process(pid).children() if "spawn_main" in " ".join(p.cmdline())]
    except psutil.NoSuchProcess:
        return []


def is_worker_of(process: psutil.Process, address: str) -> bool:
    command = process.info["cmdline"] or []
    return "worker" in command and "--scheduler-file" in command and process.ppid() == os.getpid()


def kill_with_children(pid: int) -> None:
    try:
        process = psutil.Process(pid)
        for each in [process, *process.children(recursive=True)]:
            each.kill()
    except psutil.NoSuchProcess:
        pass


def contents_so_far(folder: Path) -> dict:
    """As `contents`, while a run writes there."""
    from hdsp.labels.shards import read_shard

    found = {}
    for path in finished(folder):
        shard = read_shard(path)
        found[path.name] = {**{name: a.tobytes() for name, a in shard.tasks.arrays().items()}, **shard.attributes}
    return found

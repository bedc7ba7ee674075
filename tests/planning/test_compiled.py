"""Q3: kernels are compiled or loaded before the time of a query begins, and compilation is said."""

import json
import logging
import os
import re
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from hdsp import HeightMap, Planner
from hdsp.base import compilation
from hdsp.base.jit import njit
from hdsp.planning import compiled
from hdsp.planning.cli import main
from tests import ROOT

#: Lists the kernels of a real query that were neither compiled nor loaded before its clock started.
SCRIPT = """
import json, sys
import numpy as np
import hdsp
from hdsp.planning import compiled, planner as module

heights = np.zeros((200, 160), np.float32)
heights[100:104] = 0.12
heights[160:164] = 1.0
heights[20:60, 130:140] = np.linspace(0, 0.3, 40)[:, None]
heights[5:9, 5:9] = np.nan
heights[140:150, 30:36] = np.nan  # under the robot
planner = hdsp.Planner(hdsp.HeightMap(heights), heuristic=sys.argv[1], conditioning=None)
options = json.loads(sys.argv[2])

def known():
    found = {}
    for name in [name for name in sys.modules if name.startswith("hdsp.")]:
        for value in vars(sys.modules[name]).values():
            if hasattr(value, "py_func") and hasattr(value, "overloads"):
                found[f"{value.py_func.__module__}.{value.py_func.__qualname__}"] = len(value.overloads)
    return found

before = {}
first = module.compile_for
def noted(*arguments, **keywords):
    first(*arguments, **keywords)
    before.update(known())
module.compile_for = noted
ends = (1.2, 2.0, 0.0), (3.4, 2.0, 0.3)
behind = (4.5, 2.0, 0.0)
improving = options.pop("improve", False)
query = (lambda *a, **k: list(planner.improve(*a, **k, **options))) if improving else (
    lambda *a, **k: planner.plan(*a, **({} if improving else {"weight": 1.5}), **k, **options))
answers = [query(*ends), query(*ends, expansions=100), query(ends[0], behind, expansions=100_000),
           query(*ends, tolerance=0.1), query((0.1, 0.1, 0.0), ends[1]), query((3.9, 1.0, 0.0), ends[1], way_out=True)]
late = {name: n for name, n in known().items() if n != before.get(name, 0)}
first_answer = answers[0][-1] if improving else answers[0]
print(json.dumps({"status": str(first_answer.status), "steps": first_answer.steps, "late": late}))
"""


@pytest.mark.parametrize(
    ("heuristic", "options"),
    [
        ("geometric", {"refinable": True}),
        ("grid", {}),
        ("manual", {"anchor_weight": 1.5, "refinable": True}),
        ("manual", {"improve": True, "refinable": True, "time": 5.0}),
        ("learned", {"time": 0.5}),
    ],
)
def test_q3_no_kernel_is_loaded_after_the_clock_started(heuristic, options):
    if heuristic == "learned":
        pytest.importorskip("torch")
    command = [sys.executable, "-c", SCRIPT, heuristic, json.dumps(options)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["late"] == {}
    # The network has too little time here; its kernels run in the first step.
    assert found["status"] == "time_limit" if heuristic == "learned" else found["steps"] > 0


def test_q3_compilation_is_said_once_and_only_if_there_is_any(caplog, monkeypatch):
    fresh = compilation.Compilations()
    monkeypatch.setattr(compilation.compilations, "on_start", fresh.on_start)
    with caplog.at_level(logging.WARNING, logger="hdsp"):
        Planner(HeightMap.flat((80, 80))).plan((0.9, 0.9, 0.0), (1.0, 0.9, 0.0))
        before = list(fresh.names)

        @njit()
        def one(value):
            return value + 1

        @njit()
        def two(value):
            return value + 2

        monkeypatch.setattr(one.py_func, "__module__", "hdsp.probe")
        monkeypatch.setattr(two.py_func, "__module__", "hdsp.probe")
        assert one(1) + two(1) == 5
    assert len(fresh.names) == len(before) + 2
    said = [record.getMessage() for record in caplog.records if "compiling" in record.getMessage()]
    assert said == ["compiling the planner for this machine, once; it takes about a minute"]


def test_q3_a_process_compiles_once_for_each_kind(monkeypatch):
    tried = []
    monkeypatch.setattr(compiled, "_DONE", set())
    monkeypatch.setattr(compiled, "_try", lambda robot, kind, costs: tried.append(kind))
    planner = Planner(HeightMap.flat((80, 80)))
    for _ in range(2):
        planner.plan((0.9, 0.9, 0.0), (1.0, 0.9, 0.0))
        next(planner.improve((0.9, 0.9, 0.0), (1.0, 0.9, 0.0)))
    assert tried == [compiled.QueryKind(), compiled.QueryKind(anytime=True)]
    began = time.perf_counter()
    for _ in range(1000):
        compiled.compile_for(planner.robot, planner.heuristic)
    assert time.perf_counter() - began < 0.5  # all together


def test_a_thread_that_compiles_on_use_leaves_the_trial_to_others(monkeypatch):
    tried, plans = [], []
    monkeypatch.setattr(compiled, "_DONE", set())
    monkeypatch.setattr(compiled, "_try", lambda robot, kind, costs: tried.append(kind))

    def ask():
        compiled.compile_on_use()
        plans.append(Planner(HeightMap.flat((80, 80))).plan((0.9, 0.9, 0.0), (1.0, 0.9, 0.0)))

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    assert plans[0].solved and tried == []
    Planner(HeightMap.flat((80, 80)))
    assert tried == [compiled.QueryKind()]


def test_f5_lines_of_progress_come_only_while_kernels_are_compiled(caplog, monkeypatch):
    monkeypatch.setattr(compilation, "_INTERVAL", 0.02)
    fresh = compilation.Compilations()
    ours = SimpleNamespace(data={"dispatcher": SimpleNamespace(py_func=compilation.Compilations.told)})

    def lines():
        return [record.getMessage() for record in caplog.records if record.getMessage().startswith("compiling: ")]

    with caplog.at_level(logging.WARNING, logger="hdsp"):
        with fresh.told(7):
            time.sleep(0.1)
            assert lines() == []  # all kernels came from the disk
            for _ in range(2):
                fresh.on_start(ours)
                with fresh.told(100):  # a block inside belongs to the outer one
                    time.sleep(0.1)
                fresh.on_end(ours)
        time.sleep(0.1)
        said = lines()
        time.sleep(0.1)
    assert said[0].startswith("compiling: 0 of about 7 kernels, 0 s")
    assert any(line.startswith("compiling: 1 of about 7") for line in said)
    assert lines() == said  # no more after the block
    assert fresh.done == 2


def test_f5_construction_compiles_before_any_query(monkeypatch):
    tried = []
    monkeypatch.setattr(compiled, "_DONE", set())
    monkeypatch.setattr(compiled, "_try", lambda robot, kind, costs: tried.append(kind))
    planner = Planner(HeightMap.flat((80, 80)))
    assert tried == [compiled.QueryKind()]
    planner.plan((0.9, 0.9, 0.0), (1.0, 0.9, 0.0))
    assert tried == [compiled.QueryKind()]


def test_f5_warmup_prepares_every_kind_of_query(monkeypatch, capsys):
    tried = []
    monkeypatch.setattr(compiled, "_DONE", set())
    monkeypatch.setattr(compiled, "_try", lambda robot, kind, costs: tried.append(kind))
    assert main(["warmup", "--heuristic", "manual"]) == 0
    planner = Planner(HeightMap.flat((80, 80)), heuristic="manual")
    plan = planner.plan((0.9, 0.9, 0.0), (1.0, 0.9, 0.0), anchor_weight=1.5, refinable=True)
    assert plan.solved and next(planner.improve((0.9, 0.9, 0.0), (1.0, 0.9, 0.0), refinable=True)).solved
    assert len(tried) == 6  # no query has added one
    assert capsys.readouterr().out.startswith("ready: ")


@pytest.mark.nightly
@pytest.mark.pipeline
def test_q3_the_first_query_of_a_new_installation_keeps_its_time(tmp_path):
    """Takes a minute: all kernels are compiled."""
    script = (
        "import hdsp\n"
        "planner = hdsp.Planner(hdsp.HeightMap.flat((160, 160)), heuristic='manual')\n"
        "plan = planner.plan((1.0, 1.0, 0.0), (3.0, 3.0, 1.0), 1.25, time=5)\n"
        "print(plan.status, plan.stats.seconds)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    status, seconds = done.stdout.split()
    assert status == "solved" and float(seconds) < 5
    first, *further = done.stderr.splitlines()
    assert first == "compiling the planner for this machine, once; it takes about a minute"
    progress = [re.fullmatch(r"compiling: (\d+) of about (\d+) kernels, (\d+) s", line) for line in further]
    seconds = [int(line[3]) for line in progress]
    assert len(seconds) > 2 and max(np.diff(seconds)) <= 3  # s, rounded
    done, expected = (int(progress[-1][k]) for k in (1, 2))
    assert 0.75 < done / expected < 1.01

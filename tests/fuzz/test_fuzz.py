"""A part of the fuzz suite in each run: some cases of every kind, and the supervision of workers."""

import json
from collections import Counter

import pytest

from tests.fuzz import supervisor as supervision
from tests.fuzz.__main__ import main
from tests.fuzz.groups import FINE, cases_of, kinds_of
from tests.fuzz.report import write_page

#: Kinds whose whole file is slow to write or read.
SLOW = {"laz", "motion npz", "motion json", "params", "config.json", "config.json types", "weights"}


@pytest.mark.filterwarnings("ignore::UserWarning:zipfile")
@pytest.mark.parametrize("kind", sorted(set(kinds_of("files")) - SLOW))
def test_damaged_files_end_well(kind):
    cases = cases_of("files", kind)
    outcomes = Counter(cases.outcome(seed) for seed in range(40))
    assert set(outcomes) <= set(FINE), outcomes
    assert outcomes["refused"] >= 8


@pytest.mark.parametrize("kind", sorted({"laz", "config.json", "weights"}))
def test_damaged_files_with_slow_readers_end_well(kind):
    cases = cases_of("files", kind)
    assert {cases.outcome(seed) for seed in range(4)} <= set(FINE)


@pytest.mark.parametrize(("kind", "seeds"), [("search", range(5)), ("optimal", range(2)), ("query", range(1))])
def test_plans_are_those_of_the_textbook(kind, seeds):
    cases = cases_of("plans", kind)
    outcomes = [cases.outcome(seed) for seed in seeds]
    assert set(outcomes) <= set(FINE), outcomes


@pytest.mark.parametrize("heuristic", ["manual"])
def test_updated_planners_answer_as_new_ones(heuristic):
    cases = cases_of("updates", heuristic)
    assert cases.outcome(0) == "equal"


def test_a_case_is_the_same_again():
    one, other = (cases_of("files", "npy") for _ in range(2))
    assert [one.content(seed) for seed in range(20)] == [other.content(seed) for seed in range(20)]


#: A worker whose cases end in each way.
BROKEN = """
import os, time
import tests.fuzz.groups as groups
from tests.fuzz import fuzz_worker

class Broken:
    def outcome(self, seed):
        if seed == 2:
            os.abort()
        if seed == 4:
            time.sleep(100)
        return "wrong and why" if seed == 1 else "read"

groups.cases_of = lambda group, kind: Broken()
fuzz_worker.main()
"""


def test_crashes_and_hangs_of_workers_are_counted(monkeypatch, tmp_path):
    (tmp_path / "broken_worker.py").write_text(BROKEN)
    start = supervision.subprocess.Popen
    monkeypatch.setattr(
        supervision.subprocess,
        "Popen",
        lambda arguments, **options: start([arguments[0], str(tmp_path / "broken_worker.py")], **options),
    )
    monkeypatch.setattr(supervision, "CASE", {"files": 0.5})
    monkeypatch.setattr(supervision, "BATCH", {"files": 3})
    monkeypatch.setattr(supervision, "START", 4.0)
    watch = supervision.Supervisor("files", {"some kind": 1.0}, 0, 1)
    for _ in range(4):
        if not any(fault["outcome"] == "hang" for fault in watch.faults):
            watch.run(6.0)
    assert [(fault["seed"], fault["outcome"].split()[0]) for fault in watch.faults[:3]] == [
        (1, "wrong"), (2, "crash"), (4, "hang"),
    ]  # fmt: skip
    assert watch.counts["some kind"]["read"] >= 2


def test_a_run_prints_its_counts_and_writes_them_on_a_page(tmp_path, capsys):
    result = main(["--seconds", "1", "--processes", "1", "--groups", "files", "--kinds", "npy"])
    assert result["groups"]["files"]["cases"] >= 200 and result["groups"]["files"]["faults"] == []
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == result
    page = tmp_path / "page.md"
    page.write_text("<!-- written by tests.fuzz: begin -->\n<!-- written by tests.fuzz: end -->\n")
    write_page(page, result)
    assert "| npy | " in page.read_text() and "damaged files" in page.read_text()

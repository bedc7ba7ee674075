"""The benchmark of lower cost quantiles: meaning of its results, and their place in the documentation."""

import shutil
from pathlib import Path

import pytest

from benchmarks import quantile_heuristic
from tests import ROOT

PAGE = ROOT / "docs" / "heuristics.md"


def test_low_quantiles_overestimate_less_often_and_the_page_says_so(tmp_path):
    copy = Path(shutil.copy(PAGE, tmp_path))
    sizes = ["--seeds", "0", "--pairs", "1", "--near", "0.4", "--far", "1", "--expansions", "50000"]
    result = quantile_heuristic.main([*sizes, "--quantiles", "0.01", "--page", str(copy)])
    above = result["above"]
    assert above["geometric"]["above_1"] == 0
    assert above["quantile 0.01"]["max"] <= above["predicted"]["max"]
    cheapest = next(row for row in result["rows"] if row["heuristic"] == "geometric" and row["weight"] == 1)
    assert cheapest["solved"] == 1 and cheapest["cost_to_best"] == pytest.approx(1, abs=1e-6)
    assert "| quantile 0.01 | " in copy.read_text()


def test_efforts_are_compared_over_tasks_that_both_solved():
    def run(task, heuristic, expansions, cost):
        return {
            "task": task, "heuristic": heuristic, "weight": 1.0, "solved": cost is not None,
            "expansions": expansions, "cost": cost,
        }  # fmt: skip

    said = quantile_heuristic.PREDICTED
    runs = [
        run("a", said, 100, 2.0), run("a", "low", 400, 1.0),
        run("b", said, 100, 1.0), run("b", "low", 100, 1.0),
        run("c", said, 100, 1.0), run("c", "low", 900, None),
        run("d", said, 900, None), run("d", "low", 900, None),
    ]  # fmt: skip
    found = quantile_heuristic.summary(runs)
    assert (found["tasks"], found["solved_by_none"]) == (4, 1)
    as_said, low = found["rows"]
    assert (as_said["solved"], as_said["expansions"]) == (3, 1.0)
    assert as_said["cost_to_best"] == pytest.approx(4 / 3, abs=1e-4) and as_said["largest_cost_to_best"] == 2
    assert (low["solved"], low["compared"], low["expansions"], low["cost_to_best"]) == (2, 2, 2.0, 1.0)

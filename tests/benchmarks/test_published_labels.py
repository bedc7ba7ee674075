"""The cost model against the authors' labels: benchmark results, and the documentation's statements about them."""

import json
import re

import pytest

from benchmarks import published_labels
from hdsp.labels.published_tasks import find_published, read_published
from tests import ROOT

COST_MODEL = ROOT / "docs/cost-model.md"


@pytest.fixture(scope="module")
def scores():
    path, reason = find_published(timeout=5)
    if path is None:
        pytest.skip(reason)
    if len(read_published(path)) != 39:
        pytest.skip(f"{path} does not hold the even-numbered maps alone")
    return published_labels.main([str(path)])


def test_the_cost_model_reproduces_the_published_labels(scores):
    assert scores["flat"]["feasibility_agreement"] == 1 and scores["flat"]["cost_error_max"] < 1e-5
    assert scores["driving"]["feasibility_agreement"] >= 0.993 and scores["driving"]["cost_mae"] <= 0.004
    assert scores["stairs"]["feasibility_agreement"] >= 0.96
    assert scores["feasibility_agreement"] >= 0.987
    assert "expansion_limit" not in scores["ended"]


def test_the_documented_scores_of_the_other_stairs_are_those_of_the_benchmark(scores):
    path = find_published(timeout=5)[0].with_name("simulated_stairs.txt")
    if not path.is_file():
        pytest.skip(f"{path} not found")
    found = published_labels.main([str(path)])
    documented = re.search(
        r"feasibility agreement of ([\d.]+) and a mean cost error of (\d\.\d+)", COST_MODEL.read_text()
    )
    assert documented.groups() == (str(found["feasibility_agreement"]), str(found["cost_mae"]))


def test_the_documented_scores_are_those_of_the_benchmark(scores):
    documented = json.loads(re.search(r"```json\n(.*?)```", COST_MODEL.read_text(), re.DOTALL).group(1))
    assert documented == {name: value for name, value in scores.items() if name != "seconds"}

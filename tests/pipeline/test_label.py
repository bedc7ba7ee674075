"""Labels as the stage writes them."""

import json

import pytest

from hdsp.shards import read_tasks
from tests.pipeline.conftest import SPLITS, run_python, tiny

pytestmark = [pytest.mark.pipeline, pytest.mark.xdist_group("chain")]


@pytest.mark.parametrize("split", SPLITS)
def test_the_counts_in_the_report_are_those_of_the_shards(labelled, split):
    tasks = read_tasks(labelled / "data/labels" / split)
    report = json.loads((labelled / f"reports/labels/{split}.json").read_text())
    assert report["maps"] == len(tasks) > 0
    assert report["tasks"] == tasks.feasible.size == 22 * len(tasks)
    assert report["feasible_share"] == pytest.approx(tasks.feasible.mean())
    assert report["cost_mean"] == pytest.approx(tasks.cost[tasks.feasible].mean(), rel=1e-5)
    assert report["maps"] + report["maps_dropped"] == 9 * {"train": 2, "val": 1, "random": 1}[split]


def test_splits_have_no_map_in_common(labelled):
    seeds = {split: set(read_tasks(labelled / "data/labels" / split).seed.tolist()) for split in SPLITS}
    assert (
        not seeds["train"] & seeds["val"]
        and not seeds["train"] & seeds["random"]
        and not seeds["val"] & seeds["random"]
    )


def test_a_second_run_changes_no_shard(labelled):
    folder = labelled / "data/labels/val"
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    run_python("pipeline.label", "val", *tiny(labelled))
    assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == before


def test_an_unknown_split_is_named(tmp_path):
    with pytest.raises(AssertionError, match=r"error: unknown split 'tset'; labelling.splits has train, val, random\n"):
        run_python("pipeline.label", "tset", *tiny(tmp_path))

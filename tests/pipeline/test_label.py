"""Labels written by the stage."""

import json

import pytest

from hdsp.labels.shards import read_tasks
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
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.h5")}
    run_python("pipeline.label", "val", *tiny(labelled))
    assert before and {path: path.stat().st_mtime_ns for path in folder.rglob("*.h5")} == before


def test_an_unknown_split_is_named(tmp_path):
    with pytest.raises(
        AssertionError,
        match=r"error: unknown split 'tset'; labelling.splits has train, val, random, sensed, val_sensed, blocked, ",
    ):
        run_python("pipeline.label", "tset", *tiny(tmp_path))


def test_the_report_sets_the_labels_beside_those_of_the_paper(labelled):
    said = run_python("pipeline.label_report", *tiny(labelled)).stdout
    report = json.loads((labelled / "reports/labels.json").read_text())
    assert report["profile"] == "tiny"
    assert (labelled / "reports/labels.md").read_text() in said
    for split in SPLITS:
        ours, counted = report["splits"][split], json.loads((labelled / f"reports/labels/{split}.json").read_text())
        assert {name: ours[name] for name in ("maps", "tasks", "feasible_share", "cost_mean")} == {
            name: counted[name] for name in ("maps", "tasks", "feasible_share", "cost_mean")
        }
        assert {name: of_it["maps"] for name, of_it in ours["categories"].items()} == counted["maps_per_category"]
        assert ours["dropped_maps_looked_at"] == counted["maps_dropped"]
        assert sum(ours["dropped_for"].values()) == pytest.approx(1)
        assert ours["runs"][0]["tasks"] == 22 * ours["maps_before"] and ours["runs"][0]["peak_memory"] < 1.5e9
    assert report["splits"]["train"]["paper"]["maps"] == 11_327
    assert "| 11,327 |" in said and "| 249,194 |" in said and "staircase_focused" in said


def test_a_report_of_labels_of_other_settings_is_refused(labelled):
    with pytest.raises(
        AssertionError,
        match=r"holds no finished labels of this configuration and code; `python -m pipeline",
    ):
        run_python("pipeline.label_report", *tiny(labelled), "labelling.settings.cost_limit_factor=1.2")

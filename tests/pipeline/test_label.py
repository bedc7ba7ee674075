"""Labels written by the stage."""

import json
from concurrent.futures import ThreadPoolExecutor

import pytest

from hdsp.labels.shards import read_tasks
from pipeline.config import configure
from pipeline.label import label as stage
from pipeline.label_places import shards_place
from pipeline.label_prune import prune
from pipeline.stage import Folders
from pipeline.task_sets import read_set
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


def test_h6_two_runs_in_one_folder_at_once_end_with_the_labels_of_one(labelled, tmp_path):
    with ThreadPoolExecutor(2) as pool:
        for run in [pool.submit(run_python, "pipeline.label", "random", *tiny(tmp_path)) for _ in range(2)]:
            run.result()
    contents = [
        {str(path.relative_to(place)): path.read_bytes() for path in place.rglob("*.h5")}
        for place in (tmp_path / "data/labels/random", labelled / "data/labels/random")
    ]
    assert contents[0] and contents[0] == contents[1]
    assert not [path for path in (tmp_path / "data/labels").rglob("*") if path.is_file() and "tmp" in path.name]


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


@pytest.fixture
def two_settings(tmp_path):
    """Two configurations that label into one destination, as two branches do."""
    where = f"labelling.destination={tmp_path / 'shared'}"
    of_one = ["profile=tiny", "+labelling.splits.val.categories=[cuboid_1]", "runtime.workers=1", where]
    return configure(of_one), configure([*of_one, "labelling.settings.cost_limit_factor=0.5"])


def test_branches_share_a_destination_without_loss_and_read_their_own_labels(two_settings, tmp_path):
    folders, found = Folders(tmp_path, tmp_path), {}
    for config in (*two_settings, *two_settings):
        stage(config, folders, "val")
        used = json.loads((tmp_path / "data/labels/val/labels.json").read_text())
        tasks, _ = read_set(shards_place(config, tmp_path, "val"))
        times = {path: path.stat().st_mtime_ns for path in (tmp_path / "shared").rglob("*.h5")}
        limit = config.labelling.settings.cost_limit_factor
        assert found.setdefault(limit, (used, tasks.cost.tobytes()))[0] == used
        assert found[limit][1] == tasks.cost.tobytes() and used["kept"] == len(tasks) > 0
    (one, costs), (other, other_costs) = found.values()
    assert one["labels_hash"] != other["labels_hash"] and costs != other_costs
    assert len(times) == 2
    third = configure(["profile=tiny", "+labelling.splits.val.categories=[cuboid_1]", "robot=go2w"])
    assert read_set(shards_place(third, tmp_path / "shared", "val"))[0] is None, "labels of others are not accepted"


def test_pruning_lists_first_and_removes_what_no_configuration_needs(two_settings, tmp_path, capsys):
    folders = Folders(tmp_path, tmp_path)
    for config in two_settings:
        stage(config, folders, "val")
    mine, other = (shards_place(config, tmp_path, "val") for config in two_settings)
    name = other.parent.name
    prune(two_settings[0], folders)
    said = capsys.readouterr().out
    assert f"keep   {mine.parent}: 1 maps, 1 shards" in said and f"remove {other.parent}: 1 maps, 1 shards" in said
    assert "other settings.cost_limit_factor" in said and "nothing is removed yet: add --yes" in said
    prune(two_settings[0], folders, confirmed=True, kept=[name])
    assert "nothing to remove" in capsys.readouterr().out and other.is_dir()
    unfinished = mine.parent / "shards/00000/.0.77-ff.tmp.h5"
    unfinished.write_bytes(b"half")
    prune(two_settings[0], folders, confirmed=True)
    assert "removed 1 label sets" in capsys.readouterr().out
    assert not other.parent.exists() and not unfinished.exists()
    assert read_set(mine)[0] is not None

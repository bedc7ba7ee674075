"""The experiments in conf/experiment/ablation: each differs from the base exactly as its file says."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from hdsp.base.errors import InputError
from hdsp.labels.shards import write_shard
from hdsp.learning.learning_settings import TrainerSettings
from pipeline.compare import SECTIONS, differences
from pipeline.config import CONF, compose, flatten, typed
from pipeline.train import part_of
from tests import ROOT
from tests.labels.task_sets import random_tasks

NAMES = sorted(path.stem for path in (CONF / "experiment/ablation").glob("*.yaml"))


def flat(config):
    return flatten({section: config[section] for section in SECTIONS})


@pytest.fixture(scope="module")
def base():
    return flat(compose(["experiment=ablation/base"]))


@pytest.mark.parametrize("name", NAMES)
def test_an_ablation_differs_from_the_base_in_what_its_file_says(name, base):
    config = compose([f"experiment=ablation/{name}"])
    assert Path(config.runtime.outputs) == Path("outputs/ablations") / name
    assert config.profile == "beyond" and config.runtime.inputs == "outputs/beyond"
    typed(config).model.checked_options()
    assert set(differences(base, flat(config))) == (set() if name == "base" else told(name))


@pytest.mark.parametrize("removed", ["blocked", "courses", "sensed"])
def test_an_ablation_trains_on_splits_of_the_base_and_its_commands_make_them(removed, base):
    all_splits, config = base["trainer.splits"], compose([f"experiment=ablation/no_{removed}"])
    assert list(config.trainer.splits) == [split for split in all_splits if removed not in split]
    words = (CONF / "experiment/ablation/base.yaml").read_text().partition("for split in ")[2].partition(";")[0].split()
    assert set(words) == {*all_splits, "val", "val_sensed", "random"} - {"courses"}
    assert f"for split in {' '.join(words)};" in (ROOT / "docs/architectures.md").read_text()


def told(name):
    """Changes listed in an ablation's file; another model counts by its architecture."""
    file = yaml.safe_load((CONF / f"experiment/ablation/{name}.yaml").read_text())
    groups = {key for entry in file.pop("defaults") if isinstance(entry, dict) for key in entry}
    keys = set(flatten({section: file[section] for section in SECTIONS if section in file}))
    assert groups <= {"override /model"} and keys | groups
    return keys | ({"model.architecture"} if groups else set())


def test_a_part_of_the_maps_is_the_same_every_time_and_as_large_as_said(tmp_path):
    folders, tasks = [tmp_path / "a", tmp_path / "b"], random_tasks(50)
    for number, shard in enumerate([tasks[:10], tasks[10:20], tasks[20:30], tasks[30:40]]):
        write_shard(folders[0] / f"{number}.h5", shard, {"labels_hash": "0" * 64, "maps": 10})
    write_shard(folders[1] / "0.h5", tasks[40:], {"labels_hash": "0" * 64, "maps": 10})
    half = part_of(folders, TrainerSettings(share=0.5))
    assert len(half) == 25
    seen = {heights.tobytes() for heights in half.heights}
    assert len(seen) == 25 and seen < {heights.tobytes() for heights in tasks.heights}, "each once"
    np.testing.assert_array_equal(half.heights, part_of(folders, TrainerSettings(share=0.5)).heights)
    assert len(part_of(folders, TrainerSettings(share=0.3))) == 12 + 3
    np.testing.assert_array_equal(part_of(folders, TrainerSettings()).heights, tasks.heights)
    straight = part_of(folders, TrainerSettings(residues=(0,)))
    assert len(straight) == (tasks.heading % 16 == 0).sum()
    write_shard(tmp_path / "straight" / "0.h5", straight, {"labels_hash": "0" * 64, "maps": 10})
    with pytest.raises(InputError, match=f"no map is left of {len(straight)}"):
        part_of([tmp_path / "straight"], TrainerSettings(residues=(1,)))
    with pytest.raises(InputError, match="nowhere is not there yet"):
        part_of([folders[0], tmp_path / "nowhere"], TrainerSettings(share=0.5))

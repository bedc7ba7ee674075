"""The report as one HTML file: complete, alone, small, and its scenes are pages of the viewer."""

import json
import re

import numpy as np
import pytest
import yaml

from hdsp.base.errors import InputError
from hdsp.detailed.actions.action import Action, ActionKind
from pipeline.html_report import chosen_series, shared_text, stage_table
from pipeline.stage import Folders
from pipeline.stored_paths import PathKey, StoredPath, read_paths, write_paths

KEY = PathKey("I", "shipped", 1.25)
STATES = np.arange(28.0).reshape(4, 7)
ACTIONS = (
    Action(ActionKind.DRIVE),
    Action(ActionKind.STEP, "rear_left", 0.25),
    Action(ActionKind.BASE_SHIFT, length=-0.025),
)


def test_paths_come_back_as_they_were_written(tmp_path):
    write_paths(tmp_path / "paths.npz", {KEY: (STATES, ACTIONS), KEY._replace(task="II"): (np.empty((0, 7)), ())})
    ((key, found),) = read_paths(tmp_path / "paths.npz").items()
    assert key == KEY and found.actions == ACTIONS
    np.testing.assert_array_equal(found.states, STATES)
    with pytest.raises(InputError, match="the stage plan writes them"):
        read_paths(tmp_path / "other.npz")


def test_the_shipped_heuristic_is_shown_at_the_weight_nearest_to_the_papers():
    keys = [PathKey("I", name, weight) for name in ("geometric", "manual", "shipped") for weight in (1.0, 1.5, 2.0)]
    paths = {key: StoredPath(STATES, ACTIONS) for key in keys}
    assert chosen_series(paths) == ("shipped", 1.0)
    assert chosen_series({keys[0]: paths[keys[0]]}) == ("geometric", 1.0)
    with pytest.raises(InputError, match="no search in the arena found a path"):
        chosen_series({})


@pytest.mark.parametrize("texts", [["abXcd", "abYcd"], ["aa", "aaa"], ["same", "same"], ["ab", "ba"], ["alone"]])
def test_shared_beginning_and_end_leave_each_text_whole(texts):
    before, after = shared_text(texts)
    for text in texts:
        assert text.startswith(before) and text.endswith(after) and len(before) + len(after) <= len(text)
    assert (before, after) == ("ab", "cd") or texts[0] != "abXcd"


def test_each_stage_has_its_command_code_and_results(tmp_path):
    stages = {
        "train": {
            "cmd": "python -m pipeline.train",
            "deps": [{"path": "data/code/train", "md5": "0123456789abcdef"}],
            "outs": [{"path": "models/abstraction", "md5": "fedcba9876543210.dir"}, {"path": "a.png", "md5": "1"}],
        },
        "report": {"cmd": "python -m pipeline.report"},
    }
    (tmp_path / "dvc.lock").write_text(yaml.safe_dump({"schema": "2.0", "stages": stages}))
    (line,) = stage_table(Folders(tmp_path, tmp_path)).splitlines()[2:]
    assert [cell.strip() for cell in line.strip("|").split("|")] == [
        "`python -m pipeline.train`", "0123456789ab", "`models/abstraction` fedcba987654",
    ]  # fmt: skip
    assert stage_table(Folders(tmp_path / "other", tmp_path)) == ""


@pytest.mark.pipeline
@pytest.mark.xdist_group("chain")
def test_the_page_of_a_run_is_alone_and_can_be_sent(chain):
    page = (chain / "reports/index.html").read_text()
    assert len(page) < 10e6
    assert not re.search(r'(?:src|href)="(?!data:|#)', page.partition('id="scenes"')[0])
    for words in ("Table I, abstraction quality", "Table II, heuristic performance", "Random tasks, W ="):
        assert words in page
    assert page.count("data:image/webp;base64,") >= 7
    scenes = json.loads(re.search(r'id="scenes">(.*?)</script>', page, re.DOTALL)[1])
    (task,) = scenes["tasks"]
    assert task["name"] == "near" and task["caption"].startswith("cost ")
    assert "Viser" in scenes["before"] + task["text"] + scenes["after"]

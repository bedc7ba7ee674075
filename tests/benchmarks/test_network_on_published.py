"""The network benchmark on the format of the published labels."""

import json

import numpy as np
import pytest

from benchmarks.network_on_published import main
from hdsp.labels.published_tasks import write_published
from hdsp.learning.loading import load_abstraction
from hdsp.robot.lattice import ABSTRACT_ACTIONS
from tests.learning.synthetic import synthetic_tasks


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A file with maps numbered 22 (flat), 30 (driving), 44 (stairs), with arbitrary contents."""
    from dataclasses import replace

    tasks = synthetic_tasks(3)
    goals = np.broadcast_to(np.float32(ABSTRACT_ACTIONS), tasks.goals.shape)
    heights = tasks.heights.copy()
    heights[0] = 0.0  # beside a block, the network may judge every task infeasible
    tasks = replace(tasks, heights=heights, goals=goals, index=np.array([22, 30, 44]))
    return write_published(tmp_path_factory.mktemp("published") / "tasks.txt", tasks), tasks


def test_each_group_has_its_figures(file, capsys):
    path, tasks = file
    result = main([str(path), "--model", "momaro", "--maps"])
    lines = capsys.readouterr().out.splitlines()
    assert json.loads(lines[-1]) == result
    assert [result[name]["maps"] for name in ("all", "flat", "driving", "stairs")] == [3, 1, 1, 1]
    assert result["all"]["tasks"] == 66
    judged, cost = load_abstraction("momaro").predict(tasks.heights, tasks.goals)
    assert result["all"]["feasibility_accuracy"] == pytest.approx((judged == tasks.feasible).mean(), abs=0.02)
    both = judged & tasks.feasible
    assert result["all"]["cost_error"] == pytest.approx(np.abs(cost - tasks.cost)[both].mean(), abs=0.01)
    assert 0 <= result["ece"] <= 1


def test_bad_files_and_models_end_with_one_line(file, tmp_path):
    with pytest.raises(SystemExit, match="error: abstraction 'none'"):
        main([str(file[0]), "--model", "none"])
    (tmp_path / "x.txt").write_text("nothing\n")
    with pytest.raises(SystemExit, match="error: published labels"):
        main([str(tmp_path / "x.txt")])

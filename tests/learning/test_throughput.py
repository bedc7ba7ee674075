"""The benchmarks of training data and throughput measure the promised quantities."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import sensing, training
from tests import ROOT
from tests.learning.synthetic import synthetic_tasks

PAGE = ROOT / "docs" / "pipeline.md"


def test_one_pass_for_all_goals_is_ten_times_faster_than_a_pass_for_each_and_learns_the_same(tmp_path):
    copy = shutil.copy(PAGE, tmp_path)
    result = training.main(["--maps", "1", "--repeats", "2", "--page", str(copy)])
    assert result["model"] == "klamt2019" and result["gradient_difference"] <= 1e-4
    assert result["ratio"] >= 10
    assert f"| {result['tasks_per_s']['separate']} | " in Path(copy).read_text()


def test_noise_and_unknown_cells_are_measured():
    tasks = synthetic_tasks(4)
    noisy = tasks.heights + np.random.default_rng(0).normal(0, 0.002, tasks.heights.shape)
    noisy[:, :18] = np.nan
    found = sensing.describe(replace(tasks, heights=noisy))
    assert found["unknown"] == 0.25
    assert found["noise_median_mm"] == pytest.approx(2.0, rel=0.1)
    assert abs(found["correlation_1_cell"]) < 0.1
    assert sensing.describe(tasks)["noise_90_mm"] == 0

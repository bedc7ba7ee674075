"""The page about the paper's network and recipe."""

import json

import pytest

from hdsp.base.errors import InputError
from pipeline.paper_training import begin_end, paper_training, read_history, read_published, table
from pipeline.stage import Folders
from tests import ROOT

HEADER = "epoch,feasibility_accuracy/val,cost_error/val,feasibility_accuracy/random,cost_error/random\n"


def test_the_published_curve_is_that_of_the_figure():
    rows = read_published()
    assert [row["epoch"] for row in rows] == list(range(1, 101))
    assert max(row["feasibility_accuracy"] for row in rows) == 0.958
    late = [row for row in rows if row["epoch"] > 60]
    assert all(0.949 < row["feasibility_accuracy"] < 0.958 and 0.027 < row["cost_error"] < 0.032 for row in late)


def test_the_best_epoch_is_chosen_by_validation(tmp_path):
    history = tmp_path / "history.csv"
    history.write_text(HEADER + "0,0.9,0.05,0.99,0.01\n1,0.95,0.03,0.94,0.02\n")
    text = table(read_history(history), read_published(), 100)
    assert "ours, random" in text
    assert "| 2          | 94.00 % / 0.0200" in text
    assert "2 of 100 epochs" in text


def test_page_report_and_picture(tmp_path):
    (tmp_path / "outputs/paper/reports").mkdir(parents=True)
    (tmp_path / "outputs/paper/reports/training_history.csv").write_text(HEADER + "0,0.9,0.05,0.99,0.01\n")
    page = tmp_path / "docs/architectures.md"
    page.parent.mkdir()
    page.write_text((ROOT / "docs/architectures.md").read_text())
    paper_training(None, Folders(tmp_path, tmp_path))
    assert json.loads((tmp_path / "reports/klamt2019.json").read_text())["epochs"][0]["epoch"] == 1
    assert (tmp_path / "docs/figures/klamt2019_training.png").stat().st_size > 10_000
    begin, end = begin_end()
    assert "90.00 % / 0.0500" in page.read_text().split(begin)[1].split(end)[0]


def test_without_run_and_report_it_says_how_to_train(tmp_path):
    with pytest.raises(InputError, match="experiment=klamt2019"):
        paper_training(None, Folders(tmp_path, tmp_path))

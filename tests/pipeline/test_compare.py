"""Comparison of trainings, with synthetic reports."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.base.errors import InputError
from hdsp.viz import pareto_front
from pipeline import compare
from pipeline.compare import PAGE, TABLES, ablation_table, differences, markers, zoo_table
from pipeline.stage import Folders

NUMBERS = st.integers(0, 5)


def training(accuracy: float, error: float, **values) -> dict:
    report = {
        "model": "compact", "parameters": 12345, "maps": 3000, "epochs": 5, "best_epoch": 4, "seconds": 90.0,
        "loss": {"cost": 1.0},
        "feasibility_accuracy": {"val": accuracy, "random": accuracy, "published": None},
        "cost_error": {"val": error, "random": error, "published": None},
    }  # fmt: skip
    return report | values


def write_run(folder, report) -> None:
    (folder / "reports").mkdir(parents=True)
    (folder / "reports/training.json").write_text(json.dumps(report))


def takes(name: str) -> dict:
    return {"parameters": 12345, "dense": False, "map_seconds": float(name[1:])}


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A folder with a page; a model's time is the number in its folder's name."""
    (tmp_path / "docs").mkdir()
    blocks = "\n".join("\n".join(markers(kind)) for kind in ("zoo", "ablations"))
    (tmp_path / "docs" / PAGE).write_text(f"before\n{blocks}\nafter\n")

    monkeypatch.setattr(compare, "models", lambda runs: {name: name for name in [*runs, "m99"]})
    monkeypatch.setattr(compare, "measured", takes)
    return tmp_path


def run_compare(project) -> str:
    compare.compare(None, Folders(project, project))
    return (project / "docs" / PAGE).read_text()


def test_runs_become_a_table_and_a_picture_that_need_no_runs_afterwards(project):
    for seconds, accuracy in ((3, 0.9), (20, 0.95), (40, 0.94)):
        write_run(project / f"outputs/zoo/m{seconds}", training(accuracy, 0.03 - seconds / 10000))
    page = run_compare(project)
    assert page.startswith("before\n")
    assert page.endswith("after\n")
    rows = [line for line in page.splitlines() if line.startswith("| ")]
    assert [row.split("|")[1].strip() for row in rows[1:]] == ["**m3**", "**m20**", "**m40**", "m99"]
    assert "95.00 % / 0.0280" in rows[2]
    assert "12,345" in rows[1]
    assert rows[4].count("–") == 2  # no run of that model
    assert "No runs yet." in page  # there are no ablations
    assert (project / "docs/figures/pareto.png").read_bytes().startswith(b"\x89PNG")
    (project / "outputs").rename(project / "elsewhere")
    assert run_compare(project) == page


def test_a_figure_that_is_missing_is_left_empty_and_the_set_that_selects_is_not_shown():
    table = zoo_table({"a": {**compare.outcome(training(0.9, 0.02)), **takes("a12.34"), "dense": True}})
    header, _, row, *_ = table.splitlines()
    assert [cell.strip() for cell in header.split("|")[5:7]] == ["random", "published"]
    assert [cell.strip() for cell in row.split("|")[3:7]] == ["12.3", "dense", "90.00 % / 0.0200", "–"]


def test_models_with_different_budgets_are_not_compared(project):
    write_run(project / "outputs/zoo/m1", training(0.9, 0.02))
    write_run(project / "outputs/zoo/m2", training(0.9, 0.02, epochs=30))
    with pytest.raises(InputError, match=r"different budgets .* m1 3000 maps 5 epochs, m2 3000 maps 30 epochs"):
        run_compare(project)


def test_models_without_a_run_keep_what_was_reported_of_the_same_model(project, monkeypatch):
    for name in ("m1", "m2", "m3"):
        write_run(project / "outputs/zoo" / name, training(0.9, 0.02))
    before = run_compare(project)
    for name in ("m1", "m2", "m3"):
        (project / "outputs/zoo" / name).rename(project / name)
    write_run(project / "outputs/zoo/m1", training(0.8, 0.03))
    monkeypatch.setattr(compare, "models", lambda runs: {name: name for name in ("m1", "m2", "m3")})
    monkeypatch.setattr(compare, "measured", lambda name: takes(name) | ({"parameters": 5} if name == "m3" else {}))
    run_compare(project)
    report = json.loads((project / "reports/zoo.json").read_text())
    assert [report[name].get("cost_error", {}).get("random") for name in ("m1", "m2", "m3")] == [0.03, 0.02, None]

    write_run(project / "outputs/zoo/m3", training(0.8, 0.03, maps=7))
    with pytest.raises(InputError, match=r"m2 3000 maps 5 epochs, m3 7 maps .* those without a run: m2$"):
        run_compare(project)
    assert json.loads((project / "reports/zoo.json").read_text()) == report
    assert before != (project / "docs" / PAGE).read_text()


def test_ablations_without_a_run_stay_while_their_experiment_is_the_same(project):
    for name in ("base", "no_ema", "sgd", "removed"):
        write_run(project / "outputs/ablations" / name, training(0.9, 0.02))
    run_compare(project)
    path = project / "reports/ablations.json"
    report = json.loads(path.read_text())
    report["sgd"]["different"]["trainer.optimizer.lr"] = 0.123
    path.write_text(json.dumps(report))
    (project / "outputs").rename(project / "elsewhere")
    write_run(project / "outputs/ablations/base", training(0.8, 0.03))
    page = run_compare(project)
    assert list(json.loads(path.read_text())) == ["base", "no_ema"]
    assert "| trainer.ema: null" in page and "(+10.00 / -0.0100)" in page

    write_run(project / "outputs/ablations/sgd", training(0.8, 0.03, epochs=9))
    with pytest.raises(InputError, match=r"base 5 epochs, no_ema 5 epochs, sgd 9 epochs; .* without a run: no_ema$"):
        run_compare(project)


def test_ablations_are_told_as_differences_to_the_base(project):
    write_run(project / "outputs/ablations/base", training(0.9, 0.02))
    write_run(project / "outputs/ablations/other", training(0.91, 0.0185))
    (row,) = [line for line in run_compare(project).splitlines() if line.startswith("| other")]
    assert "91.00 % / 0.0185 (+1.00 / -0.0015)" in row


def test_ablations_need_their_base():
    with pytest.raises(InputError, match="there is no run 'base' to compare with; there are a"):
        ablation_table({"a": {}})


def test_what_an_experiment_changes():
    base = {"trainer.epochs": 3, "trainer.mirror": True, "model.options.a": 1}
    other = {"trainer.epochs": 3, "trainer.mirror": False, "model.options.widths": [1, 2]}
    found = differences(base, other)
    assert found == {"trainer.mirror": False, "model.options.a": None, "model.options.widths": [1, 2]}
    assert differences(base, None) is None
    outcome = compare.outcome(training(0.9, 0.02))
    table = ablation_table({"base": {**outcome, "different": {}}, "b": {**outcome, "different": found}})
    assert "trainer.mirror: false, model.options.a: null, model.options.widths: [1, 2]" in table
    base["model.architecture"], other["model.architecture"] = "swept", "compact"
    assert differences(base, other) == {"trainer.mirror": False, "model.architecture": "compact"}


def test_settings_of_an_experiment_of_the_project():
    settings = compare.experiment_settings("klamt2019")
    assert settings["model.architecture"] == "klamt2019"
    assert compare.experiment_settings("none_of_that_name") is None


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=12))
def test_no_point_is_better_than_one_of_the_front_and_each_other_has_one_that_is(points):
    front = pareto_front(points)

    def dominates(a, b):
        return a != b and a[0] <= b[0] and a[1] <= b[1]

    for index, point in enumerate(points):
        assert (index in front) == (not any(dominates(other, point) for other in points))
    assert list(np.array(points)[front][:, 0]) == sorted(np.array(points)[front][:, 0])


def test_the_page_of_the_project_holds_its_reports():
    for kind, table in TABLES.items():
        begin, end = markers(kind)
        text = (compare.CONF.parent / "docs" / PAGE).read_text().split(begin)[1].split(end)[0]
        report = compare.CONF.parent / "reports" / f"{kind}.json"
        assert text.strip() == table(json.loads(report.read_text()) if report.is_file() else {}).strip()

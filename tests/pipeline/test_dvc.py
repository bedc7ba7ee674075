"""The pipeline under DVC, in a clone of the project set to the tiny profile."""

import json
import re
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest
import yaml

from hdsp.base.errors import InputError
from pipeline.publish_pages import publish_pages
from tests.pipeline.conftest import ROOT, clone_project, dvc_environment, git, run_dvc, run_python

pytestmark = [pytest.mark.pipeline, pytest.mark.xdist_group("dvc")]


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    """A clone after its first `dvc repro`."""
    project = clone_project(tmp_path_factory.mktemp("project"))
    run_dvc("repro", cwd=project)
    return project


def test_repro_runs_the_chain_once(reproduced):
    changed = git("diff", "--name-only", cwd=reproduced).split()
    assert not [name for name in changed if name.endswith(".md") and not name.startswith("reports/")]
    assert "up to date" in run_dvc("status", cwd=reproduced)
    before = tracked_files(reproduced)
    again = run_dvc("repro", cwd=reproduced)
    assert "Running stage" not in again
    assert "up to date" in again
    assert tracked_files(reproduced) == before, "nothing changed, so no tracked file may"


def tracked_files(project) -> dict[str, bytes]:
    """Contents of all files in git, and of those that will be."""
    names = git("ls-files", "--cached", "--others", "--exclude-standard", cwd=project).splitlines()
    return {name: (project / name).read_bytes() for name in names if (project / name).is_file()}


def test_results_go_to_the_pages_on_request_only(reproduced, tmp_path):
    for name in ("README.md", "docs/results.md", "reports/tables.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text((reproduced / name).read_text())
    for name in ("abstraction_quality", "planning"):
        (tmp_path / f"reports/{name}.json").write_text((reproduced / f"reports/{name}.json").read_text())
    publish_pages(tmp_path)
    assert (tmp_path / "reports/tables.md").read_text() in (tmp_path / "docs/results.md").read_text()
    assert (tmp_path / "README.md").read_text() != (reproduced / "README.md").read_text()
    (tmp_path / "reports/tables.md").unlink()
    with pytest.raises(InputError, match="make repro"):
        publish_pages(tmp_path)


def test_each_stage_has_its_seconds(reproduced):
    lines = run_python("pipeline.seconds", cwd=reproduced).stdout.splitlines()[2:]
    seconds = {name.strip(): int(value) for name, value in (line.strip("| ").split("|") for line in lines)}
    total = seconds.pop("all")
    stages = run_dvc("stage", "list", "--name-only", cwd=reproduced).split()
    assert set(seconds) == set(stages)
    assert abs(total - sum(seconds.values())) <= len(stages)


def test_outputs_that_dvc_keeps_are_not_in_git_and_reports_are(reproduced):
    stages = yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"]
    outputs = [out for stage in stages.values() for out in [*stage.get("outs", []), *stage.get("metrics", [])]]
    how = {name: options for out in outputs if isinstance(out, dict) for name, options in out.items()}
    in_git = [name for name, options in how.items() if options.get("cache") is False and "$" not in name]
    assert in_git
    assert all(name.startswith("reports/") for name in in_git)
    for path in ("data/labels/train/labels.json", "data/published", "models/abstraction"):
        assert subprocess.run(["git", "check-ignore", "--quiet", path], cwd=reproduced).returncode == 0
    for name in in_git:
        assert (reproduced / name).is_file()
        assert subprocess.run(["git", "check-ignore", "--quiet", name], cwd=reproduced).returncode == 1


def test_metrics_plots_and_graph_show_the_results(reproduced, tmp_path):
    metrics = json.loads(run_dvc("metrics", "show", "--json", cwd=reproduced).partition("\n")[0])
    shown = metrics[""]["data"]["reports/summary.json"]["data"]
    assert set(shown["feasibility_accuracy"]["random"]) == {"trained", "manual", "flat"}
    run_dvc("plots", "show", "--out", str(tmp_path / "plots"), cwd=reproduced)
    page = (tmp_path / "plots/index.html").read_text()
    assert "cost_error/val" in page
    assert "planned_path.png" in page
    graph = run_dvc("dag", "--dot", cwd=reproduced)
    assert '"label@train" -> "train"' in graph
    assert '"plan" -> "report"' in graph


@pytest.mark.nightly
def test_an_experiment_beside_the_working_tree_is_tracked_in_the_project(reproduced):
    """`--temp` runs in a copy that DVC removes afterwards; the tracking database must not be in it."""
    git("add", "--all", cwd=reproduced)
    identity = ["-c", "user.name=test", "-c", "user.email=test@example.org"]
    git(*identity, "commit", "--quiet", "--allow-empty", "-m", "results", cwd=reproduced)
    before = (reproduced / "reports/training.json").read_text()
    run_dvc("exp", "run", "--temp", "--name", "other-network", "-S", "model=klamt2019", "train", cwd=reproduced)

    assert (reproduced / "reports/training.json").read_text() == before
    shown = run_dvc("exp", "show", "--json", cwd=reproduced)
    assert "other-network" in shown
    script = (
        "import mlflow; mlflow.set_tracking_uri('sqlite:///mlflow.db');"
        "print([r.data.params['model.architecture'] for r in mlflow.search_runs(experiment_names=['hdsp'],"
        " output_format='list') if r.data.tags.get('dvc.experiment') == 'other-network'])"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=reproduced, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['klamt2019']"


def test_an_edit_runs_the_stages_whose_results_it_decides(reproduced):
    network, report = reproduced / "hdsp/learning/networks/compact.py", reproduced / "pipeline/report.py"
    network.write_text(network.read_text() + "\n# A comment.\n")
    assert stages_run(reproduced) == ["code"]
    report.write_text(report.read_text().replace('return {"feasibility', 'return {**{}, "feasibility'))
    assert stages_run(reproduced) == ["code", "report"]
    assert stages_run(reproduced) == []


def stages_run(project) -> list[str]:
    return re.findall("Running stage '(.+)'", run_dvc("repro", cwd=project))


@pytest.mark.nightly
def test_a_killed_label_stage_continues_to_the_same_shards(tmp_path):
    """By day, tests/labels/run kills the same run without DVC around it."""
    from hdsp.labels.shards import read_shard, shard_paths

    more = ["labelling.splits.val.maps_per_category=3", "labelling.splits.val.maps_per_shard=3", "runtime.workers=1"]
    (tmp_path / "project").mkdir()
    project = clone_project(tmp_path / "project")
    run_python("pipeline.config", *more, cwd=project)
    run_python("pipeline.label", "val", f"runtime.outputs={tmp_path}", *more, cwd=project)
    undisturbed = {path.name: read_shard(path).tasks.arrays() for path in shard_paths(tmp_path / "data/labels/val")}

    folder = project / "data/labels/val"
    kept = kill_in_the_middle(project, folder, len(undisturbed))
    run_dvc("repro", "label@val", cwd=project)
    shards = {path.name: read_shard(path).tasks.arrays() for path in shard_paths(folder)}
    times = {path.name: path.stat().st_mtime_ns for path in shard_paths(folder)}
    assert {name: times[name] for name in kept} == kept, "finished shards were made again"
    assert set(shards) == set(undisturbed)
    for name, arrays in undisturbed.items():
        for key, array in arrays.items():
            np.testing.assert_array_equal(shards[name][key], array, err_msg=f"{name}: {key}")


def finished(folder) -> list:
    return [path for path in folder.rglob("*.h5") if not path.name.startswith(".")]


def kill_in_the_middle(project, folder, shards: int) -> dict[str, int]:
    """Kills the stage in `dvc repro label@val` between two shards; returns the finished shards with their times."""
    command, quiet = [sys.executable, "-m", "dvc", "repro", "label@val"], subprocess.DEVNULL
    dvc = subprocess.Popen(command, cwd=project, env=dvc_environment(), stdout=quiet, stderr=quiet)
    deadline = time.monotonic() + 120
    while not finished(folder):
        assert dvc.poll() is None, "the stage ended before its first shard"
        assert time.monotonic() < deadline
        time.sleep(0.02)
    stage = next(p for p in psutil.Process(dvc.pid).children(recursive=True) if "pipeline.label" in p.cmdline())
    stage.send_signal(signal.SIGKILL)
    assert dvc.wait(60) != 0
    done = {path.name: path.stat().st_mtime_ns for path in finished(folder)}
    assert len(done) < shards, "the stage had already finished; it has to be longer"
    return done

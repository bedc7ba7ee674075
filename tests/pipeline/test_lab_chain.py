"""`hdsp lab`: a package outside this repository, installed with hdsp in an environment of its own, from end to end."""

import json
import os
import shutil
import site
import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT
from tests.pipeline.conftest import copy_project

pytestmark = [pytest.mark.pipeline, pytest.mark.nightly, pytest.mark.xdist_group("lab")]

JUDGE = """
import sys, numpy as np, hdsp
source = "models/published/momaro"
costs = hdsp.load_abstraction(source)
assert not any(name.startswith(("hdsp_pipeline", "pipeline", "mlflow", "hydra")) for name in sys.modules)
plan = hdsp.Planner(hdsp.HeightMap.flat((120, 120)), heuristic=f"learned:{source}").plan((1, 1, 0), (1.5, 1.5, 0))
own = hdsp.Planner(hdsp.HeightMap.flat((120, 120)), heuristic="own_lab").plan((1, 1, 0), (1.5, 1.5, 0))
assert plan.solved and own.solved and own.cost <= plan.cost
heights, goals = np.zeros((1, 72, 72), np.float32), np.zeros((1, 22, 3), np.float32)
print(type(costs.network).__module__, costs.predict(heights, goals)[1].ravel().tolist())
"""
SERVED = """
import sys, numpy as np, mlflow
mlflow.set_tracking_uri("sqlite:///mlflow.db")
(run,) = mlflow.search_runs(experiment_names=["hdsp"], output_format="list")
model = mlflow.pyfunc.load_model(f"runs:/{run.info.run_id}/abstraction")
needed = mlflow.artifacts.load_text(model.metadata.get_model_info().artifact_path + "/requirements.txt").split()
assert {"hdsp", "own_lab"} <= {line.partition("=")[0] for line in needed}, needed
heights, goals = np.zeros((1, 72, 72), np.float32), np.zeros((1, 22, 3), np.float32)
assert model.predict({"heights": heights, "goals": goals})["cost"].shape == (1, 22)
import json
print(json.dumps([run.data.params, run.data.metrics]))
"""


class Lab:
    """A package that `hdsp lab` wrote, and the environment in which it is installed.

    Attributes:
        folder: the package.
        python: interpreter of the environment.
    """

    def __init__(self, place: Path):
        self.folder, environment = place / "own_lab", place / "environment"
        self.python = environment / "bin/python"
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
        (packages,) = environment.glob("lib/*/site-packages")
        lines = [f"import site; site.addsitedir({path!r})" for path in site.getsitepackages() if Path(path).is_dir()]
        (packages / "others.pth").write_text("\n".join(lines))
        self.install(copy_project(place / "hdsp"))
        for kernel in (ROOT / "hdsp").rglob("__pycache__/*.nb?"):
            target = packages / kernel.relative_to(ROOT)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(kernel, target)

    def install(self, *words: object) -> None:
        command = [sys.executable, "-m", "pip", "--python", self.python, "install", "--quiet", "--no-deps"]
        self.run(*command, "--no-build-isolation", "--disable-pip-version-check", *words, cwd=self.folder.parent)

    def run(self, *command: object, cwd: Path | None = None) -> str:
        """Output of a command in which nothing points to the checkout."""
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("DVC_", "MLFLOW_", "GIT_", "PYTHON"))}
        path = f"{self.python.parent}{os.pathsep}{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        environment |= {"PATH": path, "OMP_NUM_THREADS": "1", "MLFLOW_DISABLE_TELEMETRY": "true"}
        words = list(map(str, command))
        done = subprocess.run(words, cwd=cwd or self.folder, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}\n{done.stderr}"
        return done.stdout


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """The package after `make repro`, with the profile `tiny`."""
    place = tmp_path_factory.mktemp("outside")
    lab = Lab(place)
    lab.run(lab.python, "-m", "hdsp", "lab", "own_lab", cwd=place)
    lab.install("--editable", lab.folder)
    config = lab.folder / "conf/own_lab.yaml"
    config.write_text(config.read_text().replace("own_robot", "tiny"))
    return lab


def test_a_package_outside_trains_evaluates_plans_publishes_and_is_loaded(lab):
    said = lab.run("make", "repro")
    assert said.count("Running stage") == 7 and "largest weight" in said
    history = (lab.folder / "reports/training_history.csv").read_text()
    assert "false_feasible/val" in history.partition("\n")[0]
    labels = json.loads((lab.folder / "reports/labels/train.json").read_text())
    assert labels["maps_per_category"]["own_lab_posts"] > 0
    assert {"own_lab", "trained"} <= json.loads((lab.folder / "reports/planning.json").read_text())["summary"].keys()

    assert "Running stage" not in lab.run("make", "repro")
    code = lab.folder / "own_lab/learning.py"
    code.write_text(code.read_text() + "\n# A comment.\n")
    assert lab.run("make", "repro").count("Running stage") == 1, "the stage `code` alone"

    lab.run("make", "publish")
    assert lab.run(lab.python, "-c", JUDGE).startswith("own_lab.learning ")
    parameters, metrics = json.loads(lab.run(lab.python, "-c", SERVED).splitlines()[-1])
    assert (
        parameters["model.architecture"] == "own_lab" and parameters["trainer.loss._target_"] == "own_lab.learning.loss"
    )
    assert {"table 1/random/trained/feasibility_accuracy", "table 2/own_lab/W1.0/seconds_mean"} <= metrics.keys()
    assert 0 <= metrics["false_feasible/val"] <= 1


def test_its_own_tests_pass(lab):
    assert "2 passed" in lab.run("make", "test")

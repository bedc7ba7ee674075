"""The real entry points with tiny limits, each in its own process, as users start them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests import ROOT

SPLITS = ("train", "val", "random")
#: Options of `compact` for which the costs of a whole map take only seconds.
SMALL_NETWORK = {"widths": [4, 4], "blocks": [1, 1], "map_features": 4, "hidden": 16}
STAGES = ("published", "train", "evaluate", "plan", "report")


def run_python(*arguments: str, cwd: Path = ROOT, tracking: Path | None = None) -> subprocess.CompletedProcess:
    """Runs `python -m ...`; a failure reports the process's output."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MLFLOW_DISABLE_TELEMETRY": "true"}
    if tracking:
        environment["DVC_ROOT"] = str(tracking)  # the tracking database of the project stays untouched
    done = subprocess.run([sys.executable, "-m", *arguments], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(arguments)}\n{done.stdout}\n{done.stderr}"
    return done


@pytest.fixture(scope="session")
def labelled(tmp_path_factory) -> Path:
    """A folder with labels for the tiny profile."""
    folder = tmp_path_factory.mktemp("chain")
    for split in SPLITS:
        run_python("pipeline.label", split, *tiny(folder))
    run_python("pipeline.published", *tiny(folder))
    return folder


@pytest.fixture(scope="session")
def chain(labelled) -> Path:
    """The same folder after all stages."""
    network = [f"model.options.{name}={value}" for name, value in SMALL_NETWORK.items()]
    for stage in STAGES[1:]:
        run_python(f"pipeline.{stage}", *tiny(labelled), *(network if stage == "train" else []), tracking=labelled)
    return labelled


def tiny(folder: Path) -> list[str]:
    """Overrides for a chain of stages in one folder."""
    return ["profile=tiny", f"runtime.inputs={folder}", f"runtime.outputs={folder}", "runtime.workers=1"]


def dvc_environment() -> dict[str, str]:
    """Environment in which stages use this interpreter, but no surrounding DVC or tracking server."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("DVC_", "MLFLOW_", "GIT_"))}
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return environment | {"PATH": path, "OMP_NUM_THREADS": "1", "MLFLOW_DISABLE_TELEMETRY": "true"}


def run_dvc(*arguments: str, cwd: Path) -> str:
    """Runs a DVC command and returns its output."""
    command = [sys.executable, "-m", "dvc", *arguments]
    done = subprocess.run(command, cwd=cwd, env=dvc_environment(), capture_output=True, text=True)
    assert done.returncode == 0, f"dvc {' '.join(arguments)}\n{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


def clone_project(clone: Path) -> Path:
    """Clones the project's working tree with one commit, set to the tiny profile."""
    copy_project(clone)
    for source in (ROOT / "hdsp").rglob("__pycache__/*.nb?"):  # compiled kernels; their keys are their contents
        target = clone / source.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, target)
    network = yaml.safe_load((clone / "conf/model/compact.yaml").read_text())
    (clone / "conf/model/compact.yaml").write_text(yaml.safe_dump({**network, "options": SMALL_NETWORK}))
    config = (clone / "conf/config.yaml").read_text()
    (clone / "conf/config.yaml").write_text(config.replace("profile: small", "profile: tiny"))
    run_python("pipeline.config", cwd=clone)
    git("init", "--quiet", cwd=clone)
    git("add", "--all", cwd=clone)
    git("-c", "user.name=test", "-c", "user.email=test@example.org", "commit", "--quiet", "-m", "a clone", cwd=clone)
    return clone


def copy_project(folder: Path) -> Path:
    """Copies the files of the project's working tree that are in git, or will be."""
    for name in git("ls-files", "--cached", "--others", "--exclude-standard", cwd=ROOT).splitlines():
        source, target = ROOT / name, folder / name
        if not source.is_symlink() and not source.is_file():
            continue  # removed, but not committed yet
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, target, follow_symlinks=False)
    return folder


def git(*arguments: str, cwd: Path) -> str:
    return subprocess.run(["git", *arguments], cwd=cwd, capture_output=True, text=True, check=True).stdout

"""Faults of a training's surroundings are told in one line, before any work."""

import time

import pytest

from hdsp.base.errors import InputError
from pipeline import tracking
from pipeline.config import configure
from pipeline.side_by_side import side_by_side
from pipeline.stage import Folders
from pipeline.train import train


@pytest.fixture
def project(tmp_path, monkeypatch):
    import mlflow

    monkeypatch.setenv("DVC_ROOT", str(tmp_path))
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    yield tmp_path
    mlflow.set_tracking_uri(None)


def test_a_damaged_database_is_named(project):
    (project / "mlflow.db").write_text("no database" * 500)
    with pytest.raises(InputError, match=r"^cannot use MLflow at sqlite:.*mlflow\.db: file is not a database$"):
        tracking.connect()


def test_a_database_whose_creation_was_interrupted_is_made_again(project, monkeypatch):
    def interrupted(engine):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("mlflow.store.db.utils._upgrade_db", interrupted)  # the first tables are there already
        tracking.connect()
    assert not list(project.glob("mlflow.db*"))
    mlflow = tracking.connect()
    assert mlflow.get_experiment_by_name(tracking.EXPERIMENT) is not None
    assert [path.name for path in project.glob("*mlflow*db*")] == ["mlflow.db"]


def test_a_server_that_does_not_answer_is_named_soon_and_without_its_password(project, monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://me:secret@127.0.0.1:9")
    begun = time.monotonic()
    with pytest.raises(InputError, match=r"^cannot use MLflow at http://me:\*\*\*@127\.0\.0\.1:9: .*refused") as caught:
        tracking.connect()
    assert "\n" not in str(caught.value) and "secret" not in str(caught.value)
    assert time.monotonic() - begun < 60  # MLflow itself would try for minutes


@pytest.mark.parametrize("name", ["strategy", "precision"])
def test_names_that_lightning_does_not_know_are_told_before_the_labels_are_read(tmp_path, name):
    with pytest.raises(InputError, match=rf"^lightning: .*{name} foo.*: .*foo"):
        train(configure([f"runtime.lightning.{name}=foo"]), Folders(tmp_path, tmp_path))


def test_a_killed_process_of_a_stage_is_one_line():
    with pytest.raises(InputError, match=r"^a process of this stage was killed; out of memory"):
        side_by_side([_end, _end], 2)


def _end():
    import os
    import signal

    os.kill(os.getpid(), signal.SIGKILL)

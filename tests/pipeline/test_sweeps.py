"""Sweeps: every failed run is named, with any launcher; values are checked before the first run."""

import pytest

from hdsp.base.errors import InputError
from pipeline.command_line import parse, show
from pipeline.config import Source
from pipeline.stage import read_json, write_json
from pipeline.sweeps import checked_choices, sweep


def stage(config, folders):
    """Fails in three ways; otherwise leaves a report and has a value."""
    seed = config.trainer.seed
    if seed == 1:
        raise InputError("seed 1 is not liked")
    if seed == 2:
        raise ZeroDivisionError("by nothing")
    write_json(folders.write("report.json"), {"title": folders.title, "seed": seed})
    return float(seed)


def swept(tmp_path, *words: str) -> None:
    line = parse([*words, "-m", f"hydra.sweep.dir={tmp_path}"], "train")
    sweep(stage, "train", line, checked_choices(line))


def launchers():
    joblib = pytest.param("joblib", marks=pytest.mark.skipif(not has_joblib(), reason="no hydra-joblib-launcher"))
    return ["basic", joblib]


def has_joblib() -> bool:
    try:
        import hydra_plugins.hydra_joblib_launcher  # noqa: F401
    except ImportError:
        return False
    return True


@pytest.mark.parametrize("launcher", launchers())
def test_failed_runs_are_named_and_the_others_run(tmp_path, launcher):
    with pytest.raises(InputError) as caught:
        swept(tmp_path, "trainer.seed=0,1,2", "profile=tiny", f"hydra/launcher={launcher}")
    assert str(caught.value) == (
        "2 of 3 runs failed: run 1 (trainer.seed=1): seed 1 is not liked; "
        "run 2 (trainer.seed=2): ZeroDivisionError: by nothing"
    )
    assert read_json(tmp_path / "0/report.json") == {"title": "seed=0", "seed": 0}
    assert "trainer.seed=0" in (tmp_path / "0/.hydra/overrides.yaml").read_text()


@pytest.mark.parametrize("word", ["model=compact,nonsense", "trainer.optimizer.lr=interval(-1,1)"])
def test_a_wrong_value_anywhere_starts_no_run(tmp_path, word):
    with pytest.raises(InputError, match=r"Available options in 'model'|lr is -1"):
        swept(tmp_path, word)
    assert not list(tmp_path.iterdir())


def test_a_run_that_ends_its_process_is_named(tmp_path):
    def end(config, folders):
        raise SystemExit(1)

    line = parse(["trainer.seed=5", "-m", f"hydra.sweep.dir={tmp_path}"], "train")
    with pytest.raises(InputError, match=r"run 0 .*: its process ended before the run did"):
        sweep(end, "train", line, checked_choices(line))


def test_sets_without_a_plus_are_added_in_sweeps_and_shown_configurations_too(tmp_path, capsys):
    swept(tmp_path, "evaluation.sets.mine.tasks=x,y", "trainer.seed=4")
    assert read_json(tmp_path / "1/report.json") == {"title": "tasks=y", "seed": 4}
    capsys.readouterr()
    words = ["evaluation.sets.mine.tasks=x", "--cfg", "job", "--package", "evaluation.sets.mine"]
    show("train", (), parse(words, "train"))
    assert "tasks: x" in capsys.readouterr().out


def test_words_of_a_command_are_told_apart(tmp_path):
    line = parse(["train", "a=1", "--config-dir", str(tmp_path), "--config-name=mine", "-m", "~b"], "label", ["split"])
    assert (line.arguments, line.overrides, line.sweep) == (("train",), ("a=1", "~b"), True)
    assert line.source == Source(tmp_path, "mine")
    assert parse(["--cfg", "job", "--info", "searchpath"], "label", ["split"]).flags == (
        "--cfg", "job", "--info", "searchpath",
    )  # fmt: skip
    with pytest.raises(InputError, match="unknown option --nonsense; usage: "):
        parse(["--nonsense"], "train")
    with pytest.raises(InputError, match=r"no mine.yaml in "):
        line.source.primary()

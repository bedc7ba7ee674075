"""Damaged settings, by the seed: each gives settings, or one line; never a traceback."""

import numpy as np
import pytest
import yaml

from hdsp.base.errors import InputError
from hdsp.robot.robot import Robot
from tests import ROOT
from tests.base.mutations import mutated_file


def outcome(load, *arguments):
    """What loading gives, or the line that it ends with."""
    try:
        return load(*arguments)
    except InputError as error:
        assert len(str(error).splitlines()) == 1 and str(error), repr(error)
        return str(error)


@pytest.mark.parametrize("preset", Robot.presets())
def test_robot_files(preset, tmp_path):
    text = (ROOT / f"hdsp/robot/presets/{preset}.yaml").read_bytes()
    values, path = yaml.safe_load(text), tmp_path / "own.yaml"
    outcomes = []
    for seed in range(200):
        path.write_bytes(mutated_file(values, text, np.random.default_rng(seed)))
        outcomes.append(outcome(Robot.load, path))
    refused = [found for found in outcomes if isinstance(found, str)]
    assert all(found.startswith(str(path)) for found in refused)
    assert all(len(robot.hash()) == 64 for robot in outcomes if isinstance(robot, Robot))
    assert 100 < len(refused) < 200  # damage is noticed, and comments may be

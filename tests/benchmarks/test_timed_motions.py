"""The benchmark of motions with times: its measures find what is wrong, and its table is on the page."""

import dataclasses
import shutil
from pathlib import Path

import numpy as np

from benchmarks import timed_motions
from hdsp.robot.robot import Robot
from tests import ROOT

PAGE = ROOT / "docs" / "motions.md"


def test_motions_keep_their_limits_and_the_page_says_so(tmp_path):
    copy = Path(shutil.copy(PAGE, tmp_path))
    result = timed_motions.main(["--plans", "2", "--page", str(copy)])
    assert result["plans"] == 2 and result["configurations"] > 100
    assert result["speed_over"] == result["acceleration_over"] == result["unstable"] == result["problems"] == 0
    assert f"| mean duration (s) | {result['mean_duration_s']} |" in copy.read_text()


class Faster:
    """A motion that says it belongs to a slower robot."""

    def __init__(self, motion, robot):
        self._motion, self.robot = motion, robot

    def __getattr__(self, name):
        return getattr(self._motion, name)


def test_excesses_and_unstable_states_are_found():
    motion, _ = next(timed_motions.motions(0))
    values = motion.robot.to_dict()
    for part in ("speeds", "accelerations"):
        slower = Robot.load(values | {part: {key: 0.8 * value for key, value in values[part].items()}})
        over = timed_motions.excesses(Faster(motion, slower), 100)
        assert abs(over[part == "accelerations"] - 0.25) < 0.01
    aside = motion.base + np.array([0, 0.3, 0.6, 0, 0, 0])
    unstable, words = timed_motions.findings(dataclasses.replace(motion, base=aside), 20)
    assert unstable > 0 and words

"""Two processes that share a batch train as one process with the whole batch."""

import json
import subprocess
import sys

import pytest

from tests import ROOT
from tests.learning.ddp_training import main


def test_two_processes_have_the_metrics_of_one(tmp_path):
    main(1, str(tmp_path / "one"))
    command = [sys.executable, "-m", "tests.learning.ddp_training", "2", str(tmp_path / "two")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    one, two = (json.loads((tmp_path / name / "history.json").read_text()) for name in ("one", "two"))
    assert len(one) == len(two) == 2
    for alone, shared in zip(one, two, strict=True):
        for name in alone.keys() - {"seconds"}:
            assert shared[name] == pytest.approx(alone[name], abs=1e-4), name

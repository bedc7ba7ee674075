"""Two processes that share a batch train as one process with the whole batch."""

import json
import subprocess
import sys

import pytest
import torch
import torch.distributed as dist

from hdsp.learning.processes import _meeting_place
from tests import ROOT
from tests.learning.ddp_training import main


def test_two_processes_have_the_metrics_of_one(tmp_path):
    main(1, str(tmp_path / "one"))
    command = [sys.executable, "-m", "tests.learning.ddp_training", "2", str(tmp_path / "two")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    one, two = (json.loads((tmp_path / name / "history.json").read_text()) for name in ("one", "two"))
    assert len(one) == len(two) == 2
    assert "mean_cost/val" in one[0]
    for alone, shared in zip(one, two, strict=True):
        for name in alone.keys() - {"seconds"}:
            assert shared[name] == pytest.approx(alone[name], abs=1e-4), name


def test_sums_meet_on_the_graphics_card_where_the_backend_adds_none_on_the_processor(monkeypatch):
    cpu = torch.device("cpu")
    for backend, place in (("gloo", cpu), ("nccl", torch.device("cuda"))):
        monkeypatch.setattr(dist, "get_backend", lambda backend=backend: backend)
        assert _meeting_place(cpu) == place

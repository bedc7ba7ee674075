"""`torch.compile` with its default backend on every model of conf/model, as `runtime.lightning.compile=true` asks."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from hdsp.learning import train
from tests.learning.synthetic import synthetic_tasks, tiny_config
from tests.learning.test_zoo import MODELS, model_file

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(shutil.which("g++") is None, reason="inductor, the default backend, needs a C++ compiler"),
]


@pytest.mark.parametrize("name", MODELS)
def test_a_compiled_network_trains_as_it_does_without(name, tmp_path):
    tasks, found = synthetic_tasks(4), []
    tasks = replace(tasks, planning_cost=tasks.cost.astype(np.float32))
    for compiled in (False, True):
        torch._dynamo.reset()
        config = tiny_config(epochs=1, batch={"by": "map", "size": 2}) | {"lightning": {"compile": compiled}}
        config["model"] = model_file(name)
        result = train(config, tasks, {"val": tasks}, tmp_path / str(compiled), quiet=True)
        found.append(result.metrics)
    for key in ("loss/feasibility", "loss/cost"):
        assert found[1][key] == pytest.approx(found[0][key], rel=1e-3), key

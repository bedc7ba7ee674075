"""Each shipped architecture as an ONNX model: its outputs agree with those in torch."""

import numpy as np
import pytest
import torch

from hdsp.base.errors import InputError
from hdsp.learning import LearnedAbstraction, Provenance
from hdsp.learning.loading import load_abstraction, presets
from hdsp.learning.networks import build_network
from hdsp.learning.onnx_export import export_onnx
from hdsp.robot.lattice import robot_frame_goals
from hdsp.robot.robot import Robot
from pipeline.config import CONF, configure
from tests.learning.synthetic import synthetic_tasks

MODELS = sorted(path.stem for path in (CONF / "model").glob("*.yaml"))


@pytest.fixture(scope="module")
def tasks():
    """Patches with obstacles and unknown cells, and goals at another heading."""
    tasks = synthetic_tasks(3)
    heights = tasks.heights.copy()
    heights[:, 30:36, 50:60] = np.nan
    return heights, np.broadcast_to(robot_frame_goals(3).astype(np.float32), (3, 22, 3))


def outputs(path, heights, goals):
    import onnxruntime

    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return session.run(None, {"patches": heights, "goals": np.ascontiguousarray(goals)})


@pytest.mark.parametrize("name", MODELS)
def test_the_outputs_agree_with_those_in_torch(name, tasks, tmp_path):
    pytest.importorskip("onnx")
    torch.manual_seed(3)
    settings = configure([f"model={name}"]).model
    abstraction = LearnedAbstraction(build_network(settings), settings, Provenance.of(Robot.load("momaro")))
    path = export_onnx(abstraction, tmp_path / "model.onnx")
    heights, goals = tasks
    for count, number in ((3, 22), (1, 5)):
        patches, chosen = heights[:count], goals[:count, :number]
        probability, cost, *planning = outputs(path, patches, chosen)
        expected = abstraction.predict_probability(patches, chosen)
        np.testing.assert_allclose(probability, expected[0], atol=2e-5)
        np.testing.assert_allclose(cost, expected[1], rtol=1e-4, atol=2e-5)
        assert len(planning) == abstraction.predicts_planning_cost
        if planning:
            _, expected_planning = abstraction.for_planning().predict(patches, chosen)
            np.testing.assert_allclose(planning[0], expected_planning, rtol=1e-4, atol=2e-5)


def test_the_network_itself_stays_as_it_is(tasks, tmp_path):
    pytest.importorskip("onnx")
    settings = configure(["model=compact"]).model
    abstraction = LearnedAbstraction(build_network(settings), settings)
    before = abstraction.predict(*tasks)
    abstraction.network.double()
    export_onnx(abstraction, tmp_path / "model.onnx")
    assert {value.dtype for value in abstraction.network.parameters()} == {torch.float64}
    abstraction.network.float()
    for found, expected in zip(abstraction.predict(*tasks), before, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_shipped_abstractions_keep_calibration_and_robot(tasks, tmp_path):
    onnx = pytest.importorskip("onnx")
    abstraction = load_abstraction(presets()[0])
    path = export_onnx(abstraction, tmp_path / "model.onnx")
    known = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    assert known["robot"] == abstraction.provenance.robot and known["robot_hash"]
    probability, cost, *_ = outputs(path, *tasks)
    expected = abstraction.predict_probability(*tasks)
    np.testing.assert_allclose(probability, expected[0], atol=0.02)  # the engine has layers of 8 bits
    np.testing.assert_allclose(cost, expected[1], rtol=0.05)
    assert abstraction.calibration.temperature != 1


def test_without_the_package_and_with_another_suffix_one_line_says_so(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    with pytest.raises(InputError, match=r"^ONNX export needs the package onnx: pip install 'hdsp\[export\]'$"):
        export_onnx(load_abstraction("momaro"), tmp_path / "model.onnx")
    with pytest.raises(InputError, match=r"suffix '\.bin'; need \.onnx"):
        export_onnx(load_abstraction("momaro"), tmp_path / "model.bin")

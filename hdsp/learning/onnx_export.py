"""Trained abstractions as ONNX files, for programs without torch and without this package."""

from __future__ import annotations

import io
import json
import logging
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from hdsp.base.errors import InputError
from hdsp.base.files import replacing, writable_file
from hdsp.base.quiet import quiet_thread
from hdsp.learning.calibration import MINIMUM_COST
from hdsp.robot.lattice import PATCH_CELLS, robot_frame_goals

if TYPE_CHECKING:
    from hdsp.learning.abstraction import LearnedAbstraction

_OPSET = 17
#: Largest difference, in abstract steps, between a goal and one that is infeasible on flat ground.
_TOLERANCE = 1e-3


def export_onnx(abstraction: LearnedAbstraction, path: str | Path) -> Path:
    """Writes an abstraction as an ONNX model.

    Inputs are ``patches``, float32 [n, 72, 72], m, NaN = unknown, and ``goals``, float32 [n, G, 3], in abstract steps,
    both as for ``LearnedAbstraction.predict``. Outputs are ``probability`` and ``cost``, float32 [n, G], as from
    ``predict_probability``, and ``planning_cost`` if the network predicts it. Any n and G are allowed; the network
    ``table`` alone does not report foreign goals. The model's metadata hold robot, lattice and provenance
    as JSON.

    Raises:
        InputError: the package ``onnx`` is not installed, or the file cannot be written.
    """
    path = writable_file(path, "ONNX model", (".onnx",))
    try:
        import onnx
    except ImportError as error:
        raise InputError("ONNX export needs the package onnx: pip install 'hdsp[export]'") from error
    model = onnx.load_model_from_string(_traced(_Judging(abstraction).eval()))
    for name, value in _metadata(abstraction).items():
        model.metadata_props.add(key=name, value=value)
    with replacing(path) as temporary:
        temporary.write_bytes(model.SerializeToString())
    return path


class _Judging(nn.Module):
    """The network with its calibration: probabilities and costs of an abstraction."""

    never: Tensor

    def __init__(self, abstraction: LearnedAbstraction):
        super().__init__()
        self.network = deepcopy(abstraction.network).float().cpu()  # both work in place
        self.temperature = abstraction.calibration.temperature
        never = torch.tensor(abstraction.provenance.never_feasible, dtype=torch.float32).reshape(-1, 3)
        self.register_buffer("never", never, persistent=False)

    def forward(self, patches: Tensor, goals: Tensor) -> tuple[Tensor, ...]:
        cost, logits, *planning = self.network(patches[:, None], goals)
        probability = torch.sigmoid(logits / self.temperature)
        if len(self.never):
            near = (goals[..., None, :] - self.never).abs().amax(-1) < _TOLERANCE
            probability = torch.where(near.any(-1), 0.0, probability)
        cost = cost.clamp_min(MINIMUM_COST)
        if not planning:
            return probability, cost
        return probability, cost, torch.minimum(planning[0], cost).clamp_min(MINIMUM_COST)


def _traced(judging: _Judging) -> bytes:
    """The model as a protocol buffer, traced on two flat patches."""
    goals = torch.tensor(robot_frame_goals(0), dtype=torch.float32).expand(2, -1, -1)
    patches = torch.zeros(2, PATCH_CELLS, PATCH_CELLS)
    outputs = ["probability", "cost", "planning_cost"][: 3 if judging.network.predicts_planning_cost else 2]
    both = {0: "n", 1: "goals"}
    axes = {"patches": {0: "n"}, "goals": both, **dict.fromkeys(outputs, both)}
    for name, symbolic in (("expm1", _expm1), ("fmin", _fmin)):
        torch.onnx.register_custom_op_symbolic(f"aten::{name}", symbolic, _OPSET)
    file, log = io.BytesIO(), logging.getLogger("torch.onnx")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        # The exporter by tracing, of which torch warns, needs one package instead of three.
        with quiet_thread(), torch.no_grad():
            torch.onnx.export(
                judging,
                (patches, goals),
                file,  # type: ignore[arg-type]
                dynamo=False,
                opset_version=_OPSET,
                input_names=["patches", "goals"],
                output_names=outputs,
                dynamic_axes=axes,
            )
    finally:
        log.setLevel(level)
    return file.getvalue()


def _metadata(abstraction: LearnedAbstraction) -> dict[str, str]:
    from hdsp.learning.saved_abstraction import lattice_contract

    provenance = abstraction.provenance
    values: dict[str, Any] = {
        "robot": provenance.robot,
        "robot_hash": provenance.robot_hash,
        "cost_model_version": provenance.cost_model_version,
        "architecture": abstraction.model.architecture,
        "edges_threshold": abstraction.edges_threshold,
        "lattice": lattice_contract(),
    }
    return {name: value if isinstance(value, str) else json.dumps(value) for name, value in values.items()}


def _expm1(graph: Any, values: Any) -> Any:
    return graph.op("Sub", graph.op("Exp", values), graph.op("Constant", value_t=torch.tensor(1.0)))


def _fmin(graph: Any, one: Any, other: Any) -> Any:
    """The smaller value; the other one where one of them is NaN."""
    least = graph.op("Where", graph.op("IsNaN", other), one, graph.op("Min", one, other))
    return graph.op("Where", graph.op("IsNaN", one), other, least)

"""Conformance checker for networks: does an own ``TaskNetwork`` keep the contract?

from hdsp.learning import check_network

check_network(MyNetwork(HeightEncoding(), MyOptions()))
"""

from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from safetensors.torch import load as load_tensors
from safetensors.torch import save as tensor_bytes
from torch import Tensor, nn

from hdsp.base.conformance import Contract
from hdsp.base.errors import InputError
from hdsp.learning.encoding import encode
from hdsp.learning.learning_settings import HeightEncoding
from hdsp.learning.networks.base import TaskNetwork
from hdsp.robot.lattice import PATCH_CELLS, robot_frame_goals
from hdsp.terrain.scenes import random_map

#: The rules of the contract `TaskNetwork`.
RULES = {
    "parts": "a network has an encoding (HeightEncoding) and heads (nn.Linear)",
    "outputs": "forward returns cost, logits and, with predicts_planning_cost, costs for planning, float [B, G] each",
    "finite": "outputs are finite, with unknown cells too",
    "trunk": "map_part returns [B, F], and forward is goal_part of it in float32",
    "determinism": "in evaluation mode the same tasks have the same outputs",
    "input": "heights and goals stay unchanged",
    "goals apart": "the outputs of a goal depend neither on other goals nor on their order",
    "patches apart": "in evaluation mode the outputs of a patch do not depend on other patches",
    "dense": "where is_dense(), dense evaluation gives the features of each patch alone",
    "saved": "the state dict is all that training changes: loaded into another network, it gives the same outputs",
    "gradients": "in training mode finite gradients reach all parameters",
}


def check_network(
    network: TaskNetwork, heights: np.ndarray | None = None, goals: np.ndarray | None = None, *, tolerance: float = 1e-4
) -> tuple[str, ...]:
    """Checks whether a network keeps its contract.

    The CPU evaluates copies of the network; the network itself stays unchanged. Every rule is checked on samples, so
    success is evidence but no proof.

    Args:
        network: implementation, with initial or trained weights.
        heights: float32 [n, 72, 72], n >= 2, patches in metres, NaN = unknown; None = patches from random terrain, one
            of them with unknown cells.
        goals: float32 [G, 3], G >= 2, goals in abstract steps in the robot frame; None = the 22 abstract actions.
        tolerance: largest difference between two evaluations of a task in batches with different sizes.

    Returns:
        Names of the checked rules, keys in ``RULES``.

    Raises:
        ConformanceError: a rule is broken.
        InputError: patches or goals have another shape.
    """
    contract = Contract("TaskNetwork", RULES)
    patches, tasks = _tensors(heights, goals)
    _check_parts(contract, network)
    network = deepcopy(network).cpu().eval()
    with torch.inference_mode():
        expected = _check_outputs(contract, network, patches, tasks)
        _check_trunk(contract, network, patches, tasks, expected)
        _check_independence(contract, network, patches, tasks, expected, tolerance)
        if network.is_dense():
            _check_dense(contract, network, tolerance)
        _check_saved(contract, network, patches, tasks, expected)
    _check_gradients(contract, network, patches, tasks)
    return contract.checked


def _tensors(heights: np.ndarray | None, goals: np.ndarray | None) -> tuple[Tensor, Tensor]:
    """Patches [n, 1, 72, 72] and goals [n, G, 3]."""
    if heights is None:
        categories = ("clutter", "cuboid_2", "staircase")
        heights = np.stack([random_map(0, category, 0).heights for category in categories])
        heights[0, 50:, :20] = np.nan
        heights[0, 36, 36] = np.nan
    goals = robot_frame_goals(1) if goals is None else np.asarray(goals, np.float32)
    heights = np.asarray(heights, np.float32)
    if heights.shape[1:] != (PATCH_CELLS, PATCH_CELLS) or len(heights) < 2:
        raise InputError(f"heights: shape {heights.shape}; need at least two patches of {PATCH_CELLS} x {PATCH_CELLS}")
    if goals.ndim != 2 or goals.shape[1] != 3 or len(goals) < 2:
        raise InputError(f"goals: shape {goals.shape}; need at least two goals (dx, dy, dtheta)")
    return torch.from_numpy(heights)[:, None], torch.from_numpy(goals).repeat(len(heights), 1, 1)


def _check_parts(contract: Contract, network: TaskNetwork) -> None:
    contract.require("parts", isinstance(network, TaskNetwork), f"{type(network).__name__} is no TaskNetwork")
    for name, kind in (("encoding", HeightEncoding), ("heads", nn.Linear)):
        part = getattr(network, name, None)
        contract.require("parts", isinstance(part, kind), f"{name} is of type {type(part).__name__}")


def _check_outputs(contract: Contract, network: TaskNetwork, patches: Tensor, goals: Tensor) -> np.ndarray:
    """Checks the answers; returns them, float32 [2 or 3, B, G]."""
    given = patches.clone(), goals.clone()
    outputs = network(*given)
    contract.require_equal("input", given[0].numpy(), patches.numpy(), "heights after a call")
    contract.require_equal("input", given[1].numpy(), goals.numpy(), "goals after a call")
    count = 3 if network.predicts_planning_cost else 2
    _check_kind(contract, outputs, goals, count)
    _check_kind(contract, network(patches[:1], goals[:1, :1]), goals[:1, :1], count)
    expected = _array(outputs)
    contract.require_equal("determinism", _array(network(patches, goals)), expected, "outputs when asked again")
    unknown = torch.full_like(patches[:1], torch.nan)
    for words, values in (("of the patches", expected), ("of unknown ground", _array(network(unknown, goals[:1])))):
        contract.require(
            "finite", np.isfinite(values).all(), f"outputs {words} hold {values[~np.isfinite(values)][:1]}"
        )
    return expected


def _check_kind(contract: Contract, outputs: object, goals: Tensor, count: int) -> None:
    kinds = isinstance(outputs, tuple) and len(outputs) == count and all(isinstance(out, Tensor) for out in outputs)
    contract.require("outputs", kinds, f"{type(outputs).__name__} instead of {count} tensors")
    assert isinstance(outputs, tuple)
    for output in outputs:
        found = f"{output.dtype} {tuple(output.shape)} for goals {tuple(goals.shape)}"
        contract.require("outputs", output.is_floating_point() and output.shape == goals.shape[:2], found)


def _array(outputs: tuple[Tensor, ...]) -> np.ndarray:
    return torch.stack(outputs).float().numpy()


def _check_trunk(
    contract: Contract, network: TaskNetwork, patches: Tensor, goals: Tensor, expected: np.ndarray
) -> None:
    features = network.map_part(encode(network.encoding, patches))
    found = f"map_part returns {tuple(features.shape)} for {len(patches)} patches"
    contract.require("trunk", features.ndim == 2 and len(features) == len(patches), found)
    outputs = _array(network.goal_part(features.float(), goals))
    contract.require_equal("trunk", outputs, expected, "goal_part of map_part")


def _check_independence(
    contract: Contract, network: TaskNetwork, patches: Tensor, goals: Tensor, expected: np.ndarray, tolerance: float
) -> None:
    order = torch.arange(goals.shape[1]).flip(0)
    outputs = _array(network(patches, goals[:, order]))[:, :, order.numpy()]
    contract.require_equal("goals apart", outputs, expected, "outputs of the goals in reverse", tolerance)
    for goal in (0, goals.shape[1] - 1):
        outputs = _array(network(patches, goals[:, goal : goal + 1]))[:, :, 0]
        contract.require_equal("goals apart", outputs, expected[:, :, goal], f"outputs of goal {goal} alone", tolerance)
    for patch in range(len(patches)):
        outputs = _array(network(patches[patch : patch + 1], goals[patch : patch + 1]))[:, 0]
        contract.require_equal(
            "patches apart", outputs, expected[:, patch], f"outputs of patch {patch} alone", tolerance
        )


def _check_dense(contract: Contract, network: TaskNetwork, tolerance: float) -> None:
    """Compares windows into a map with features from patches cut at the same cells."""
    trunk = network.dense_trunk()
    contract.require("dense", trunk is not None, "dense_trunk() is None")
    assert trunk is not None
    corners = torch.tensor([(0, 0), (5, 2), (8, 9)])
    margin = trunk.margin
    heights = torch.from_numpy(random_map(1, "clutter", 0, cells=PATCH_CELLS + 9 + 2 * margin).heights.copy())
    heights[margin + 20, margin + 40] = torch.nan
    inner = heights[margin:, margin:]
    patches = torch.stack([inner[x : x + PATCH_CELLS, y : y + PATCH_CELLS] for x, y in corners.tolist()])[:, None]
    alone = network.map_part(encode(network.encoding, patches)).float()
    found = trunk.windows(trunk(encode(network.encoding, heights[None, None])), corners).float()
    contract.require_equal("dense", found.numpy(), alone.numpy(), "features of dense evaluation", tolerance)


def _check_saved(
    contract: Contract, network: TaskNetwork, patches: Tensor, goals: Tensor, expected: np.ndarray
) -> None:
    for name, module in network.named_modules():
        for key, value in _loose_tensors(module):
            contract.require(
                "saved", False, f"{name or 'network'}.{key} {tuple(value.shape)} is no parameter or buffer"
            )
    weights = tensor_bytes({key: value.contiguous() for key, value in network.state_dict().items()})
    other = deepcopy(network)
    for value in other.state_dict().values():
        value.copy_(torch.rand_like(value) if value.is_floating_point() else torch.zeros_like(value))
    other.load_state_dict(load_tensors(weights))
    contract.require_equal("saved", _array(other(patches, goals)), expected, "outputs of a loaded network")


def _loose_tensors(module: nn.Module) -> Iterator[tuple[str, Tensor]]:
    """Tensors in plain attributes, directly or within a container."""
    for key, value in vars(module).items():
        if key.startswith("_") and key in vars(nn.Module()):  # torch's parameters, buffers and modules
            continue
        contained: Any = value.values() if isinstance(value, dict) else value
        for item in contained if isinstance(value, (list, tuple, dict)) else [value]:
            if isinstance(item, Tensor):
                yield key, item


def _check_gradients(contract: Contract, network: TaskNetwork, patches: Tensor, goals: Tensor) -> None:
    waiting = {name for name, parameter in network.named_parameters() if parameter.requires_grad}
    random = torch.Generator().manual_seed(0)
    for offset, noise in ((0.0, 0.0), (0.01, 0.0), (0.0, 0.02), (0.01, 0.1)):
        # With some random weights, all rectifiers are closed or a last layer is zero.
        trial = deepcopy(network).train()
        with torch.no_grad():
            for parameter in trial.parameters():
                parameter.add_(offset + noise * torch.randn(parameter.shape, generator=random))
        torch.stack(trial(patches, goals)).square().sum().backward()
        for name, parameter in trial.named_parameters():
            if parameter.grad is not None:
                finite = parameter.grad.isfinite().all()
                contract.require("gradients", finite, f"gradient of {name} of norm {float(parameter.grad.norm())}")
                if parameter.grad.any():
                    waiting.discard(name)
        if not waiting:
            break
    contract.require("gradients", not waiting, f"no gradient reaches {', '.join(sorted(waiting))}")

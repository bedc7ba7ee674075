"""Layers of the footprint network without torch: convolutions at cells, and products of matrices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from hdsp.base.errors import InputError
from hdsp.learning.footprint_geometry import (
    CONTEXT_STEP,
    FEET,
    GOAL_FEATURES,
    LINE,
    LINE_RADIUS,
    NEAR_RADIUS,
    POSE_FEATURES,
    PROFILE,
    REACH,
    REQUIREMENT_FEATURES,
    SAMPLES,
    FootprintOptions,
)
from hdsp.learning.inference.cell_layer import Layer
from hdsp.learning.inference.dense_layers import Graph
from hdsp.learning.inference.pose_table import square
from hdsp.learning.saved_abstraction import WEIGHTS

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

#: Pose features are stored in rows of a multiple of this.
_ALIGNED = 16


class FootprintLayers:
    """Weights of a footprint network, and the layers made of them.

    Args:
        options: options of the network.
        channels: channels of the first convolution.
        tensors: the weights, by their names in the network.

    Attributes:
        weights: float32, by name.
        features: features of a pose, with trailing zeros.
        near, line, local: convolutions: the first one, of features along a foot's line, and those after the first.

    Raises:
        InputError: a weight is missing, or has another shape.
    """

    def __init__(self, options: FootprintOptions, channels: int, tensors: Mapping[str, np.ndarray]):
        self.options, self.weights = options, _checked(tensors, _shapes(options, channels))
        self.features = -(-(options.features + POSE_FEATURES) // _ALIGNED) * _ALIGNED
        names = [f"local.{2 * k}" for k in range(len(options.dilations))]
        self.near, self.line, *self.local = (
            Layer(*self._convolution(name)) for name in ("near.0", "of_line.0", *names)
        )

    @property
    def ground_features(self) -> int:
        """Features of the ground under a footprint."""
        return self.weights["of_ground.weight"].shape[1]

    def _linear(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Weight [in, out] and bias of a linear layer."""
        return self.weights[f"{name}.weight"].T, self.weights[f"{name}.bias"]

    def _convolution(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Weight [in, out] and bias of a convolution; rows are in the order of ``gather``: by x, by y, by channel."""
        weight = self.weights[f"{name}.weight"]
        return weight.transpose(2, 3, 1, 0).reshape(-1, len(weight)), self.weights[f"{name}.bias"]

    def of_pose(self, code: float | None) -> InferenceSession:
        """Makes the layers of a pose: ``local``, ``ground`` -> features; ``code`` is the value of a code, if any."""
        of_local, bias = self._convolution("of_local")
        graph = Graph(["local", "ground"] if code is None else ["ground"], "result", ["local"][code is None :])
        ground = graph.linear("ground", "of ground", self.weights["of_ground.weight"].T, bias, relu=False)
        hidden = graph.operation("Add", [graph.product("local", "of local", of_local, code), ground], "sum")
        graph.linear(graph.operation("Relu", [hidden], "hidden"), "result", *self._linear("footprint"))
        return graph.session()

    def _of_ways(self) -> tuple[list[np.ndarray], np.ndarray]:
        """Weights of the first judging layer: of start and samples of a way, and of everything else."""
        seen = self.options.features + POSE_FEATURES
        *ways, rest = np.split(self.weights["rest.0.weight"].T, [seen * k for k in range(1, SAMPLES + 3)])
        # The mean over a way is a part of each of its samples; its greatest features are a sample more.
        mean = ways[SAMPLES] / np.float32(SAMPLES)
        return [self._padded(way) for way in (*(way + mean for way in ways[:SAMPLES]), ways[SAMPLES + 1])], rest

    @property
    def of_goal(self) -> np.ndarray:
        """Weight of a goal's features in the first judging layer, [goal features, head]."""
        return self._of_ways()[1][self.options.context + self.options.feet :]

    @property
    def of_step_goal(self) -> np.ndarray:
        """Weight of a goal's features in the layer that judges the feet's ways, [goal features, steps]."""
        if self.options.foot_ways is None:
            return np.zeros((GOAL_FEATURES, 0), np.float32)
        return self.weights["steps.0.weight"].T[-GOAL_FEATURES:]

    def of_start(self) -> InferenceSession:
        """Makes the layers of a start: ``context rows``, ``feet rows``, ``start`` -> its part in the first layer."""
        options, linear, (ways, rest) = self.options, self._linear, self._of_ways()
        seen = options.features + POSE_FEATURES
        of_context, bias = linear("context")
        of_context = self._padded(of_context.reshape(-1, seen, options.context)).reshape(-1, options.context)
        graph = Graph(["context rows", "feet rows", "start"], "result")
        context = graph.linear("context rows", "context", of_context, bias)
        feet = graph.linear("feet rows", "feet", *linear("feet"))
        known = graph.operation("Concat", ["start", context, feet], "known", axis=1)
        of_known = np.concatenate([ways[0], rest[: options.context + options.feet]])
        graph.linear(known, "result", of_known, self.weights["rest.0.bias"], relu=False)
        return graph.session()

    def of_goals(self) -> InferenceSession:
        """Makes the layers of a start's goals: ``rows``, ``start``, ``goals`` -> judgements.

        With foot ways, further inputs are ``foot ways`` and ``goals of steps``.
        """
        linear, steps = self._linear, ["foot ways", "goals of steps"] if self.options.foot_ways else []
        graph = Graph(["rows", "start", "goals", *steps], "result")
        of_ways = graph.constant("of ways", np.concatenate(self._of_ways()[0][1:]))
        shape = graph.operation("Shape", ["goals"], "goals shape")
        shape = graph.operation("Concat", [graph.constant("bases", np.array([-1])), shape], "shape", axis=0)
        way = graph.operation("Reshape", [graph.operation("Gemm", ["rows", of_ways], "ways"), shape], "ways by base")
        start = graph.operation("Unsqueeze", ["start", graph.constant("axis", np.array([1]))], "start by base")
        way = graph.operation("Add", [way, start], "ways with start")
        way = graph.operation("Add", [way, "goals"], "ways with goals")
        flat = graph.constant("flat", np.array([-1, self.options.head]))
        first = graph.operation("Relu", [graph.operation("Reshape", [way, flat], "rows of ways")], "first")
        judged = graph.linear(first, "second", *linear("rest.2"))
        if steps:
            judged = graph.operation("Concat", [judged, self._judged_steps(graph, judged)], "all judged", axis=1)
        graph.linear(judged, "result", *linear("heads"), relu=False)
        return graph.session()

    def _judged_steps(self, graph: Graph, judged: str) -> str:
        """Adds the layers that judge the feet's ways; returns their output's name."""
        weight, bias = self._linear("steps.0")
        half = self.options.head // 2
        of_judged = graph.linear(judged, "judged of steps", weight[:half], bias, relu=False)
        of_ways = graph.product("foot ways", "ways of steps", weight[half : half + self.options.way_features])
        sums = graph.operation("Add", [of_judged, of_ways], "steps sum")
        shape = graph.operation("Shape", ["goals of steps"], "steps of goals")
        by_base = graph.constant("steps bases", np.array([-1]))
        shape = graph.operation("Concat", [by_base, shape], "steps shape", axis=0)
        sums = graph.operation("Reshape", [sums, shape], "steps by base")
        sums = graph.operation("Add", [sums, "goals of steps"], "steps with goals")
        flat = graph.constant("steps flat", np.array([-1, self.options.steps]))
        first = graph.operation("Relu", [graph.operation("Reshape", [sums, flat], "steps rows")], "steps first")
        return graph.linear(first, "steps second", *self._linear("steps.2"))

    def _padded(self, weight: np.ndarray) -> np.ndarray:
        """Adds zeros for the trailing zeros of pose features, along the axis before the last."""
        missing = self.features - weight.shape[-2]
        return np.pad(weight, [(0, 0)] * (weight.ndim - 2) + [(0, missing), (0, 0)])


def _shapes(options: FootprintOptions, channels: int) -> dict[str, tuple[int, ...]]:
    """Shapes of all weights and biases."""
    width, hidden, features, head = options.width, options.hidden, options.features, options.head
    taps = options.taps[0] * options.taps[1]
    near, line = 2 * NEAR_RADIUS + 1, 2 * LINE_RADIUS + 1
    seen = features + POSE_FEATURES
    of_feet = len(FEET) * (len(LINE) * width + 2 * len(PROFILE) + PROFILE[-1] - PROFILE[0] + 1)
    way = (SAMPLES + 2) * seen + options.context + options.feet + GOAL_FEATURES
    judged, ways = head // 2, {}
    if options.foot_ways:
        ways = {"steps.0": (options.steps, judged + options.way_features + GOAL_FEATURES)}
        ways["steps.2"] = (options.steps, options.steps)
        judged += options.steps
    weights: dict[str, tuple[int, ...]] = {
        "near.0": (width, channels, near, near),
        **{f"local.{2 * k}": (width, width, 3, 3) for k in range(len(options.dilations))},
        "of_local": (hidden, width, *options.taps),
        "of_ground": (hidden, 3 * taps + REQUIREMENT_FEATURES),
        "footprint": (features, hidden),
        "context": (options.context, len(square(REACH, CONTEXT_STEP)) * seen),
        "of_line.0": (width, width, line, line),
        "feet": (options.feet, of_feet),
        "rest.0": (head, way),
        "rest.2": (head // 2, head),
        "heads": (1 + options.costs, judged),
        **ways,
        "goal_cost.0": (64, GOAL_FEATURES),
        "goal_cost.2": (options.costs, 64),
    }
    shapes = {f"{name}.weight": shape for name, shape in weights.items()}
    return shapes | {f"{name}.bias": shape[:1] for name, shape in weights.items() if name != "of_ground"}


def _checked(tensors: Mapping[str, np.ndarray], shapes: Mapping[str, tuple[int, ...]]) -> dict[str, np.ndarray]:
    if odd := sorted(set(tensors) ^ set(shapes)):
        raise InputError(
            f"{WEIGHTS}: does not fit footprint: {odd[0]} is {'unknown' if odd[0] in tensors else 'missing'}"
        )
    for name, shape in shapes.items():
        if tensors[name].shape != shape:
            raise InputError(f"{WEIGHTS}: does not fit footprint: {name} is {tensors[name].shape}, not {shape}")
    return {name: np.ascontiguousarray(tensors[name], np.float32) for name in shapes}

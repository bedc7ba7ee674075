"""Trained abstraction: a network that judges tasks, with its calibration."""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as tensor_bytes
from scipy.special import expit

from hdsp.base.errors import InputError
from hdsp.learning.calibration import Calibration, calibration_figures, fit_calibration
from hdsp.learning.encoding import encode
from hdsp.learning.hardware import autocast, channels_last
from hdsp.learning.learning_settings import HardwareSettings, ModelSettings
from hdsp.learning.metrics import MINIMUM_COST
from hdsp.learning.networks import TaskNetwork, build_network
from hdsp.learning.networks.dense import DenseEvaluation
from hdsp.learning.saved_abstraction import (
    CONFIG,
    FORMAT_VERSION,
    WEIGHTS,
    Precision,
    Provenance,
    lattice_contract,
    read_saved,
    replace_folder,
)
from hdsp.robot import lattice
from hdsp.robot.robot import Robot

if TYPE_CHECKING:
    from hdsp.labels.tasks import TaskSet

#: Logit of a goal that is infeasible even on flat ground.
NEVER = -1e4
#: Largest difference, in abstract steps, between a goal and one that is infeasible on flat ground.
TOLERANCE = 1e-3

WINDOWS = 24  # patches per goal evaluation in ``predict_windows``


class LearnedAbstraction:
    """Trained network with its configuration: maps patches and goals to feasibility and cost.

    Attributes:
        network: in evaluation mode, on the ``hardware`` device.
        model: settings that built the network.
        provenance: origin of the labels.
        metrics: flat metrics at the end of training.
        calibration: corrects probabilities and holds cost quantiles.
        quantile: level of predicted costs, see ``at_quantile``; None = the network's own costs.
    """

    def __init__(
        self,
        network: TaskNetwork,
        model: ModelSettings,
        provenance: Provenance | None = None,
        metrics: Mapping[str, float] | None = None,
        hardware: HardwareSettings | None = None,
        calibration: Calibration | None = None,
    ):
        self.model, self.provenance, self.metrics = model, provenance or Provenance(), dict(metrics or {})
        self.calibration = calibration or Calibration()
        self.quantile: float | None = None
        self._flat: dict[bytes, np.ndarray] = {}
        self.hardware = hardware or HardwareSettings()
        self.device = self.hardware.device()
        self.network = channels_last(network.to(self.device)).eval()

    def predict(self, patches: np.ndarray, goals: np.ndarray, batch: int = 128) -> tuple[np.ndarray, np.ndarray]:
        """Predicts feasibility and cost of tasks.

        Args:
            patches: float32 [n, 72, 72], metres, NaN = unknown.
            goals: float32 [n, G, 3] in abstract steps in the robot frame, or [G, 3] for all patches.
            batch: patches evaluated at once.

        Returns:
            feasible: bool [n, G], probability above one half.
            cost: float32 [n, G], at least ``MINIMUM_COST``; meaningful where feasible; a quantile after
                ``at_quantile``.

        Raises:
            InputError: a shape is wrong.

        Convention: axis 1 of ``patches`` is x, along the robot's heading; the base stands at the centre of cell (36,
        36).
        """
        logits, cost = self._predict(patches, goals, batch)
        return logits > 0, self._at_level(cost, goals)

    def predict_probability(
        self, patches: np.ndarray, goals: np.ndarray, batch: int = 128
    ) -> tuple[np.ndarray, np.ndarray]:
        """Like ``predict``, with feasibility probabilities, float32 [n, G], instead of decisions."""
        logits, cost = self._predict(patches, goals, batch)
        return expit(logits / np.float32(self.calibration.temperature)), self._at_level(cost, goals)

    def at_quantile(self, level: float) -> "LearnedAbstraction":
        """Returns an abstraction with the same network that predicts a cost quantile.

        With level 0.05, one cost in twenty is above its label.

        Raises:
            InputError: the abstraction was not calibrated for this level.
        """
        self.calibration.factors(level)
        other = copy(self)
        other.quantile = level
        return other

    def calibrated(self, tasks: "TaskSet") -> "LearnedAbstraction":
        """Returns an abstraction with the same network, calibrated on tasks outside its training set."""
        logits, cost = self._predict(tasks.heights, tasks.goals)
        other = copy(self)
        other.calibration = fit_calibration(logits, cost, self.flat_costs(tasks.goals), tasks.feasible, tasks.cost)
        return other

    def calibration_figures(self, tasks: "TaskSet") -> dict[str, Any]:
        """Returns ``hdsp.learning.calibration.calibration_figures`` for labelled tasks."""
        logits, cost = self._predict(tasks.heights, tasks.goals)
        flat = self.flat_costs(tasks.goals)
        bounds = {level: self.calibration.at_level(level, cost, flat) for level in self.calibration.cost_quantiles}
        probability = expit(logits / np.float32(self.calibration.temperature))
        return calibration_figures(probability, tasks.feasible, bounds, tasks.cost, logits > 0)

    def flat_costs(self, goals: np.ndarray) -> np.ndarray:
        """Returns predicted costs, float32 [...], for goals [..., 3] on flat ground."""
        goals = np.asarray(goals, np.float32)
        distinct, which = np.unique(goals.reshape(-1, 3), axis=0, return_inverse=True)
        flat = np.zeros((1, lattice.PATCH_CELLS, lattice.PATCH_CELLS), np.float32)
        _, cost = self._predict(flat, distinct)
        return cost[0][which.reshape(-1)].reshape(goals.shape[:-1])

    def _at_level(self, cost: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Converts predicted costs [n, G] to the requested level."""
        if self.quantile is None:
            return cost
        key = np.asarray(goals, np.float32).tobytes()
        if key not in self._flat:  # callers repeat each heading's goals
            if len(self._flat) == lattice.ABSTRACT_HEADINGS:
                self._flat.clear()
            self._flat[key] = self.flat_costs(goals)
        flat = np.broadcast_to(self._flat[key], cost.shape)
        return np.maximum(self.calibration.at_level(self.quantile, cost, flat), np.float32(MINIMUM_COST))

    @torch.inference_mode()
    def _predict(self, patches: np.ndarray, goals: np.ndarray, batch: int = 128) -> tuple[np.ndarray, np.ndarray]:
        """Feasibility logits and the network's own costs, float32 [n, G] each."""
        patches, goals = np.asarray(patches, np.float32), np.asarray(goals, np.float32)
        cells = lattice.PATCH_CELLS
        if patches.ndim != 3 or patches.shape[1:] != (cells, cells):
            raise InputError(f"patches: shape {patches.shape} is not [n, {cells}, {cells}]")
        if goals.ndim == 2:
            goals = np.broadcast_to(goals, (len(patches), *goals.shape))
        if goals.ndim != 3 or len(goals) != len(patches) or goals.shape[2] != 3:
            raise InputError(f"goals: shape {goals.shape} is not [{len(patches)}, goals, 3]")
        logits, cost = np.empty((2, *goals.shape[:2]), np.float32)
        for start in range(0, len(patches), batch):
            part = slice(start, start + batch)
            predicted, of_feasible = self._evaluate(patches[part], goals[part])
            logits[part] = np.where(self._never(goals[part]), NEVER, of_feasible.float().cpu().numpy())
            cost[part] = predicted.clamp_min(MINIMUM_COST).cpu().numpy()
        return logits, cost

    @torch.inference_mode()
    def predict_windows(
        self, trunk: DenseEvaluation, heights: np.ndarray, corners: np.ndarray, wanted: np.ndarray, goals: np.ndarray
    ) -> Iterator[tuple[slice, np.ndarray, np.ndarray] | None]:
        """Like ``predict`` with shared goals, for patches that are windows into one array; some patches at a time.

        Args:
            trunk: the network's dense trunk.
            heights: float32 [nx, ny], metres, NaN = unknown; with ``trunk.margin`` cells around the patches.
            corners: int64 [n, 2], lower patch corners, relative to cell (margin, margin) of ``heights``.
            wanted: bool [n], patches to evaluate. A patch's result does not depend on the other entries, to the last
                bit.
            goals: float32 [G, 3] in abstract steps in the robot frame.

        Yields:
            None after the trunk. Then, for each group with a wanted patch, its slice of ``corners``, feasibility and
            costs, [m, G] each.
        """
        network = self.network
        with autocast(self.device, self.hardware.uses_bfloat16()):
            encoded = encode(network.encoding, torch.from_numpy(heights)[None, None].to(self.device))
            # Channels innermost, as the weights are.
            dense = trunk(encoded.contiguous(memory_format=torch.channels_last))
        yield None
        shared_goals, never = torch.from_numpy(goals)[None].to(self.device), self._never(goals)
        # Small groups, because the values for all goals and patches together exceed the processor's cache. The groups
        # are always the same, because sums over another number of rows may round differently.
        for start in range(0, len(corners), WINDOWS):
            part = slice(start, start + WINDOWS)
            if wanted[part].any():
                features = trunk.windows(dense, torch.from_numpy(corners[part]).to(self.device)).float()
                cost, logits = network.goal_part(features, shared_goals)
                feasible = (logits > 0).cpu().numpy() & ~never
                yield part, feasible, self._at_level(cost.clamp_min(MINIMUM_COST).cpu().numpy(), goals)

    def _never(self, goals: np.ndarray) -> np.ndarray:
        """Whether goals [..., 3] are infeasible even on flat ground; bool [...]."""
        if not self.provenance.never_feasible:
            return np.zeros(goals.shape[:-1], bool)
        never = np.array(self.provenance.never_feasible, np.float32)
        near = np.abs(goals[..., None, :] - never) < TOLERANCE
        return np.asarray(near.all(axis=-1).any(axis=-1))

    def _evaluate(self, patches: np.ndarray, goals: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        heights = torch.tensor(patches)[:, None].to(self.device, memory_format=torch.channels_last)
        with autocast(self.device, self.hardware.uses_bfloat16()):
            return self.network(heights, torch.tensor(goals).to(self.device))

    def save_pretrained(
        self, folder: str | Path, precision: Precision = "float32", beside: Mapping[str, str] | None = None
    ) -> Path:
        """Writes the abstraction; an existing folder is replaced as a whole.

        Args:
            folder: receives ``config.json`` and ``model.safetensors``.
            precision: stored precision of trained values; ``float16`` rounds them and halves the file.
            beside: further texts for the folder, by file name.

        Raises:
            InputError: the folder cannot be written, or holds something other than an abstraction.
        """
        weights = tensor_bytes(self._tensors(precision))
        config = {
            "format_version": FORMAT_VERSION,
            "model": self.model.to_dict(),
            "lattice": lattice_contract(),
            "provenance": asdict(self.provenance),
            # JSON has no NaN, so undefined metrics are left out.
            "metrics": {key: value for key, value in self.metrics.items() if math.isfinite(value)},
            "calibration": self.calibration.to_dict(),
            "precision": precision,
            "weights_sha256": hashlib.sha256(weights).hexdigest(),
        }
        text = json.dumps(config, indent=2) + "\n"
        others = {name: content.encode() for name, content in (beside or {}).items()}
        return replace_folder(Path(folder), {WEIGHTS: weights, CONFIG: text.encode(), **others})

    def _tensors(self, precision: Precision) -> dict[str, torch.Tensor]:
        if precision not in ("float32", "float16"):
            raise InputError(f"precision {precision!r}: allowed are float32, float16")
        # Buffers (running means in normalisation) are small, and may exceed the half float range.
        halved = {key for key, _ in self.network.named_parameters()} if precision == "float16" else set()
        return {
            key: (value.detach().half() if key in halved else value.detach()).cpu().contiguous()
            for key, value in self.network.state_dict().items()
        }

    @classmethod
    def from_pretrained(
        cls, folder: str | Path, robot: Robot | None = None, hardware: HardwareSettings | None = None
    ) -> "LearnedAbstraction":
        """Reads an abstraction and checks that it fits.

        Args:
            folder: with ``config.json`` and ``model.safetensors``.
            robot: if given, the abstraction has to belong to this robot.
            hardware: device and precision for inference.

        Raises:
            InputError: a file is missing or damaged; or the lattice, actions, cost model or robot differ from training.
        """
        folder = Path(folder)
        saved, weights = read_saved(folder, robot)
        try:
            network = build_network(saved.model)
        except (ValueError, RuntimeError, MemoryError) as error:  # options too large for memory
            raise InputError(f"{folder / CONFIG}: {' '.join(str(error).split())}") from None
        try:
            network.load_state_dict(load_tensors(weights))
        except (RuntimeError, SafetensorError) as error:
            raise InputError(
                f"{folder / WEIGHTS}: does not fit {saved.model.architecture}: {str(error).splitlines()[0]}"
            ) from None
        return cls(network, saved.model, saved.provenance, saved.metrics, hardware, saved.calibration)

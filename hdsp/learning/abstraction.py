"""Trained abstraction: a network that judges tasks, with its calibration."""

import hashlib
import math
import os
import tempfile
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import expit

from hdsp.base.errors import InputError
from hdsp.base.messages import shown
from hdsp.learning.calibration import MINIMUM_COST, Calibration, calibration_figures, fit_calibration
from hdsp.learning.hub_card import HubCard, picture_of
from hdsp.learning.inference.footprint_engine import FootprintEngine, KeptPlace, engine_options
from hdsp.learning.judgements import Judgements
from hdsp.learning.learning_settings import HardwareSettings, ModelSettings
from hdsp.learning.saved_abstraction import (
    CARD,
    CONFIG,
    FORMAT_VERSION,
    PICTURE,
    WEIGHTS,
    Precision,
    Provenance,
    config_text,
    lattice_contract,
    read_saved,
    write_saved,
)
from hdsp.robot import lattice
from hdsp.robot.robot import Robot

if TYPE_CHECKING:
    from hdsp.labels.tasks import TaskSet
    from hdsp.learning.networks import TaskNetwork
    from hdsp.learning.networks.dense import DenseEvaluation
    from hdsp.learning.torch_evaluation import TorchEvaluation

#: Package and extra of evaluations without torch.
_LIGHT = "onnxruntime", "learned"
#: Logit of a goal that is infeasible even on flat ground.
NEVER = -1e4
#: Largest difference, in abstract steps, between a goal and one that is infeasible on flat ground.
TOLERANCE = 1e-3


class LearnedAbstraction:
    """Trained network with its configuration: maps patches and goals to feasibility and cost.

    Attributes:
        engine: evaluation without torch, for a footprint network from a folder; None = torch evaluates the network.
        model: settings that built the network.
        provenance: origin of the labels.
        metrics: flat metrics at the end of training.
        calibration: corrects probabilities and holds cost quantiles.
        quantile: level of predicted costs, see ``at_quantile``; None = the network's own costs.
        threshold: probability above which an action counts as feasible, see ``at_threshold``.
        edges_threshold: the same for edges (``LearnedCosts``), part of a saved abstraction.
    """

    def __init__(
        self,
        network: "TaskNetwork | FootprintEngine",
        model: ModelSettings,
        provenance: Provenance | None = None,
        metrics: Mapping[str, float] | None = None,
        hardware: HardwareSettings | None = None,
        calibration: Calibration | None = None,
    ):
        self.model, self.provenance, self.metrics = model, provenance or Provenance(), dict(metrics or {})
        self.calibration = calibration or Calibration()
        self.quantile: float | None = None
        self.threshold = self.edges_threshold = 0.5
        self._for_planning = False
        self._flat: dict[bytes, np.ndarray] = {}
        self.hardware = hardware or HardwareSettings()
        self.engine = network if isinstance(network, FootprintEngine) else None
        self._weights = b""
        self._torch: TorchEvaluation | None = None
        if not isinstance(network, FootprintEngine):
            from hdsp.learning import torch_evaluation

            self._torch = torch_evaluation.TorchEvaluation(network, self.hardware)

    def __repr__(self) -> str:
        robot = self.provenance.robot or "an unknown robot"
        return f"LearnedAbstraction({self.model.architecture} for {robot}, feasible from {self.threshold:g})"

    @property
    def torch_evaluation(self) -> "TorchEvaluation":
        """The network in torch; loads torch at the first use if the engine evaluates the network."""
        if self._torch is None:
            from hdsp.learning.torch_evaluation import TorchEvaluation

            self._torch = TorchEvaluation.of(self.model, self._weights, self.hardware)
        return self._torch

    @property
    def network(self) -> "TaskNetwork":
        """The network in torch, in evaluation mode. Where ``engine`` evaluates, a change has no effect on results."""
        return self.torch_evaluation.network

    def is_dense(self) -> bool:
        """Returns whether all patches of a heading share the features of a rotated map."""
        return self.engine is not None or self.network.is_dense()

    @property
    def predicts_planning_cost(self) -> bool:
        """Whether the network predicts costs for planning beside the label costs (`hdsp.abstract.CostKind`)."""
        return self.engine.options.planning if self.engine is not None else self.network.predicts_planning_cost

    def predict(self, patches: np.ndarray, goals: np.ndarray, batch: int = 128) -> tuple[np.ndarray, np.ndarray]:
        """Predicts feasibility and cost of tasks.

        Args:
            patches: float32 [n, 72, 72], metres, NaN = unknown.
            goals: float32 [n, G, 3] in abstract steps in the robot frame, or [G, 3] for all patches.
            batch: patches evaluated at once.

        Returns:
            Two arrays. Feasibility, bool [n, G]: probability above one half, or above another threshold after
            ``at_threshold``. Cost, float32 [n, G], at least ``MINIMUM_COST``: meaningful where feasible; a quantile
            after ``at_quantile``, a cost for planning after ``for_planning``.

        Raises:
            InputError: a shape is wrong.

        Convention: axis 1 of ``patches`` is x, along the robot's heading; the base stands at the centre of cell (36,
        36).
        """
        judged = self._predict(patches, goals, batch)
        return judged.logits > self._least_logit(), self._costs(judged, goals)

    def predict_probability(
        self, patches: np.ndarray, goals: np.ndarray, batch: int = 128
    ) -> tuple[np.ndarray, np.ndarray]:
        """Like ``predict``, with feasibility probabilities, float32 [n, G], instead of decisions."""
        judged = self._predict(patches, goals, batch)
        return expit(judged.logits / np.float32(self.calibration.temperature)), self._costs(judged, goals)

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

    def at_threshold(self, probability: float) -> "LearnedAbstraction":
        """Returns an abstraction with the same network that judges actions feasible above another probability.

        Raises:
            InputError: the probability is not between 0 and 1.
        """
        if not 0 < probability < 1:
            raise InputError(f"feasibility threshold {probability!r}: a probability between 0 and 1 is allowed")
        other = copy(self)
        other.threshold = other.edges_threshold = float(probability)
        return other

    def for_planning(self) -> "LearnedAbstraction":
        """Returns an abstraction with the same network that predicts costs for planning instead of label costs.

        Raises:
            InputError: the network does not predict them.
        """
        if not self.predicts_planning_cost:
            raise InputError(f"a network of {self.model.architecture} with these options predicts label costs alone")
        other = copy(self)
        other._for_planning = True
        return other

    def calibrated(self, tasks: "TaskSet") -> "LearnedAbstraction":
        """Returns an abstraction with the same network, calibrated on tasks outside its training set."""
        cost, logits, _ = self._predict(tasks.heights, tasks.goals)
        other = copy(self)
        other.calibration = fit_calibration(logits, cost, self.flat_costs(tasks.goals), tasks.feasible, tasks.cost)
        return other

    def calibration_figures(self, tasks: "TaskSet") -> dict[str, Any]:
        """Returns ``hdsp.learning.calibration.calibration_figures`` for labelled tasks."""
        cost, logits, _ = self._predict(tasks.heights, tasks.goals)
        flat = self.flat_costs(tasks.goals)
        bounds = {level: self.calibration.at_level(level, cost, flat) for level in self.calibration.cost_quantiles}
        probability = expit(logits / np.float32(self.calibration.temperature))
        return calibration_figures(probability, tasks.feasible, bounds, tasks.cost, logits > 0)

    def flat_costs(self, goals: np.ndarray) -> np.ndarray:
        """Returns predicted costs, float32 [...], for goals [..., 3] on flat ground."""
        goals = np.asarray(goals, np.float32)
        distinct, which = np.unique(goals.reshape(-1, 3), axis=0, return_inverse=True)
        flat = np.zeros((1, lattice.PATCH_CELLS, lattice.PATCH_CELLS), np.float32)
        cost = self._predict(flat, distinct).cost
        return cost[0][which.reshape(-1)].reshape(goals.shape[:-1])

    def _costs(self, judged: Judgements, goals: np.ndarray) -> np.ndarray:
        """Costs [n, G] of the requested kind at the requested level; a cost for planning never exceeds the label's."""
        cost = self._at_level(judged.cost, goals)
        if not self._for_planning or judged.planning_cost is None:
            return cost
        planning = np.minimum(judged.planning_cost, judged.cost)
        if self.quantile is not None:
            planning = planning * (cost / judged.cost)
        return np.maximum(planning, np.float32(MINIMUM_COST))

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

    def _predict(self, patches: np.ndarray, goals: np.ndarray, batch: int = 128) -> Judgements:
        """The network's own judgements [n, G]; label costs are at least ``MINIMUM_COST``."""
        patches, goals = np.asarray(patches, np.float32), np.asarray(goals, np.float32)
        cells = lattice.PATCH_CELLS
        if patches.ndim != 3 or patches.shape[1:] != (cells, cells):
            raise InputError(f"patches: shape {patches.shape} is not [n, {cells}, {cells}]")
        if goals.ndim == 2:
            goals = np.broadcast_to(goals, (len(patches), *goals.shape))
        if goals.ndim != 3 or len(goals) != len(patches) or goals.shape[2] != 3:
            raise InputError(f"goals: shape {goals.shape} is not [{len(patches)}, goals, 3]")
        if not np.isfinite(goals).all():
            raise InputError("goals: need finite numbers")
        if not isinstance(batch, int | np.integer) or batch < 1:
            raise InputError(f"batch is {shown(batch)}; need a whole number >= 1")
        result = Judgements.empty(goals.shape[:2], self.predicts_planning_cost)
        evaluation: TorchEvaluation | FootprintEngine = self.engine or self.torch_evaluation
        for start in range(0, len(patches), batch):
            part = slice(start, start + batch)
            judged = evaluation.patches(patches[part], goals[part])
            logits = np.where(self._never(goals[part]), np.float32(NEVER), judged.logits)
            cost = np.maximum(judged.cost, np.float32(MINIMUM_COST))
            result.store(part, judged._replace(cost=cost, logits=logits))
        return result

    def predict_windows(
        self, trunk: "DenseEvaluation", heights: np.ndarray, corners: np.ndarray, wanted: np.ndarray, goals: np.ndarray
    ) -> Iterator[tuple[slice, np.ndarray, np.ndarray] | None]:
        """Like ``predict`` with shared goals, for windows into one array, with torch.

        Arguments are as for ``TorchEvaluation.windows``, which yields costs and logits instead of feasibility and
        costs.
        """
        for group in self.torch_evaluation.windows(trunk, heights, corners, wanted, goals):
            yield None if group is None else (group[0], *self._judged(group[1], goals))

    def predict_bases(
        self, heights: np.ndarray, bases: np.ndarray, goals: np.ndarray, place: KeptPlace | None = None
    ) -> Iterator[tuple[slice, np.ndarray, np.ndarray] | None]:
        """Like ``predict_windows``, with the engine; arguments are as for ``FootprintEngine.evaluate``."""
        assert self.engine is not None
        for group in self.engine.evaluate(heights, bases, goals, place):
            yield None if group is None else (group[0], *self._judged(group[1], goals))

    def _judged(self, judged: Judgements, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Feasibility, and costs of the requested kind and level, [n, G] each, for shared goals."""
        feasible = (judged.logits > self._least_logit()) & ~self._never(goals)
        cost = np.maximum(judged.cost, np.float32(MINIMUM_COST))
        return feasible, self._costs(judged._replace(cost=cost), goals)

    def _least_logit(self) -> float:
        """Logit above which an action counts as feasible."""
        return self.calibration.temperature * math.log(self.threshold / (1 - self.threshold))

    def _never(self, goals: np.ndarray) -> np.ndarray:
        """Whether goals [..., 3] are infeasible even on flat ground; bool [...]."""
        if not self.provenance.never_feasible:
            return np.zeros(goals.shape[:-1], bool)
        never = np.array(self.provenance.never_feasible, np.float32)
        near = np.abs(goals[..., None, :] - never) < TOLERANCE
        return np.asarray(near.all(axis=-1).any(axis=-1))

    def save_pretrained(
        self, folder: str | Path, precision: Precision = "float32", text: str | None = None, picture: bool = True
    ) -> Path:
        """Writes the abstraction with its card; an existing folder is replaced as a whole.

        Args:
            folder: receives ``config.json``, ``model.safetensors``, the card ``README.md`` and a picture.
            precision: stored precision of trained values; ``float16`` rounds them and halves the file.
            text: text of the card below its front matter (licence, tags, metrics); None = a short one.
            picture: whether to draw judged patches, if the package for pictures is installed.

        Raises:
            InputError: the folder cannot be written, or holds other files than those of an abstraction.
        """
        if precision not in ("float32", "float16"):
            raise InputError(f"precision {precision!r}: allowed are float32, float16")
        weights = self.torch_evaluation.weights(half=precision == "float16")
        config = {
            "format_version": FORMAT_VERSION,
            "model": self.model.to_dict(),
            "lattice": lattice_contract(),
            "provenance": asdict(self.provenance),
            # JSON has no NaN, so undefined metrics are left out.
            "metrics": {key: value for key, value in self.metrics.items() if math.isfinite(value)},
            "calibration": self.calibration.to_dict(),
            "precision": precision,
            "edges_threshold": self.edges_threshold,
            "weights_sha256": hashlib.sha256(weights).hexdigest(),
        }
        drawn = picture_of(self.predict) if picture else None
        files = {WEIGHTS: weights, CONFIG: config_text(config).encode()}
        card = HubCard(Path(os.path.abspath(folder)).name, self.model.architecture, self.provenance, self.metrics)
        files[CARD] = card.markdown(text, drawn is not None).encode()
        return write_saved(Path(folder), files | ({PICTURE: drawn} if drawn else {}))

    def push_to_hub(self, repository: str, private: bool = False, precision: Precision = "float32") -> str:
        """Uploads the abstraction with its card to ``user/repository`` of the Hugging Face hub.

        The token is the one of ``hf auth login`` or of the environment variable ``HF_TOKEN``.

        Args:
            repository: made if it does not exist.
            private: whether a new repository is private.
            precision: as for ``save_pretrained``.

        Returns:
            the address of the commit.

        Raises:
            InputError: the package ``huggingface_hub`` is missing, the token does not suffice, or there is no network.
        """
        from hdsp.learning.hub import check_repository, upload

        check_repository(repository)
        with tempfile.TemporaryDirectory() as work:
            folder = self.save_pretrained(Path(work) / repository.rpartition("/")[2], precision)
            return upload(folder, repository, private)

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
            InputError: a file is missing or damaged; the lattice, actions, cost model or robot differ from training; or
                a package is not installed.
        """
        folder, hardware = Path(folder), hardware or HardwareSettings()
        saved, weights = read_saved(folder, robot)
        try:
            network: TaskNetwork | FootprintEngine
            if _uses_engine(saved.model, hardware):
                from safetensors.numpy import load

                network = FootprintEngine(saved.model, load(weights), codes=hardware.precision != "32")
            else:
                from hdsp.learning.torch_evaluation import TorchEvaluation

                network = TorchEvaluation.of(saved.model, weights, hardware).network
        except ModuleNotFoundError as error:
            package, extra = (error.name, "learning") if engine_options(saved.model) is None else _LIGHT
            raise InputError(
                f"{folder}: a network of architecture {saved.model.architecture} needs {package}: "
                f"pip install 'hdsp[{extra}]'"
            ) from None
        except InputError as error:
            raise InputError(f"{folder}/{error}") from None
        abstraction = cls(network, saved.model, saved.provenance, saved.metrics, hardware, saved.calibration)
        abstraction._weights, abstraction.edges_threshold = weights, saved.edges_threshold
        return abstraction


def _uses_engine(model: ModelSettings, hardware: HardwareSettings) -> bool:
    """Whether a network is evaluated without torch; this depends on settings and installed packages alone."""
    wants_torch = hardware.accelerator == "gpu" or hardware.precision == "bf16"
    return not wants_torch and engine_options(model) is not None and find_spec("onnxruntime") is not None

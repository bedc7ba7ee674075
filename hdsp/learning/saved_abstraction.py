"""Folder of a trained abstraction: ``config.json`` + ``model.safetensors``.

The configuration carries everything in which inference has to agree with training; reading checks it.
"""

import hashlib
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hdsp.abstract.flat_table import flat_table
from hdsp.base.errors import InputError
from hdsp.base.files import existing_file, replace_folder
from hdsp.base.messages import shown
from hdsp.base.settings import Share, checked, load_settings
from hdsp.base.short_repr import short_repr
from hdsp.base.yaml_files import read_json
from hdsp.learning.architectures import architectures
from hdsp.learning.calibration import Calibration
from hdsp.learning.learning_settings import ModelSettings
from hdsp.robot import lattice
from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import COST_MODEL_VERSION

CONFIG, WEIGHTS = "config.json", "model.safetensors"
CARD, PICTURE = "README.md", "judged_patches.png"
FORMAT_VERSION = 1
_CHECKSUM = "config_sha256"
#: Earlier cost models whose abstractions still load; version 3 knows no slopes.
EARLIER_COST_MODELS = (3,)
Precision = Literal["float32", "float16"]


@checked
class Provenance:
    """Origin of a model's labels.

    Attributes:
        robot: robot name.
        robot_hash: ``Robot.hash()`` of the labelled robot; empty = not recorded.
        cost_model_version: cost model version behind the labels.
        labels_hash: hash over everything the labels depend on; empty = not recorded.
        never_feasible: goals in the robot frame, in abstract steps (``robot_frame_goals``), that are infeasible even on
            flat ground; the abstraction judges them infeasible on any terrain.
        notes: further plain values.
    """

    robot: str = ""
    robot_hash: str = ""
    cost_model_version: int = COST_MODEL_VERSION
    labels_hash: str = ""
    never_feasible: tuple[tuple[float, float, float], ...] = ()
    notes: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return short_repr(self)

    @classmethod
    def of(cls, robot: Robot, labels_hash: str = "", **notes: Any) -> "Provenance":
        """Provenance for labels made now for ``robot``, with the current cost model."""
        return cls(robot.name, robot.hash(), COST_MODEL_VERSION, labels_hash, _never_feasible(robot), notes)


@checked
class SavedAbstraction:
    """Contents of ``config.json``.

    Attributes:
        format_version: version of the format, ``FORMAT_VERSION``.
        model: settings for ``build_network``.
        lattice: the lattices and actions of training.
        provenance: source of the labels.
        metrics: flat metrics at the end of training.
        weights_sha256: checksum of ``model.safetensors``.
        calibration: corrections fitted after training.
        precision: precision of the trained values in the file.
        edges_threshold: see ``LearnedAbstraction``.
        config_sha256: checksum of all other values, for damage that types and ranges do not show; empty = not recorded.
            Who edits the file removes it.
    """

    format_version: int
    model: ModelSettings
    lattice: dict[str, Any]
    provenance: Provenance
    metrics: dict[str, float]
    weights_sha256: str
    calibration: Calibration = field(default_factory=Calibration)
    precision: Precision = "float32"
    edges_threshold: Share = 0.5
    config_sha256: str = ""


def _never_feasible(robot: Robot) -> tuple[tuple[float, float, float], ...]:
    goals = np.array([lattice.robot_frame_goals(heading) for heading in range(lattice.ABSTRACT_HEADINGS)])
    found = np.unique(np.round(goals[np.isinf(flat_table(robot))].astype(float), 6), axis=0)
    return tuple((dx, dy, turn) for dx, dy, turn in found.tolist())


def write_saved(folder: Path, files: Mapping[str, bytes]) -> Path:
    """Writes a folder with these files, by name; an abstraction in it is replaced as a whole.

    Raises:
        InputError: the folder cannot be written, or holds other files than those of an abstraction.
    """
    try:
        holds = os.listdir(folder)
    except FileNotFoundError:
        holds = []
    except OSError as error:
        raise InputError(f"cannot write {folder}: {error.strerror}") from error
    others = sorted({*holds} - {*files, CONFIG, WEIGHTS, CARD, PICTURE})
    if others or (holds and CONFIG not in holds):
        named = f" ({shown(others)})" if others else ""
        raise InputError(f"{folder}: holds other files than a pretrained abstraction{named}; it is not replaced")
    return replace_folder(folder, files)


def config_text(values: Mapping[str, Any]) -> str:
    """Text of ``config.json`` with its checksum."""
    return json.dumps({**values, _CHECKSUM: _config_sha256(values)}, indent=2) + "\n"


def _config_sha256(values: Mapping[str, Any]) -> str:
    others = {key: value for key, value in values.items() if key != _CHECKSUM}
    return hashlib.sha256(json.dumps(others, sort_keys=True).encode()).hexdigest()


def read_saved(folder: Path, robot: Robot | None = None) -> tuple[SavedAbstraction, bytes]:
    """Reads configuration and weights, and checks that they fit each other and this program.

    Args:
        folder: with ``config.json`` and ``model.safetensors``.
        robot: if given, the abstraction has to belong to this robot.

    Raises:
        InputError: a file is missing or damaged; or the lattice, actions, cost model or robot differ from training.
    """
    config_path = folder / CONFIG
    config = read_json(config_path, "pretrained abstraction")
    weights_path = existing_file(folder / WEIGHTS, "weights of a pretrained abstraction")
    if isinstance(config, dict) and isinstance(version := config.get("format_version"), int):
        _check_agreement(config_path, "format_version", version, FORMAT_VERSION)
    saved = load_settings(SavedAbstraction, config, source=str(config_path))
    for key, value in lattice_contract().items():
        _check_agreement(config_path, f"lattice.{key}", saved.lattice.get(key), value)
    _check_network_code(config_path, saved.model.architecture)
    provenance = saved.provenance
    if provenance.cost_model_version not in EARLIER_COST_MODELS:
        _check_agreement(config_path, "cost_model_version", provenance.cost_model_version, COST_MODEL_VERSION)
    if robot is not None and provenance.robot_hash not in ("", robot.hash()):
        raise InputError(
            f"{config_path}: trained for another robot ({provenance.robot!r}) than {robot.name!r} as it is now"
        )
    if saved.config_sha256 not in ("", _config_sha256(config)):
        raise InputError(f"{config_path}: damaged, or edited with its {_CHECKSUM} left in: the checksum differs")
    weights = weights_path.read_bytes()
    if hashlib.sha256(weights).hexdigest() != saved.weights_sha256:
        raise InputError(
            f"{weights_path}: damaged or of another abstraction, its checksum is not the one in config.json"
        )
    return saved, weights


def lattice_contract() -> dict[str, Any]:
    """Lattices and actions in which inference has to agree with training."""
    return {
        "resolution": lattice.RESOLUTION,
        "patch_cells": lattice.PATCH_CELLS,
        "patch_center": lattice.PATCH_CENTER,
        "headings": lattice.HEADINGS,
        "abstract_resolution": lattice.ABSTRACT_RESOLUTION,
        "abstract_headings": lattice.ABSTRACT_HEADINGS,
        "abstract_actions": lattice.ABSTRACT_ACTIONS.tolist(),
    }


def _check_network_code(path: Path, architecture: str) -> None:
    """Refuses code that a file alone names: nothing is imported that this process or an installed package does not."""
    module = architecture.partition(":")[0]
    if architecture not in architectures() and module not in sys.modules:
        raise InputError(
            f"{path}: its network {architecture} is code that no installed package announces as a network; import "
            f"{module} first, if you trust it"
        )


def _check_agreement(path: Path, what: str, found: Any, expected: Any) -> None:
    if found != expected:
        raise InputError(f"{path}: {what} is {shown(found)}, but this program works with {shown(expected)}")

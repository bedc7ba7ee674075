"""Loads trained abstractions: shipped ones by name, others from their folders.

``shipped/`` has one folder for each shipped abstraction: ``config.json``, ``model.safetensors`` and the model card
``README.md``, written by ``python -m pipeline.publish_model``. A folder is named ROBOT for the robot's default
abstraction, or ROBOT-NAME for another one. Importing this module does not import torch; loading an abstraction does.
"""

from __future__ import annotations

import os
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING

from hdsp.base.errors import InputError
from hdsp.robot.robot import Robot

if TYPE_CHECKING:
    from hdsp.learning import HardwareSettings, LearnedAbstraction


def shipped() -> Traversable:
    """Returns the folder of the shipped abstractions."""
    return resources.files(__package__).joinpath("shipped")


def presets() -> list[str]:
    """Returns the names of all shipped abstractions: ROBOT or ROBOT-NAME."""
    return sorted(place.name for place in shipped().iterdir() if place.joinpath("config.json").is_file())


def robot_of(preset: str) -> str:
    """Returns the robot for abstraction ROBOT or ROBOT-NAME; robot names may contain dashes."""
    fitting = [robot for robot in Robot.presets() if f"{preset}-".startswith(f"{robot}-")]
    return max(fitting, key=len, default=preset)


def load_abstraction(
    source: str | Path, robot: str | Path | dict | Robot | None = None, hardware: HardwareSettings | None = None
) -> LearnedAbstraction:
    """Loads a trained abstraction, e.g. ``load_abstraction("momaro")``; no pickle.

    Args:
        source: shipped abstraction name; a folder written by ``LearnedAbstraction.save_pretrained``; or a repository
            of the Hugging Face hub, ``user/repository`` or ``user/repository@revision``, which is downloaded once.
        robot: if given, the abstraction has to fit this robot with its current values. Default for a shipped
            abstraction: its robot.
        hardware: device and precision for inference.

    Raises:
        InputError: the name or folder does not exist or is damaged; the abstraction belongs to another robot, cost
            model or lattice; torch is not installed.
    """
    names = presets()
    is_preset = str(source) in names
    if not is_preset and not os.path.isdir(source):
        source = _downloaded(str(source), ", ".join(names) or "none")
    from hdsp.learning.abstraction import LearnedAbstraction

    folder = Path(str(shipped().joinpath(str(source)))) if is_preset else Path(source)
    if robot is None and is_preset:
        robot = robot_of(str(source))
    return LearnedAbstraction.from_pretrained(folder, None if robot is None else Robot.load(robot), hardware)


def _downloaded(source: str, known: str) -> Path:
    from hdsp.learning.hub import download, is_repository

    missing = f"abstraction {source!r}: no folder, and not one of those that come with the package ({known})"
    if not is_repository(source):
        raise InputError(missing)
    try:
        return download(source)
    except InputError as error:
        raise InputError(f"{missing}; {error}") from error


def abstraction_of(robot: Robot, hardware: HardwareSettings | None = None) -> LearnedAbstraction:
    """Loads the shipped abstraction for a robot.

    Raises:
        InputError: there is none for this robot, or only one for a robot with the same name and other values.
    """
    if robot.name not in presets():
        raise InputError(
            f"no trained abstraction for robot {robot.name!r} comes with the package, only for "
            f"{', '.join(presets()) or 'none'}; train one (docs/own-robot.md) and name its folder: 'learned:FOLDER'"
        )
    return load_abstraction(robot.name, robot, hardware)

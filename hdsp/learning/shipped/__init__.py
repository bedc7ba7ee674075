"""Trained abstractions that come with the package, one folder for each: ``config.json``, ``model.safetensors`` and a
model card, ``README.md``. ``python -m pipeline.publish_model`` writes them. A folder has the name of its robot, or
ROBOT-NAME if it is not the one that planners take by default.

Importing this module imports no torch; loading an abstraction does.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from hdsp.base.errors import InputError
from hdsp.robot.robot import Robot

if TYPE_CHECKING:
    from hdsp.learning import HardwareSettings, LearnedAbstraction


def presets() -> list[str]:
    """Names of the abstractions that come with the package: ROBOT, or ROBOT-NAME."""
    places = resources.files(__name__).iterdir()
    return sorted(place.name for place in places if place.joinpath("config.json").is_file())


def robot_of(preset: str) -> str:
    """The robot of an abstraction ROBOT or ROBOT-NAME; a robot's own name may have dashes."""
    fitting = [robot for robot in Robot.presets() if f"{preset}-".startswith(f"{robot}-")]
    return max(fitting, key=len, default=preset)


def load_abstraction(
    source: str | Path, robot: str | Path | dict | Robot | None = None, hardware: HardwareSettings | None = None
) -> LearnedAbstraction:
    """A trained abstraction: ``load_abstraction("momaro")``. Nothing is fetched, and no pickle is read.

    Args:
        source: the name of a preset, or a folder that ``LearnedAbstraction.save_pretrained`` wrote.
        robot: if given, the abstraction has to be one of this robot as it is now. Default: for a preset, its robot.
        hardware: device and precision of inference.

    Raises:
        InputError: there is no such preset or folder; it is damaged, or was trained for another robot, with another
            cost model or another lattice; or torch is not installed.
    """
    names = presets()
    is_preset = str(source) in names
    if not is_preset and not Path(source).is_dir():
        known = ", ".join(names) or "none"
        raise InputError(
            f"abstraction {str(source)!r}: no folder, and not one of those that come with the package ({known})"
        )
    try:
        from hdsp.learning.abstraction import LearnedAbstraction
    except ModuleNotFoundError as error:
        raise InputError(f"learned abstractions need {error.name}: pip install 'hdsp[learning]'") from None
    folder = Path(str(resources.files(__name__).joinpath(str(source)))) if is_preset else Path(source)
    if robot is None and is_preset:
        robot = robot_of(str(source))
    return LearnedAbstraction.from_pretrained(folder, None if robot is None else Robot.load(robot), hardware)


def abstraction_of(robot: Robot, hardware: HardwareSettings | None = None) -> LearnedAbstraction:
    """The abstraction that comes with the package for a robot.

    Raises:
        InputError: there is none for this robot, or only one for a robot of this name with other values.
    """
    if robot.name not in presets():
        raise InputError(
            f"no trained abstraction for robot {robot.name!r} comes with the package, only for "
            f"{', '.join(presets()) or 'none'}; train one (docs/own-robot.md) and name its folder: 'learned:FOLDER'"
        )
    return load_abstraction(robot.name, robot, hardware)

"""Abstractions by their configuration names: as predictors for tasks, and as costs for whole maps."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

from hdsp.base.errors import InputError
from hdsp.robot.robot import Robot

from .config_types import METHODS, SHIPPED, Config, is_own_heuristic
from .stage import Folders, read_json

if TYPE_CHECKING:
    from hdsp.abstract import AbstractCosts, TaskPredictor

#: Output folder of stage `train` for the trained abstraction.
TRAINED_FOLDER = "models/abstraction"
#: Patches that torch judges at once. Their features stay in the cache of a core; 128 take a quarter more time each.
BATCH = 32


def available(names: Iterable[str], robot: Robot) -> list[str]:
    """Returns the names without shipped abstractions that do not exist for this robot; prints the omitted names."""
    from hdsp.learning.loading import presets

    absent = [n for n in names if n.startswith(SHIPPED) and robot.name + n.removeprefix(SHIPPED) not in presets()]
    for name in absent:
        print(f"{name}: skipped, nothing of this name comes with the package for {robot.name}")
    return [name for name in names if name not in absent]


def task_predictor(name: str, config: Config, folders: Folders, model: str = TRAINED_FOLDER) -> TaskPredictor:
    """Returns abstraction `name` as a predictor for single tasks.

    Args:
        name: one of `METHODS`; `shipped`: the robot's shipped abstraction, `shipped-NAME`: its shipped
            abstraction NAME.
        config: stage configuration.
        folders: stage folders.
        model: source for `trained`: a folder, or a shipped abstraction's name.

    Raises:
        InputError: no abstraction has this name; or training has not run yet, or was for another robot.
    """
    robot = config.robot
    if name == "trained" or name.startswith(SHIPPED):
        from hdsp.learning.abstraction import LearnedAbstraction
        from hdsp.learning.architectures import network_class
        from hdsp.learning.loading import load_abstraction, presets

        network_class(config.model.architecture)  # code that the configuration names may be run
        hardware = config.runtime.hardware
        hardware.apply_threads()
        if name.startswith(SHIPPED):
            model = robot.name + name.removeprefix(SHIPPED)
            if model not in presets():
                raise InputError(f"{name}: {model!r} is not one of the package's abstractions, {', '.join(presets())}")
        if model in presets():
            return load_abstraction(model, robot, hardware)
        return LearnedAbstraction.from_pretrained(folders.read(model), robot, hardware)
    if name == "manual":
        from hdsp.abstract import ManualCosts

        return ManualCosts(robot, config.abstraction)
    if name == "flat":
        from hdsp.abstract import FlatCosts

        return FlatCosts(robot)
    raise InputError(f"unknown abstraction {name!r}; allowed are {', '.join(METHODS)}")


def trained_weights(names: Collection[str], folders: Folders, model: str = TRAINED_FOLDER) -> str | None:
    """Returns the checksum of the weights behind `trained`; None if nothing of a folder is judged by this name.

    Args:
        names: the judged abstractions.
        folders: stage folders.
        model: as for `task_predictor`.
    """
    from hdsp.learning.loading import presets

    config = folders.read(model, "config.json")
    if "trained" not in names or model in presets() or not config.is_file():
        return None
    checksum: str | None = read_json(config).get("weights_sha256")
    return checksum


def heuristic_source(name: str, config: Config, folders: Folders) -> AbstractCosts | str:
    """Returns the heuristic of a planner: its name, or abstract costs; raises as `task_predictor`."""
    return name if name == "geometric" or is_own_heuristic(name) else abstract_costs(name, config, folders)


def abstract_costs(name: str, config: Config, folders: Folders) -> AbstractCosts:
    """Returns abstraction `name` as costs for whole maps; raises as `task_predictor`."""
    predictor = task_predictor(name, config, folders)
    from hdsp.abstract import AbstractCosts

    if isinstance(predictor, AbstractCosts):
        return predictor
    from hdsp.learning import LearnedAbstraction, LearnedCosts

    assert isinstance(predictor, LearnedAbstraction)
    return LearnedCosts(predictor, batch=BATCH, robot=config.robot)

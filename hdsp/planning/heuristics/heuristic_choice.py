"""Heuristics by name: those of hdsp, those of other packages, and abstractions as heuristics."""

import inspect

from hdsp.abstract.abstract_costs import AbstractCosts
from hdsp.abstract.manual import ManualCosts
from hdsp.base.errors import InputError
from hdsp.base.extensions import HEURISTICS, extension_place, extensions, load_extension
from hdsp.base.messages import shown
from hdsp.detailed.world.world import World
from hdsp.learning.loading import abstraction_of, load_abstraction
from hdsp.planning.heuristics.abstract import AbstractHeuristic
from hdsp.planning.heuristics.geometric import GeometricHeuristic
from hdsp.planning.heuristics.grid import GridHeuristic
from hdsp.planning.heuristics.heuristic import Heuristic
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap


def heuristic_of(
    asked: str | AbstractCosts | Heuristic, world: World, terrain: HeightMap, robot: Robot, measured: HeightMap
) -> Heuristic:
    """Returns the heuristic for a terrain and a robot.

    Args:
        asked: as for ``Planner``.
        world: terrain and robot, with the planner's margin.
        terrain: the conditioned terrain.
        robot: the robot without the margin.
        measured: the terrain before its conditioning; a finished heuristic cannot belong to it.

    Raises:
        InputError: an unknown name, an abstraction for another robot, or a heuristic for another terrain.
    """
    if isinstance(asked, Heuristic):
        return _checked(asked, world, terrain is measured)
    if isinstance(asked, AbstractCosts) and not isinstance(asked, type):
        return _guided_by(asked, type(asked).__name__, world, terrain, robot)
    name = asked if isinstance(asked, str) else ""
    if name == "geometric":
        return GeometricHeuristic(world)
    if name == "grid":
        return GridHeuristic(world)
    if name == "manual":
        return AbstractHeuristic(world, terrain, ManualCosts(robot), "manual")
    if name == "learned" or (name.startswith("learned:") and name != "learned:"):
        folder = name.removeprefix("learned").removeprefix(":")
        abstraction = load_abstraction(folder, robot) if folder else abstraction_of(robot)
        from hdsp.learning.learned_costs import LearnedCosts

        return _guided_by(LearnedCosts(abstraction, robot=robot), "learned", world, terrain, robot)
    if name and extension_place(HEURISTICS, name) is not None:
        return heuristic_of(_made_elsewhere(name, world, terrain), world, terrain, robot, measured)
    others = "".join(f"'{other}', " for other in sorted(extensions(HEURISTICS)))
    raise InputError(
        f"heuristic {shown(asked)}: need 'geometric', 'grid', 'manual', 'learned', 'learned:FOLDER', {others}"
        "an AbstractCosts or a Heuristic"
    )


def _checked(heuristic: Heuristic, world: World, exact: bool) -> Heuristic:
    made_for = heuristic.world.nx, heuristic.world.ny
    if made_for != (world.nx, world.ny):
        cells = f"{made_for[0]} x {made_for[1]}"
        raise InputError(f"heuristic {heuristic.name} belongs to another terrain, of {cells} cells")
    if not exact:
        raise InputError(
            f"heuristic {heuristic.name} belongs to the terrain before its conditioning; make it for "
            "terrain.conditioned(), or plan with conditioning=None"
        )
    return heuristic


def _guided_by(costs: AbstractCosts, name: str, world: World, terrain: HeightMap, robot: Robot) -> AbstractHeuristic:
    """Returns the heuristic from an abstraction, with the manual one beside it."""
    second = None if type(costs) is ManualCosts else ManualCosts(robot)
    return AbstractHeuristic(world, terrain, costs, name, second)


def _made_elsewhere(name: str, world: World, terrain: HeightMap) -> Heuristic | AbstractCosts:
    """Returns the heuristic that another package makes for a terrain.

    Raises:
        InputError: no function of a world and a terrain, or one that makes something else.
    """
    make = load_extension(HEURISTICS, name)
    try:
        inspect.signature(make).bind(world, terrain)
    except (TypeError, ValueError):  # no function, other arguments, or none that are known
        raise InputError(f"heuristic {name!r}: {shown(make)}; need a function make(world, terrain)") from None
    made = make(world, terrain)
    if not isinstance(made, Heuristic | AbstractCosts):
        raise InputError(f"heuristic {name!r}: {type(made).__name__} is neither a Heuristic nor an AbstractCosts")
    return made

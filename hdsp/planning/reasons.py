"""Reasons in words for a robot operator: an invalid state, a goal out of reach."""

import numpy as np

from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.relaxed.proofs import FOOT, Unreachable, body_hits
from hdsp.detailed.world.world import World, body_is_free, cell_index
from hdsp.robot.lattice import Grid, heading_angle, metres
from hdsp.robot.robot import FEET, Robot


def invalid_because(world: World, grid: Grid, robot: Robot, state: np.ndarray) -> list[str]:
    """Returns the faults in a detailed state, one phrase each; empty for a valid state.

    Args:
        world: terrain and robot, compiled.
        grid: place of the terrain in the world.
        robot: its limits.
        state: int64 [7], lattice units.
    """
    faults = _feet_without_foothold(world, grid, robot, state) + _feet_too_close(robot, state)
    base = int(cell_index(world, state[0], state[1]))
    if not body_is_free(world, int(state[2]), base):
        if world.height[base] == -np.inf:
            faults.append("the ground under the base is unknown")
        else:
            faults.append("the body would hit " + _hit(world, grid, body_hits(world, *(int(v) for v in state[:3]))))
    return faults


def _feet_without_foothold(world: World, grid: Grid, robot: Robot, state: np.ndarray) -> list[str]:
    faults = []
    base = int(cell_index(world, state[0], state[1]))
    low, high = robot.offset_range()
    for foot, name in enumerate(FEET):
        offset = int(state[3 + foot])
        if not low <= offset <= high:
            limits = f"{robot.feet.offset_min:g} to {robot.feet.offset_max:g} m"
            faults.append(f"the {name} foot is out of its reach of {limits}")
            continue
        cell = base + int(world.tables.feet[foot_row(world.tables, int(state[2]), foot, offset - low)])
        if world.standable[cell]:
            continue
        x, y = grid.center((cell // world.stride - world.pad, cell % world.stride - world.pad))
        if world.height[cell] == -np.inf:
            why = "the ground there is unknown or off the map"
        else:
            why = f"an edge higher than {robot.drive.max_height_difference:g} m is within {robot.feet.clearance:g} m"
        faults.append(f"the {name} foot cannot stand at ({x:.2f}, {y:.2f}) m: {why}")
    return faults


def _feet_too_close(robot: Robot, state: np.ndarray) -> list[str]:
    faults, least = [], robot.feet.min_separation
    for side, front, rear in (("left", 0, 1), ("right", 3, 2)):
        apart = 2 * robot.feet.neutral_x + metres(state[3 + front] - state[3 + rear])
        if apart < least - 1e-9:
            faults.append(f"the {side} feet are too close to each other: {apart:.3f} m, and {least:g} m are needed")
    return faults


def unreachable_because(proof: Unreachable, world: World, grid: Grid) -> str:
    """Describes the obstacle between a start and a goal."""
    (x0, y0), (x1, y1) = grid.center(proof.from_start), grid.center(proof.from_goal)
    gap = f"from ({x0:.2f}, {y0:.2f}) to ({x1:.2f}, {y1:.2f}) m"
    if proof.proof == FOOT:
        cells = np.concatenate([proof.from_start[None], proof.blocked, proof.from_goal[None]])
        heights = world.height[[cell_index(world, *cell) for cell in cells]]
        words = f"the {FEET[proof.foot]} foot gets nowhere {gap}, neither by rolling nor by stepping"
        if np.isfinite(heights).all():
            words += (
                f": the ground is at {heights[0]:.2f} m, at {heights[-1]:.2f} m and between up to {heights.max():.2f} m"
            )
        return words
    found = [f"the {FEET[foot]} foot finds no foothold" for foot in proof.footless]
    if len(proof.body_hits):
        found.append("the body would hit " + _hit(world, grid, proof.body_hits))
    where = f"the robot cannot get {gap}, where the ways from start and goal come nearest to each other"
    if not found:
        return where
    degrees = float(np.degrees(heading_angle(proof.heading)))
    return f"{where}: between, heading {degrees:.0f} degrees, " + " and ".join(found)


def _hit(world: World, grid: Grid, cells: np.ndarray) -> str:
    """Describes the obstacle in front of the body, the first cell in ``cells`` [n, 2]."""
    x, y = grid.center(cells[0])
    return f"what rises to {world.height[cell_index(world, *cells[0])]:.2f} m at ({x:.2f}, {y:.2f}) m"

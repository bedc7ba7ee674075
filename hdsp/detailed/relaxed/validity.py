"""Why a detailed state is not valid, in words for a robot operator."""

import numpy as np

from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.relaxed.proofs import FOOT, Unreachable, body_hits
from hdsp.detailed.world.world import World, body_is_free, cell_index
from hdsp.robot.lattice import Grid, heading_angle, metres
from hdsp.robot.robot import FEET, Robot


def problems(world: World, grid: Grid, robot: Robot, state: np.ndarray) -> list[str]:
    """What is wrong with a detailed state, one phrase each; empty if it is valid.

    Args:
        world: terrain and robot, compiled.
        grid: where the terrain lies in the world.
        robot: for its limits.
        state: int64 [7], lattice units.
    """
    found = []
    base = int(cell_index(world, state[0], state[1]))
    low, high = robot.offset_range()
    offsets = np.clip(state[3:], low, high)
    for foot, name in enumerate(FEET):
        if offsets[foot] != state[3 + foot]:
            limits = f"{robot.feet.offset_min:g} to {robot.feet.offset_max:g} m"
            found.append(f"the {name} foot is out of its reach of {limits}")
            continue
        cell = base + int(world.tables.feet[foot_row(world.tables, int(state[2]), foot, int(offsets[foot]) - low)])
        if world.standable[cell]:
            continue
        x, y = grid.center((cell // world.stride - world.pad, cell % world.stride - world.pad))
        if world.height[cell] == -np.inf:
            why = "the ground there is unknown or off the map"
        else:
            why = f"an edge higher than {robot.drive.max_height_difference:g} m is within {robot.feet.clearance:g} m"
        found.append(f"the {name} foot cannot stand at ({x:.2f}, {y:.2f}) m: {why}")
    for side, front, rear in (("left", 0, 1), ("right", 3, 2)):
        apart = 2 * robot.feet.neutral_x + metres(state[3 + front] - state[3 + rear])
        if apart < robot.feet.min_separation - 1e-9:
            least = robot.feet.min_separation
            found.append(f"the {side} feet are too close to each other: {apart:.3f} m, and {least:g} m are needed")
    if not body_is_free(world, int(state[2]), base):
        if world.height[base] == -np.inf:
            found.append("the ground under the base is unknown")
        else:
            found.append("the body would hit " + _hit(world, grid, body_hits(world, *(int(v) for v in state[:3]))))
    return found


def in_words(proof: Unreachable, world: World, grid: Grid) -> str:
    """What cuts a start off from a goal."""
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
    """What the body hits, by its height and place."""
    x, y = grid.center(cells[0])
    return f"what rises to {world.height[cell_index(world, *cells[0])]:.2f} m at ({x:.2f}, {y:.2f}) m"

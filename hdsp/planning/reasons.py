"""Reasons in words for a robot operator: an invalid state, a goal out of reach."""

import numpy as np

from hdsp.detailed.actions.state_costs import foot_row, state_cost
from hdsp.detailed.relaxed.proofs import FOOT, Unreachable, body_hits
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.body import is_steep
from hdsp.detailed.world.world import World, cell_index
from hdsp.robot.lattice import Grid, heading_angle, metres
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.cost_maps import slope_directions


def invalid_because(world: World, grid: Grid, robot: Robot, state: np.ndarray) -> list[str]:
    """Returns the faults in a detailed state, one phrase each; empty for a valid state.

    Args:
        world: terrain and robot, compiled.
        grid: place of the terrain in the world.
        robot: its limits.
        state: int64 [7], lattice units.
    """
    footless = _feet_without_foothold(world, grid, robot, state)
    faults = footless + _feet_too_close(robot, state)
    base = int(cell_index(world, state[0], state[1]))
    if world.height[base] == -np.inf:
        faults.append("the ground under the base is unknown")
    elif not footless and not np.isfinite(state_cost(world, pack_states(state, world.tables.lowest)[0])):
        faults += _feet_on_slopes(world, grid, robot, state)
    if len(hits := body_hits(world, state)):
        faults.append("the body would hit " + _hit(world, grid, hits))
    return faults


def _feet_on_slopes(world: World, grid: Grid, robot: Robot, state: np.ndarray) -> list[str]:
    """Feet on ground that is too steep at this heading, though not at every heading."""
    faults = []
    for foot, name in enumerate(FEET):
        cell = _cell_under(world, state, foot)
        if is_steep(world, int(state[2]), cell, cell, cell, cell):
            x, y = grid.center(_place(world, cell))
            why = f"{_steepness(world, robot, cell)} at this heading"
            faults.append(f"the {name} foot cannot stand at ({x:.2f}, {y:.2f}) m: {why}")
    return faults


def _cell_under(world: World, state: np.ndarray, foot: int) -> int:
    row = foot_row(world.tables, int(state[2]), foot, int(state[3 + foot]) - world.tables.lowest)
    return int(cell_index(world, state[0], state[1])) + int(world.tables.feet[row])


def _place(world: World, cell: int) -> tuple[int, int]:
    return cell // world.stride - world.pad, cell % world.stride - world.pad


def _is_steep_everywhere(world: World, robot: Robot, cell: int) -> bool:
    """Whether a slope alone closes a flat cell at all headings: it is no edge and known."""
    around = [cell + i * world.stride + j for i in (-1, 0, 1) for j in (-1, 0, 1)]
    heights = world.height[[q for q in around if 0 <= q < len(world.height)]]
    if not world.edge[cell] or world.height[cell] == -np.inf:
        return False
    return float(abs(heights - world.height[cell])[np.isfinite(heights)].max()) <= robot.drive.highest_edge


def _steepness(world: World, robot: Robot, cell: int) -> str:
    ahead, across = np.degrees([robot.slope.max_pitch, robot.slope.max_roll])
    limits = f"{ahead:.1f} degrees" if ahead == across else f"{ahead:.1f} degrees ahead and {across:.1f} across"
    return f"the ground is too steep there, {_inclination(world, robot, cell):.1f} degrees; the robot takes {limits}"


def _inclination(world: World, robot: Robot, cell: int) -> float:
    """Steepest inclination (degrees) at a flat cell, over the lengths on which slopes are measured."""
    steepest = 0.0
    for offsets in slope_directions(robot).tolist():
        for dx, dy in offsets:
            step = dx * world.stride + dy
            if world.edge[cell + step] and world.edge[cell - step] and not world.edge[cell]:
                break
            rise = float(abs(world.height[cell + step] - world.height[cell - step]))
            if robot.drive.highest_edge < rise < np.inf:
                steepest = max(steepest, rise / (2 * metres(float(np.hypot(dx, dy)))))
    return float(np.degrees(np.arctan(steepest)))


def _feet_without_foothold(world: World, grid: Grid, robot: Robot, state: np.ndarray) -> list[str]:
    faults = []
    low, high = robot.offset_range()
    for foot, name in enumerate(FEET):
        offset = int(state[3 + foot])
        if not low <= offset <= high:
            limits = f"{robot.feet.offset_min:g} to {robot.feet.offset_max:g} m"
            faults.append(f"the {name} foot is out of its reach of {limits}")
            continue
        cell = _cell_under(world, state, foot)
        if world.standable[cell]:
            continue
        x, y = grid.center(_place(world, cell))
        if _is_steep_everywhere(world, robot, cell):
            why = _steepness(world, robot, cell)
        elif world.height[cell] == -np.inf:
            why = "the ground there is unknown or off the map"
        else:
            why = f"an edge higher than {robot.drive.highest_edge:g} m is within {robot.feet.clearance:g} m"
        faults.append(f"the {name} foot cannot stand at ({x:.2f}, {y:.2f}) m: {why}")
    return faults


def _feet_too_close(robot: Robot, state: np.ndarray) -> list[str]:
    faults, least = [], robot.feet.min_separation
    for side, front, rear in (("left", 0, 1), ("right", 3, 2)):
        apart = 2 * robot.feet.neutral_x + metres(state[3 + front] - state[3 + rear])
        if apart < least - 1e-9:
            faults.append(f"the {side} feet are too close to each other: {apart:.3f} m, and {least:g} m are needed")
    return faults


def unreachable_because(proof: Unreachable, world: World, grid: Grid, robot: Robot) -> str:
    """Describes the obstacle between a start and a goal."""
    words, cells = _obstacle(proof, world, grid)
    steep = [cell for cell in cells if _is_steep_everywhere(world, robot, cell)]
    if steep:
        steepest = max(steep, key=lambda cell: _inclination(world, robot, cell))
        x, y = grid.center(_place(world, steepest))
        words += f"; at ({x:.2f}, {y:.2f}) m {_steepness(world, robot, steepest)}"
    return words


def _obstacle(proof: Unreachable, world: World, grid: Grid) -> tuple[str, list[int]]:
    """Words about the obstacle, and flat cells on which it stops feet."""
    (x0, y0), (x1, y1) = grid.center(proof.from_start), grid.center(proof.from_goal)
    gap = f"from ({x0:.2f}, {y0:.2f}) to ({x1:.2f}, {y1:.2f}) m"
    if proof.proof == FOOT:
        cells = np.concatenate([proof.from_start[None], proof.blocked, proof.from_goal[None]])
        flat = [int(cell_index(world, *cell)) for cell in cells]
        heights = world.height[flat]
        words = f"the {FEET[proof.foot]} foot gets nowhere {gap}, neither by rolling nor by stepping"
        if np.isfinite(heights).all():
            words += (
                f": the ground is at {heights[0]:.2f} m, at {heights[-1]:.2f} m and between up to {heights.max():.2f} m"
            )
        return words, flat
    stopped = _cells_of_footless(proof, world)
    found = [f"the {FEET[foot]} foot finds no foothold" for foot in proof.footless]
    if len(proof.body_hits):
        found.append("the body would hit " + _hit(world, grid, proof.body_hits))
    where = f"the robot cannot get {gap}, where the ways from start and goal come nearest to each other"
    if not found:
        return where, stopped
    degrees = float(np.degrees(heading_angle(proof.heading)))
    return f"{where}: between, heading {degrees:.0f} degrees, " + " and ".join(found), stopped


def _cells_of_footless(proof: Unreachable, world: World) -> list[int]:
    """Flat cells under the base and under its feet at all offsets along the gap, at the heading along it."""
    low, offsets = world.tables.lowest, range(world.tables.n_offsets)
    cells = set()
    for x, y in proof.blocked[:: max(len(proof.blocked) // 8, 1)]:
        state = np.array([x, y, proof.heading, 0, 0, 0, 0])
        for foot in range(4):
            for offset in offsets:
                state[3 + foot] = offset + low
                cells.add(_cell_under(world, state, foot))
    return sorted(cell for cell in cells if 0 <= cell < len(world.height))


def _hit(world: World, grid: Grid, cells: np.ndarray) -> str:
    """Describes the obstacle in front of the body, the first cell in ``cells`` [n, 2]."""
    x, y = grid.center(cells[0])
    return f"the ground that rises to {world.height[cell_index(world, *cells[0])]:.2f} m at ({x:.2f}, {y:.2f}) m"

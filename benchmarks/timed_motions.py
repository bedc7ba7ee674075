"""Motions with times: limits of speed and acceleration, and stability between the configurations.

    python -m benchmarks.timed_motions [--plans 200] [--seed 0] [--rate 100] [--page docs/motions.md]

Each plan leads from the middle of a random map of 3.6 x 3.6 m to a random pose; maps come from all categories of
terrain, and the robots take turns. The states of each motion at regular times are measured without the code that made
the times: speeds and accelerations are differences of positions.

One JSON line comes last. `speed_over` is the largest share by which a speed exceeds its limit, 0 if none does, and
`acceleration_over` the same for accelerations. `unstable` counts states whose centre of mass is nearer to the edges of
the support polygon than the robot's margin. `problems` counts the other findings of the motion check in these states; a
foot that rolls over an edge between cells may be off the ground by the height of an edge that its wheel passes. `steps`
and `configurations` are totals, `mean_duration_s` and `longest_s` durations, and `timing_ms` is the mean CPU time that
the times of a motion take. `--page` writes a table into the page.
"""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.page import table, write_block
from hdsp.base.errors import InputError, RefinementError
from hdsp.detailed.motion.motion import Motion
from hdsp.planning.planner import Planner
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.scenes import ALL_CATEGORIES, random_map

CELLS = 144
FAR = 1.3  # m, of a goal along each axis
EXPANSIONS = 30_000
_REST = 1e-6  # m/s
_SLACK = 1e-6
_TOUCHES = "above the ground", "below the ground"  # findings about a foot


def motions(seed: int, robots: tuple[str, ...] = ("momaro", "anymal_wheels", "go2w")) -> Iterator[tuple[Motion, int]]:
    """Yields motions without end, each with its number of steps; a task depends on seed and number alone."""
    loaded = [Robot.load(name) for name in robots]
    number = 0
    while True:
        random = np.random.default_rng((seed, number))
        terrain = random_map(seed, ALL_CATEGORIES[number % len(ALL_CATEGORIES)], number, cells=CELLS)
        goal = (*random.uniform(-FAR, FAR, 2).tolist(), float(random.uniform(-np.pi, np.pi)))
        plan = Planner(terrain, loaded[number % len(loaded)], "manual")
        number += 1
        try:
            found = plan.plan((0.0, 0.0, 0.0), goal, weight=2.0, expansions=EXPANSIONS, refinable=True, polish=0)
            if found.solved and len(found.actions):
                yield found.refine(), found.steps
        except (InputError, RefinementError):  # the robot cannot stand there
            continue


def excesses(motion: Motion, rate: float) -> tuple[float, float]:
    """Largest shares by which speeds and accelerations of a motion exceed their limits, at so many states per s."""
    speeds, accelerations = motion.robot.speeds, motion.robot.accelerations
    times = np.linspace(0.0, motion.duration, max(3, int(motion.duration * rate)))
    state = motion.at(times)
    cos, sin = np.cos(state.base[:, 5]), np.sin(state.base[:, 5])
    turn = np.zeros((len(times), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = cos, sin, -sin, cos, 1.0
    relative = np.einsum("nij,nfj->nfi", turn, state.feet - state.base[:, None, :3])
    grounded = state.carries[1:] & state.carries[:-1]
    wheels = np.where(grounded[..., None], np.diff(state.feet[..., :2], axis=0), 0.0) / np.diff(times)[:, None, None]
    driving = (np.linalg.norm(wheels, axis=2) > _REST).any(axis=1)
    # Both intervals of a difference of velocities may be in another regime.
    either = driving[1:] | driving[:-1]
    measured = [
        (state.base[:, None, :2], np.where(driving, speeds.drive, speeds.shift),
         np.where(either, accelerations.drive, accelerations.shift)),
        (state.base[:, None, 2:3], speeds.height, accelerations.height),
        (state.base[:, 3:5, None], speeds.lean, accelerations.lean),
        (state.base[:, None, 5:6], speeds.turn, accelerations.turn),
        (relative[..., :2], speeds.foot, accelerations.foot),
        (relative[..., 2:], speeds.lift, accelerations.lift),
    ]  # fmt: skip
    over = [np.linalg.norm(wheels, axis=2).max() / speeds.drive - 1]
    over_acceleration = [0.0]
    for values, speed, acceleration in measured:
        velocity = np.diff(values, axis=0) / np.diff(times)[:, None, None]
        change = np.diff(velocity, axis=0) / np.diff(times)[1:, None, None]
        over.append((np.linalg.norm(velocity, axis=2).max(axis=1) / speed).max() - 1)
        over_acceleration.append((np.linalg.norm(change, axis=2).max(axis=1) / acceleration).max() - 1)
    return max(0.0, float(max(over))), max(0.0, float(max(over_acceleration)))


def findings(motion: Motion, rate: float) -> tuple[int, list[str]]:
    """Number of unstable states, and words for all other violations, at so many states per s."""
    state = motion.at(np.linspace(0.0, motion.duration, max(3, int(motion.duration * rate))))
    names = {"base": state.base, "carries": state.carries, "action": state.action, "phase": state.phase}
    sampled = replace(motion, feet=state.feet, **names)
    unstable = int((state.margin < motion.robot.stance.margin - _SLACK).sum())
    over = sampled.heights_over_ground()
    rolls = state.carries & (np.linalg.norm(state.feet_velocity[..., :2], axis=2) > _REST)
    on_edge = rolls & (np.abs(over) <= motion.robot.drive.highest_edge)
    found = [(n, text) for n, text in sampled.problems() if "centre of mass" not in text]
    return unstable, [text for n, text in found if not (text.endswith(_TOUCHES) and _names_one(text, on_edge[n]))]


def _names_one(text: str, feet: np.ndarray) -> bool:
    """Whether a finding is about one of the feet, bool [4]."""
    return any(of and name in text for of, name in zip(feet, FEET, strict=True))


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plans", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rate", type=float, default=100.0, help="states per s")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    if arguments.plans < 1:
        raise InputError(f"--plans is {arguments.plans}; need at least 1")
    speed, acceleration, unstable, words = 0.0, 0.0, 0, []
    steps, configurations, durations, spent = 0, 0, [], 0.0
    for number, (motion, made) in zip(range(arguments.plans), motions(arguments.seed), strict=False):
        began = time.process_time()
        durations.append(motion.duration)
        spent += time.process_time() - began
        over = excesses(motion, arguments.rate)
        speed, acceleration = max(speed, over[0]), max(acceleration, over[1])
        found = findings(motion, arguments.rate)
        unstable, words, steps = unstable + found[0], words + found[1], steps + made
        configurations += len(motion)
        print(
            f"{number + 1:4d}/{arguments.plans} {motion.robot.name:14s} {len(motion):5d} configurations {made:2d} steps"
            f" {motion.duration:6.1f} s  over {over[0]:.4f} {over[1]:.4f}  unstable {found[0]}  {found[1][:1]}",
            flush=True,
        )
    result = {
        "plans": len(durations),
        "steps": steps,
        "configurations": configurations,
        "speed_over": round(speed, 4),
        "acceleration_over": round(acceleration, 4),
        "unstable": unstable,
        "problems": len(words),
        "mean_duration_s": round(float(np.mean(durations)), 1),
        "longest_s": round(max(durations), 1),
        "timing_ms": round(1000 * spent / len(durations), 2),
    }
    if arguments.page:
        write_block(arguments.page, "benchmarks.timed_motions", text(result))
    print(json.dumps(result))
    return result


def text(result: dict) -> str:
    """Formats the result for the page."""
    names = {
        "plans": "motions", "steps": "steps in them", "configurations": "configurations",
        "speed_over": "largest share over a speed", "acceleration_over": "largest share over an acceleration",
        "unstable": "unstable states", "problems": "other findings of the check",
        "mean_duration_s": "mean duration (s)", "longest_s": "longest (s)", "timing_ms": "CPU time for the times (ms)",
    }  # fmt: skip
    return table(["measured", "value"], [[name, result[key]] for key, name in names.items()])


if __name__ == "__main__":
    main()

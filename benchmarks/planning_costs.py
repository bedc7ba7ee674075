"""Two kinds of costs: how much more labels cost than the planner, and how well a factor corrects them.

    python -m benchmarks.planning_costs [--seeds 0 1 2 3 4 5] [--size 5] [--states 100] [--page docs/cost-model.md]

Labels keep a window of headings, planning costs do not (`hdsp.abstract.CostKind`). The oracle computes both on random
arenas, from random states at which the robot can stand. Three predictions of the planning cost are compared, each
relative to the true one:

- label: the label cost itself;
- corrected: the label cost times the ratio of both costs on flat ground, by heading and action
  (`hdsp.abstract.flat_table.planning_factors`), as `LearnedCosts` plans;
- measured: the label cost divided by the mean ratio of tasks with the same goal in the other arenas.

The last line is JSON: mean and largest ratio (`label_over_planning_mean`, `_max`, and the same for `corrected` and
`measured`), the mean absolute deviation from 1 (`_error`), and actions that are feasible in planning alone. `--page`
writes a table by kind of action into the page.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.page import table, write_block
from hdsp.abstract import CostKind, OracleCosts
from hdsp.abstract.flat_table import planning_factors
from hdsp.base.workers import ClusterSettings
from hdsp.detailed.world.world import build_world
from hdsp.planning.heuristics import standing_states
from hdsp.robot.lattice import ABSTRACT_ACTIONS, robot_frame_goals
from hdsp.robot.robot import Robot
from hdsp.terrain.random_arenas import random_arena


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default="momaro")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4, 5], help="random arenas")
    parser.add_argument("--size", type=float, default=5.0, help="side of the arenas, m")
    parser.add_argument("--states", type=int, default=100, help="states per arena")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)

    robot = Robot.load(arguments.robot)
    cluster = ClusterSettings(arguments.workers, dashboard=None)
    costs = {kind: OracleCosts(robot, kind, cluster=cluster) for kind in CostKind}
    arena, heading, label, planning = [], [], [], []
    for seed in arguments.seeds:
        terrain = random_arena(seed, arguments.size)
        mask = _sample(standing_states(build_world(terrain, robot)), arguments.states, seed)
        found = {kind: of.edges(terrain, mask=mask)[mask] for kind, of in costs.items()}
        label.append(found[CostKind.LABEL])
        planning.append(found[CostKind.PLANNING])
        heading.append(np.argwhere(mask)[:, 0])
        arena.append(np.full(len(heading[-1]), seed))
        print(f"arena {seed}: {len(heading[-1])} states", flush=True)
    ratios = _ratios(
        np.concatenate(arena), np.concatenate(heading), np.concatenate(label), np.concatenate(planning), robot
    )
    both = np.isfinite(ratios["label_over_planning"])
    result = {"arenas": len(arguments.seeds), "states": len(both), "actions": int(both.sum())}
    for name, values in ratios.items():
        result[f"{name}_mean"] = round(float(values[both].mean()), 4)
        result[f"{name}_max"] = round(float(values[both].max()), 4)
        result[f"{name}_error"] = round(float(abs(values[both] - 1).mean()), 4)
    alone = np.isfinite(np.concatenate(planning)) & ~np.isfinite(np.concatenate(label))
    result["planning_alone"] = round(float(alone.sum() / np.isfinite(np.concatenate(planning)).sum()), 4)
    shown = _by_action(ratios, np.concatenate(heading))
    print(shown)
    if arguments.page:
        write_block(arguments.page, "benchmarks.planning_costs", shown)
    print(json.dumps(result))
    return result


def _sample(standing: np.ndarray, count: int, seed: int) -> np.ndarray:
    states = np.argwhere(standing)
    mask = np.zeros_like(standing)
    mask[tuple(np.random.default_rng(seed).permutation(states)[:count].T)] = True
    return mask


def _ratios(arena, heading, label, planning, robot: Robot) -> dict[str, np.ndarray]:
    """Predicted over planning cost, float64 [states, 22] by prediction; NaN where one of both costs is infinite."""
    both = np.isfinite(label) & np.isfinite(planning)
    ratio = np.divide(label, planning, out=np.full(label.shape, np.nan), where=both)
    measured = np.full_like(ratio, np.nan)
    # A quarter turn permutes the actions: actions are compared by their goal in the robot frame.
    goals = np.stack([robot_frame_goals(int(k)) for k in heading])
    key = np.round(goals @ np.array([1.0, 100.0, 10_000.0]), 1)
    for seed in np.unique(arena):
        own = np.broadcast_to((arena == seed)[:, None], ratio.shape)
        for goal in np.unique(key):
            others = (key == goal) & both & ~own
            if others.any():
                here = (key == goal) & own
                measured[here] = ratio[here] * np.mean(1 / ratio[others])
    measured = np.where(both & np.isnan(measured), ratio, measured)
    return {
        "label_over_planning": ratio,
        "corrected": ratio * planning_factors(robot)[heading],
        "measured": measured,
    }


def _by_action(ratios: dict[str, np.ndarray], heading: np.ndarray) -> str:
    goals = np.stack([robot_frame_goals(int(k)) for k in heading])
    angle = np.degrees(np.abs(np.arctan2(goals[..., 1], goals[..., 0])))
    turning = np.broadcast_to(ABSTRACT_ACTIONS[:, 2] != 0, angle.shape)
    groups = {"turn": turning}
    for name, low, high in (("ahead", 0, 30), ("oblique", 30, 75), ("sideways", 75, 105), ("back", 105, 181)):
        groups[name] = ~turning & (angle >= low) & (angle < high)
    rows = []
    for name, group in groups.items():
        of = [values[group & np.isfinite(values)] for values in ratios.values()]
        figures = [f"{value:.3f}" for values in of for value in (values.mean(), values.max(), abs(values - 1).mean())]
        rows.append([name, len(of[0]), *figures])
    head = [
        f"{name}: {figure}" for name in ("label", "corrected", "measured") for figure in ("mean", "largest", "error")
    ]
    return table(["action", "tasks", *head], rows)


if __name__ == "__main__":
    main()

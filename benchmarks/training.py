"""Training throughput: one pass per map for all its 22 goals, against one pass per task, in one run.

    python -m benchmarks.training [--model klamt2019] [--maps 8] [--repeats 3] [--page docs/pipeline.md]

All methods pass the same tasks through the same network, forward and backward with the training losses, on one thread
in float32; their measurements alternate. `separate` puts all tasks into one batch, each with its own copy of the patch;
`one_by_one` passes single tasks, like the paper's training. Gradients have to agree: `gradient_difference` is the
greatest difference relative to the parameter's largest gradient, and the run ends above 1e-4. Times are CPU times. The
last line is JSON; `ratio` is shared over separate tasks per second. `--page` writes the result into the page.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch

from benchmarks.page import table, write_block
from hdsp.base.errors import InputError
from hdsp.learning import build_network, count_parameters
from hdsp.learning.metrics import task_losses
from hdsp.learning.task_data import Batch
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS, robot_frame_goals
from hdsp.terrain.scenes import CATEGORIES, random_map
from pipeline.config import compose, plain

#: Greatest allowed relative difference between gradients.
TOLERANCE = 1e-4


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", default="klamt2019", help="file in conf/model")
    parser.add_argument("--maps", type=int, default=8)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    if min(arguments.maps, arguments.repeats) < 1:
        raise InputError("benchmark: maps and repeats have to be at least 1")

    torch.set_num_threads(1)
    torch.manual_seed(0)
    network = build_network(plain(compose([f"model={arguments.model}"]).model)).to(memory_format=torch.channels_last)
    shared = random_tasks(arguments.maps)
    ways = {"shared": [shared], "separate": [separated(shared)], "one_by_one": singles(separated(shared))}
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    gradients = {}
    for repeat in range(arguments.repeats + 1):
        for name, batches in ways.items():
            if name == "one_by_one" and repeat > 1:
                continue  # slow, and no ratio depends on it
            network.zero_grad()
            began = time.process_time()
            for batch in batches:
                pass_through(network, batch, shared)
            if repeat:  # in the first pass, libraries choose their algorithms
                seconds[name].append(time.process_time() - began)
            gradients[name] = [parameter.grad.clone() for parameter in network.parameters()]

    difference = max(
        float((one - other).abs().max() / one.abs().max().clamp_min(1e-12))
        for name in ("separate", "one_by_one")
        for one, other in zip(gradients["shared"], gradients[name], strict=True)
    )
    assert difference <= TOLERANCE, f"gradients differ by {difference:.2g} of their size"
    tasks = arguments.maps * N_ABSTRACT_ACTIONS
    rates = {name: tasks / min(found) for name, found in seconds.items()}
    result = {
        "model": arguments.model,
        "parameters": count_parameters(network),
        "maps": arguments.maps,
        "tasks_per_s": {name: round(rate, 1) for name, rate in rates.items()},
        "ratio": round(rates["shared"] / rates["separate"], 2),
        "ratio_to_one_by_one": round(rates["shared"] / rates["one_by_one"], 2),
        "gradient_difference": difference,
    }
    if arguments.page:
        write_block(arguments.page, "benchmarks.training", text(result))
    print(json.dumps(result))
    return result


def text(result: dict) -> str:
    """Formats the result for the page."""
    rates = result["tasks_per_s"]
    ways = [
        ("shared: each map once for its goals", "shared", 1),
        ("separate: each task with its own copy of the map", "separate", result["ratio"]),
        ("single: batches with one task", "one_by_one", result["ratio_to_one_by_one"]),
    ]
    rows = [[way, rates[name], round(rates[name] / N_ABSTRACT_ACTIONS, 2), slower] for way, name, slower in ways]
    head = ["way", "tasks per second", "maps per second", "speed-up of shared"]
    counted = (
        f"Model {result['model']}, {result['parameters']:,} parameters, {result['maps']} maps with "
        f"{N_ABSTRACT_ACTIONS} tasks each, one thread. Gradients agree up to a relative difference of "
        f"{result['gradient_difference']:.1g}."
    )
    return f"{table(head, rows)}\n\n{counted}"


def random_tasks(maps: int) -> Batch:
    """Random terrain with arbitrary labels, which do not influence the step time."""
    random = np.random.default_rng(0)
    heights = np.stack([random_map(0, CATEGORIES[k % len(CATEGORIES)], k).heights for k in range(maps)])
    goals = np.stack([robot_frame_goals(k % 4) for k in range(maps)])
    feasible = random.random((maps, N_ABSTRACT_ACTIONS)) < 0.6
    cost = np.where(feasible, random.uniform(0.1, 1.0, feasible.shape), 0)
    return Batch(
        torch.from_numpy(heights[:, None]),
        torch.from_numpy(goals.astype(np.float32)),
        torch.from_numpy(feasible),
        torch.from_numpy(cost.astype(np.float32)),
    )


def separated(batch: Batch) -> Batch:
    """The same tasks, each with its own patch and one goal."""
    heights = batch.heights.repeat_interleave(N_ABSTRACT_ACTIONS, dim=0)
    return Batch(heights, *(part.flatten(0, 1)[:, None] for part in batch[1:]))


def singles(batch: Batch) -> list[Batch]:
    """One batch per task."""
    return [Batch(*(part[k : k + 1] for part in batch)) for k in range(len(batch.heights))]


def pass_through(network: torch.nn.Module, batch: Batch, whole: Batch) -> None:
    """Adds gradients for a batch's share in the losses over ``whole``."""
    cost, logits, *_ = network(batch.heights, batch.goals)
    feasibility, error = task_losses(cost, logits, batch.feasible, batch.cost)
    share = batch.feasible.numel() / whole.feasible.numel()
    share_feasible = batch.feasible.sum() / whole.feasible.sum()
    (share * feasibility + share_feasible * error).backward()


if __name__ == "__main__":
    main()

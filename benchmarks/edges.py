"""Costs of all abstract actions on a 10 x 10 m map: dense against per patch, and an update of 1 m2.

    python -m benchmarks.edges [--size 10] [--sample 0.01] [--threads 2] [--precision 32] [--large]

The last line is JSON. `whole_map_cpu_s` are the processor seconds of the shipped network on an arena of this size, for
all `standing_states`, as `heuristic="learned"` evaluates it. `before_over_now` compares processor seconds for one
heading with dense evaluation in torch, in float32.

For all other keys, the network is the paper's without zero padding, with random weights, because neither speed nor
equality depends on training. All patches on the map differ, so each is evaluated.

`dense_s` covers the whole map. `patches_s` extrapolates from a random sample of states, evaluated patch by patch with
one trunk evaluation for 22 actions. On this sample, `largest_difference` compares the costs, and `differently_feasible`
is the share of actions feasible for one method only. `update_ratio` compares an update (edges, graph and Dijkstra)
after a height change on 1 m2 in the middle with the same work for the whole map; `update_identical` tells whether both
results are identical to the bit. `*_cpu_s` are processor seconds over all threads, which depend little on other work on
the machine; `cpu_ratio` and `update_cpu_ratio` compare them.

`first_query_cpu_s` is the median over the paper arena's goals, each with a new planner on its map, at W = 1.25, without
the compilation of the terrain; `share_evaluated` is the median share of the states at which the robot can stand whose
edges this query evaluated. `update_cpu_s` and `manual_update_cpu_s` are medians over changes, learned and manual: a
block of 30 cm appears beside the way, and the last query follows again.

With `--large`, `large_20_*` and `large_50_*` are about first queries from corner to corner of random arenas with sides
of 20 and 50 m, and `manual_100_*` about the preparation of a map of 100 m with manual edges, of equal arenas side by
side: `cpu_s`, and `gb`, the most memory of a process of its own, libraries included.

`padded_*` compare dense evaluation of the published network, an approximation, with its exact evaluation in the middle
of the map. Dense evaluation sees the map where a patch has zeros, and the base is off by up to half a cell. The figures
are the share of actions judged differently, and the mean cost difference relative to the mean cost.
"""

import argparse
import json
import time
from pathlib import Path
from statistics import median

import numpy as np

CELLS_PER_METRE = 40
PAPER = Path(__file__).parents[1] / "conf/arena/paper.yaml"
WEIGHT = 1.25
BLOCK, HEIGHT = 12, 0.1  # cells along a side, m
CHANGES = 5


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=float, default=10.0, help="metres along each side of the map, 3 or more")
    parser.add_argument("--sample", type=float, default=0.01, help="share of the states evaluated patch by patch")
    parser.add_argument("--threads", type=int, help="torch threads; default: torch's choice")
    parser.add_argument("--precision", choices=("32", "bf16"), default="32")
    parser.add_argument("--device", choices=("cpu", "gpu"), default="cpu")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--large", action="store_true", help="also maps of 20, 50 and 100 m; takes minutes more")
    arguments = parser.parse_args(argv)

    from hdsp.abstract import PreparedGraph
    from hdsp.learning import HardwareSettings, LearnedCosts
    from hdsp.robot.lattice import abstract_shape
    from hdsp.terrain.height_map import HeightMap

    hardware = HardwareSettings(arguments.device, arguments.precision, arguments.threads)
    hardware.apply_threads()
    network = random_abstraction(hardware, architecture="klamt2019", options={"padded": False})
    dense, patches = LearnedCosts(network), LearnedCosts(network, method="patches")
    before = rough_map((round(arguments.size * CELLS_PER_METRE),) * 2, arguments.seed)
    shape = (16, *abstract_shape(before.shape))
    sample = np.random.default_rng(arguments.seed).random(shape) < arguments.sample
    goal = (shape[1] // 4, shape[2] // 3, 0)

    # A small map first compiles kernels and lets libraries choose their algorithms.
    small = HeightMap(before.heights[:100, :100])
    update(dense, small, small.heights > 0.19, PreparedGraph.from_edges(dense.edges(small)), (0, 0, 0))
    patches.edges(small, mask=sample[:, :25, :25])

    dense_s, dense_cpu_s, edges = timed(lambda: dense.edges(before))
    found = edges[sample]
    sample_s, sample_cpu_s, expected = timed(lambda: patches.edges(before, mask=sample))
    patches_s, patches_cpu_s = (seconds * sample.size / sample.sum() for seconds in (sample_s, sample_cpu_s))

    changed = np.zeros(before.shape, bool)
    low = (before.shape[0] - CELLS_PER_METRE) // 2
    changed[low : low + CELLS_PER_METRE, low : low + CELLS_PER_METRE] = True
    after = HeightMap(np.where(changed, before.heights.T + np.float32(0.1), before.heights))
    graph = PreparedGraph.from_edges(edges)
    distances = graph.distances(goal)
    update_s, update_cpu_s, (updated, repaired) = timed(lambda: update(dense, after, changed, graph, goal, distances))
    whole_s, whole_cpu_s, (whole, anew) = timed(lambda: search(dense.edges(after), goal))
    result = {
        "size": arguments.size,
        "states": int(sample.size),
        "precision": arguments.precision,
        "dense_s": dense_s,
        "dense_cpu_s": dense_cpu_s,
        "patches_s": patches_s,
        "patches_cpu_s": patches_cpu_s,
        "sampled_states": int(sample.sum()),
        "ratio": patches_s / dense_s,
        "cpu_ratio": patches_cpu_s / dense_cpu_s,
        **differences(found, expected[sample]),
        "affected_states": float(dense.affected(changed).mean()),
        "update_s": update_s,
        "whole_s": whole_s,
        "update_ratio": update_s / whole_s,
        "update_cpu_ratio": update_cpu_s / whole_cpu_s,
        "update_identical": bool(np.array_equal(updated.incoming, whole.incoming) and np.array_equal(repaired, anew)),
        **approximation(hardware, before),
        **shipped(hardware, arguments.size, arguments.seed),
        **queries(),
    }
    if arguments.large:
        result |= large(arguments.seed)
    print(json.dumps({key: round(value, 7) if isinstance(value, float) else value for key, value in result.items()}))
    return result


def shipped(hardware, size: float, seed: int) -> dict:
    """Speed of the shipped network on an arena, at the states where the robot can stand, and in torch."""
    import hdsp
    from hdsp.learning import HardwareSettings, LearnedAbstraction, LearnedCosts
    from hdsp.planning.heuristics.standing import standing_states
    from hdsp.terrain import random_arena
    from hdsp.terrain.height_map import HeightMap

    cells = round(size * CELLS_PER_METRE)
    terrain = HeightMap(random_arena(seed, max(size, 5.0)).heights[:cells, :cells])
    world = hdsp.Planner(terrain, heuristic="geometric").world
    standing = standing_states(world)
    now = hdsp.load_abstraction("momaro")
    exact = HardwareSettings("cpu", "32", hardware.threads)
    before = LearnedCosts(LearnedAbstraction(now.network, now.model, now.provenance, hardware=exact))
    costs = LearnedCosts(now)
    part = standing & (np.arange(16) == 3)[:, None, None]
    costs.edges(terrain, mask=part)  # compiles
    _, whole_map_cpu_s, _ = timed(lambda: costs.edges(terrain, mask=standing))
    _, now_cpu_s, _ = timed(lambda: costs.edges(terrain, mask=part))
    _, before_cpu_s, _ = timed(lambda: before.edges(terrain, mask=part))
    return {
        "standing_states": int(standing.sum()),
        "whole_map_cpu_s": whole_map_cpu_s,
        "before_over_now": before_cpu_s / now_cpu_s,
    }


def queries() -> dict:
    """First queries and updates in the paper's arena, as ``heuristic="learned"`` and ``"manual"`` answer them."""
    import yaml

    from hdsp.planning.planner import Planner
    from hdsp.terrain.arenas import read_arena

    description = yaml.safe_load(PAPER.read_text())
    terrain = read_arena(description).height_map()
    tasks = [(task["start"], task["goal"]) for task in description["tasks"]]

    def planner(heuristic: str) -> Planner:
        return Planner(terrain, heuristic=heuristic, conditioning=None)

    planner("learned").plan(*tasks[-1], weight=WEIGHT)  # compiles
    seconds, shares = [], []
    for ends in tasks:
        new = planner("learned")
        seconds.append(timed(lambda new=new, ends=ends: new.plan(*ends, weight=WEIGHT, polish=0.0))[1])
        shares.append(new.heuristic.known.share)
    return {
        "first_query_cpu_s": median(seconds),
        "share_evaluated": median(shares),
        "update_cpu_s": median(updates(planner("learned"), terrain, tasks[0])),
        "manual_update_cpu_s": median(updates(planner("manual"), terrain, tasks[0])),
    }


def large(seed: int) -> dict:
    """First queries with learned edges, and the preparation with manual edges, each in a process of its own."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    result: dict = {}
    for name, task, side in (
        ("large_20", first_query, 20.0),
        ("large_50", first_query, 50.0),
        ("manual_100", preparation, 100.0),
    ):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            found = pool.submit(task, side, seed).result()
        print(json.dumps({name: found}), flush=True)
        result |= {f"{name}_{key}": value for key, value in found.items()}
    return result


def first_query(side: float, seed: int) -> dict:
    """The first query from corner to corner of an arena."""
    from hdsp.planning.planner import Planner
    from hdsp.terrain.random_arenas import ArenaSettings, random_arena

    usual, more = ArenaSettings(), (side / 5.0) ** 2
    settings = ArenaSettings(blocks=round(usual.blocks * more), bumps=round(usual.bumps * more))
    terrain = random_arena(seed, side, settings)
    compiled_on(random_arena(seed, 5.0), "learned")
    planner = Planner(terrain, heuristic="learned", conditioning=None)
    start, goal = (planner.nearest((at, at, 0.7), 2.0) for at in (2.0, side - 2.0))
    _, cpu_s, plan = timed(lambda: planner.plan(start, goal, weight=WEIGHT, polish=0.0))
    share = planner.heuristic.known.share
    return {"cpu_s": cpu_s, "gb": most_memory(), "status": str(plan.status), "share_evaluated": share}


def preparation(side: float, seed: int) -> dict:
    """A planner with manual edges, prepared."""
    from hdsp.planning.planner import Planner
    from hdsp.terrain.height_map import HeightMap
    from hdsp.terrain.random_arenas import random_arena

    part, count = random_arena(seed, 10.0), round(side / 10.0)
    terrain = HeightMap(np.tile(part.heights, (count, count)))
    compiled_on(part, "manual")
    _, cpu_s, _ = timed(lambda: Planner(terrain, heuristic="manual", conditioning=None).prepare())
    return {"cpu_s": cpu_s, "gb": most_memory()}


def compiled_on(terrain, heuristic: str) -> None:
    """Compiles the kernels of a query on a small map."""
    from hdsp.planning.planner import Planner

    planner = Planner(terrain, heuristic=heuristic, conditioning=None)
    start = planner.nearest((2.0, 2.0, 0.0), 2.0)
    planner.plan(start, start, weight=WEIGHT)


def most_memory() -> float:
    """Most memory of this process so far, GB."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def updates(planner, terrain, ends) -> list[float]:
    """Processor seconds for each change of the map: one more block stands beside the way of the last plan."""
    from hdsp.terrain.height_map import HeightMap

    plan = planner.plan(*ends, weight=WEIGHT, polish=0.0)
    first = planner.grid.to_lattice(ends[0])[:2]
    way = planner.grid.cell(plan.states[:, :2])
    far = way[np.hypot(*(way - first).T) > 4 * BLOCK]
    places = far[np.linspace(0, len(far) - 4 * BLOCK, CHANGES + 1).astype(int)] + 2 * BLOCK
    heights, seconds = terrain.heights, []
    for x, y in places.tolist():
        heights = heights.copy()
        heights[x : x + BLOCK, y : y + BLOCK] += np.float32(HEIGHT)

        def changed(heights=heights):
            planner.update(HeightMap(heights, terrain.origin))
            planner.plan(*ends, weight=WEIGHT, polish=0.0)

        seconds.append(timed(changed)[1])
    return seconds[1:]  # the first change compiles


def timed(compute):
    """Returns seconds, processor seconds over all threads, and the result."""
    began, began_cpu = time.perf_counter(), time.process_time()
    result = compute()
    return time.perf_counter() - began, time.process_time() - began_cpu, result


def update(costs, terrain, changed: np.ndarray, graph, goal, distances=None):
    """Updates graph and distances to the goal after some cells changed to the heights in ``terrain``."""
    affected = costs.affected(changed)
    states = np.argwhere(affected)
    edges = costs.edges(terrain, mask=affected)
    graph = graph.with_edges(states, edges[affected])
    return graph, graph.repaired(graph.distances(goal) if distances is None else distances, goal, states)


def search(edges: np.ndarray, goal):
    """Builds the graph from edges; returns it with the distances to the goal."""
    from hdsp.abstract import PreparedGraph

    graph = PreparedGraph.from_edges(edges)
    return graph, graph.distances(goal)


def differences(found: np.ndarray, expected: np.ndarray) -> dict:
    """Differences between two results for the same costs [n, 22]."""
    both = np.isfinite(found) & np.isfinite(expected)
    return {
        "feasible": float(np.isfinite(expected).mean()),
        "differently_feasible": float((np.isfinite(found) != np.isfinite(expected)).mean()),
        "largest_difference": float(abs(found[both] - expected[both]).max()),
        "mean_cost": float(expected[both].mean()),
        "spread_of_costs": float(expected[both].std()),
    }


def approximation(hardware, terrain) -> dict:
    """Error of dense evaluation for the published network, in the middle of the map."""
    from hdsp.learning import LearnedCosts
    from hdsp.robot.lattice import abstract_shape

    network = random_abstraction(hardware, architecture="klamt2019")
    middle = np.array(abstract_shape(terrain.shape)) // 2
    region = (*(middle - 3), *(middle + 3))
    exact = LearnedCosts(network).edges(terrain, region)
    found = LearnedCosts(network, method="dense").edges(terrain, region)
    both = np.isfinite(found) & np.isfinite(exact)
    return {
        "padded_differently_feasible": float((np.isfinite(found) != np.isfinite(exact)).mean()),
        "padded_mean_difference": float(abs(found[both] - exact[both]).mean() / exact[both].mean()),
    }


def rough_map(shape: tuple[int, int], seed: int):
    """Map with noise, blocks and unknown cells, without equal patches."""
    from hdsp.terrain.height_map import HeightMap

    random = np.random.default_rng(seed)
    heights = random.uniform(0, 0.2, shape).astype(np.float32)
    for low in random.integers(0, np.maximum(np.subtract(shape, 20), 1), (heights.size // 2000, 2)):
        heights[low[0] : low[0] + 20, low[1] : low[1] + 12] += random.uniform(0, 0.5)
    heights[random.random(shape) < 0.02] = np.nan
    return HeightMap(heights)


def random_abstraction(hardware, **settings):
    """Abstraction with a random network.

    Its last layer is scaled so that about half of all actions are feasible and costs vary like real ones.
    """
    import torch

    from hdsp.learning import LearnedAbstraction, ModelSettings, build_network
    from hdsp.robot.lattice import robot_frame_goals

    torch.manual_seed(3)
    model = ModelSettings(**settings)
    network = build_network(model).eval()
    heights = torch.tensor(rough_map((16 * 72, 72), seed=1).heights).view(16, 1, 72, 72)
    with torch.inference_mode():
        cost, logits, *planning = network(heights, torch.tensor(robot_frame_goals(1)).expand(16, -1, -1))
    with torch.no_grad():
        scales = (cost, 0.5, 0.1), (logits, 0.0, 1.0), *((values, 0.5, 0.1) for values in planning)
        for row, (values, center, spread) in enumerate(scales):
            factor = spread / values.std()
            network.heads.weight[row] *= factor
            network.heads.bias[row] = center - factor * values.median()
    return LearnedAbstraction(network, model, hardware=hardware)


if __name__ == "__main__":
    main()

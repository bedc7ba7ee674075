"""Cost-to-go on a 10 x 10 m map (160,000 states x 22 edges): ours against scipy, in one run.

    python -m benchmarks.dijkstra [--cells 100] [--repeats 7]

The last line is JSON. `ratio` compares the searches alone, on prepared graphs (scipy without its matrix build, ours
without the edge inversion); `ratio_with_build` includes both preparations. Each time is the least of `repeats` runs.
"""

import argparse
import json
import time

import numpy as np

from hdsp.abstract import PreparedGraph
from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS, heading_angle


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=100, help="abstract cells along each side of the map")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)

    from scipy.sparse.csgraph import dijkstra

    edges = rough_terrain_edges(arguments.cells, arguments.seed)
    cells = arguments.cells
    goal = (cells // 3, cells // 2, 5)
    node = (goal[2] * cells + goal[0]) * cells + goal[1]

    PreparedGraph.from_edges(edges[:, :4, :4]).cost_to_go((0, 0, 0))  # compile
    prepare_s = search_s = scipy_build_s = scipy_s = np.inf
    for _ in range(arguments.repeats):  # alternating, so that a busy moment affects both
        prepare_s, graph = timed(prepare_s, lambda: PreparedGraph.from_edges(edges))
        search_s, distance = timed(search_s, lambda graph=graph: graph.cost_to_go(goal))
        scipy_build_s, matrix = timed(scipy_build_s, lambda: reversed_csr(edges))
        scipy_s, expected = timed(scipy_s, lambda matrix=matrix: dijkstra(matrix, indices=node))
    same = np.array_equal(distance, expected.reshape(distance.shape).astype(np.float32))
    result = {
        "states": int(distance.size),
        "edges": int(np.isfinite(edges).sum()),
        "reached": int(np.isfinite(distance).sum()),
        "search_s": search_s,
        "prepare_s": prepare_s,
        "scipy_s": scipy_s,
        "scipy_build_s": scipy_build_s,
        "ratio": scipy_s / search_s,
        "ratio_with_build": (scipy_s + scipy_build_s) / (search_s + prepare_s),
        "same_distances": bool(same),
    }
    print(json.dumps({key: round(value, 5) if isinstance(value, float) else value for key, value in result.items()}))
    return result


def timed(least, function):
    """Returns the smaller of `least` and the call's seconds, and its result."""
    begin = time.perf_counter()
    value = function()
    return min(least, time.perf_counter() - begin), value


def rough_terrain_edges(cells: int, seed: int) -> np.ndarray:
    """Edges float32 [16, cells, cells, 22] like on uneven ground: flat costs times local factors, some walls."""
    rng = np.random.default_rng(seed)
    headings = heading_angle(np.arange(ABSTRACT_HEADINGS), ABSTRACT_HEADINGS)
    dx, dy, turn = ABSTRACT_ACTIONS.T
    deviation = np.abs(np.angle(np.exp(1j * (np.arctan2(dy, dx)[None] - headings[:, None]))))
    flat = 0.1 * np.hypot(dx, dy) * (1 + 2 * np.minimum(deviation / (np.pi / 4), 1))
    flat[:, turn != 0] = 0.0366
    edges = flat[:, None, None, :] * rng.uniform(1.0, 2.0, (ABSTRACT_HEADINGS, cells, cells, 22))
    wall = rng.random((cells, cells)) < 0.02
    wall[cells // 2, : int(0.8 * cells)] = True
    edges[:, wall] = np.inf
    return edges.astype(np.float32)


def reversed_csr(edges: np.ndarray):
    """Reversed graph as scipy matrix [n, n]; row = an edge's end state, column = its start state."""
    from scipy.sparse import csr_matrix

    headings, nx, ny, _ = edges.shape
    k, a, b, m = np.nonzero(np.isfinite(edges))
    to_a, to_b = a + ABSTRACT_ACTIONS[m, 0], b + ABSTRACT_ACTIONS[m, 1]
    inside = (to_a >= 0) & (to_a < nx) & (to_b >= 0) & (to_b < ny)
    to_k = (k + ABSTRACT_ACTIONS[m, 2]) % headings
    rows = ((to_k * nx + to_a) * ny + to_b)[inside]
    columns = ((k * nx + a) * ny + b)[inside]
    costs = edges[k, a, b, m][inside].astype(np.float64)
    return csr_matrix((costs, (rows, columns)), shape=(headings * nx * ny,) * 2)


if __name__ == "__main__":
    main()

"""Planning on random maps and real places: heuristics beside each other, on pairs that no heuristic chose.

    python -m benchmarks.planning [--robot momaro] [--seed 0] [--maps 25] [--pairs 16] [--weights 1 1.25 1.5 2]
                                  [--heuristics manual learned ...] [--before COMMIT | --before none] [--prove SECONDS]
                                  [--arena] [--bounds TASKS] [--picture docs/figures/planning_benchmark.png]
                                  [--page docs/planning-benchmark.md] [--readme README.md]

Maps (``benchmarks.planning.maps``) and pairs (``benchmarks.planning.pairs``) follow from the seed. Seeds below 1000 are
for tests, later ones for development. Each search is the first on its map and ends at 500,000 expansions. The terms are
in ``benchmarks.planning.summary``. Results are kept under ``--out``; a run goes on where the last one stopped, and
repeats searches whose code has changed. Edges of learned abstractions and earlier commits are kept in the user's cache.

The last line is JSON.
"""

import argparse
import json
import math
from pathlib import Path

from benchmarks.multi_heuristic import measure
from benchmarks.page import table
from benchmarks.planning.arena import arena_figures
from benchmarks.planning.cases import make_cases, write_json
from benchmarks.planning.earlier import run_earlier
from benchmarks.planning.maps import DEFAULT_MAPS
from benchmarks.planning.optima import prove, read_optima
from benchmarks.planning.page import draw, write_page, write_readme
from benchmarks.planning.runs import EXPANSIONS, HEURISTICS, TooLarge, run_case
from benchmarks.planning.summary import HARD_WEIGHT, comparisons, counts, gather, headline, rows
from hdsp.base.errors import InputError
from hdsp.robot.robot import Robot

#: The commit before the heuristic knew feet.
BEFORE = "b406a8a"
#: Heuristics that exist at that commit, and take part in the comparison with it.
COMPARED = "manual", "learned"
#: Proved bounds of ``--bounds``.
BOUNDS = 1.25, 1.5, 2.0
#: Robot whose plans are compared with those of an earlier commit.
ROBOT = "momaro"


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default=ROBOT, choices=Robot.presets(), help="a preset")
    parser.add_argument("--seed", type=int, default=0, help="below 1000: test; from 1000 on: development")
    parser.add_argument("--maps", type=int, default=DEFAULT_MAPS)
    parser.add_argument("--pairs", type=int, default=16, help="pairs on each map")
    parser.add_argument("--area", type=float, default=math.inf, help="largest map, m2")
    parser.add_argument("--heuristics", nargs="+", default=list(HEURISTICS), choices=list(HEURISTICS))
    parser.add_argument("--weights", type=float, nargs="+", default=[1.0, 1.25, 1.5, 2.0])
    parser.add_argument("--expansions", type=int, default=EXPANSIONS, help="limit of each search")
    parser.add_argument("--before", help=f"earlier commit for comparison; none: without; {ROBOT}: {BEFORE}")
    parser.add_argument("--prove", type=float, default=0.0, metavar="SECONDS", help="time for searches for optima")
    parser.add_argument("--prove-expansions", type=int, default=20_000_000, help="limit of a search for an optimum")
    parser.add_argument("--arena", action="store_true", help="include times in the paper's arena")
    parser.add_argument(
        "--bounds", type=int, default=0, metavar="TASKS", help="include searches with proved bounds on so many tasks"
    )
    parser.add_argument("--picture", type=Path, help="PNG file")
    parser.add_argument("--page", type=Path, help="docs page to update")
    parser.add_argument("--readme", type=Path, help="README to update")
    parser.add_argument("--out", type=Path, default=Path("outputs/benchmarks/planning"), help="folder for results")
    arguments = parser.parse_args(argv)

    cases, runs, absent = [], [], {}
    robot = arguments.robot
    out = arguments.out / f"{'' if robot == ROBOT else f'{robot}_'}seed_{arguments.seed}"
    for case in make_cases(arguments.seed, arguments.maps, arguments.pairs, out, arguments.area, robot):
        cases.append(case)
        done = [f"{case.name}, {len(case.pairs)} pairs:"]
        for name in [name for name in arguments.heuristics if name not in absent]:
            try:
                found = run_case(case, name, arguments.weights, arguments.expansions)
            except TooLarge:
                continue
            except InputError as error:
                absent[name] = str(error)
                print(f"{name}: left out, {error}", flush=True)
                continue
            runs += found
            done.append(f"{name} {sum(run['cost'] is not None for run in found)}/{len(found)}")
        print(" ".join(done), flush=True)
    earlier = None
    compared = [name for name in COMPARED if name in arguments.heuristics]
    before = arguments.before or (BEFORE if robot == ROBOT else "none")
    if before != "none" and compared and HARD_WEIGHT in arguments.weights:
        earlier, found = run_earlier(before, cases, compared, [HARD_WEIGHT], arguments.expansions)
        runs += found
    results = gather(cases, runs, read_optima())
    if arguments.prove:
        entries = prove(cases, results.best, results.unsolvable, arguments.prove, arguments.prove_expansions)
        results = gather(cases, runs, entries)
    compared_rows = comparisons(results, earlier)
    result = {
        "seed": arguments.seed,
        "largest_area": arguments.area if math.isfinite(arguments.area) else None,
        "command": _command(arguments),
        **headline(results, compared_rows, earlier),
        **(arena_figures() if arguments.arena else {}),
        **(_bounds(arguments.bounds, arguments.seed) if arguments.bounds else {}),
        **counts(results, earlier),
        "heuristics": rows(results),
        "ratios": compared_rows,
    }
    write_json(out / "summary.json", result)
    if arguments.picture:
        draw(results, arguments.picture)
    if arguments.page:
        write_page(arguments.page, result)
    if arguments.readme:
        write_readme(arguments.readme, result)
    print(in_words(result))
    print(json.dumps(result))
    return result


def _bounds(tasks: int, seed: int) -> dict:
    """Effort of geometric weighted A* over that of the anchored search, for each proved bound."""
    found = measure(tasks, seed, BOUNDS)
    return {"bound_tasks": found["solved_by_some"]} | {
        name: value for name, value in found.items() if name.startswith("bound_") and "grid" not in name
    }


def _command(arguments: argparse.Namespace) -> str:
    """The command for the same searches."""
    area = f" --area {arguments.area:g}" if math.isfinite(arguments.area) else ""
    robot = "" if arguments.robot == ROBOT else f" --robot {arguments.robot}"
    before = f" --before {arguments.before}" if arguments.before else ""
    return (
        f"python -m benchmarks.planning{robot} --seed {arguments.seed} --maps {arguments.maps} "
        f"--pairs {arguments.pairs}{area}"
        f" --heuristics {' '.join(arguments.heuristics)} --weights {' '.join(f'{w:g}' for w in arguments.weights)}"
        f"{before}"
    )


def in_words(result: dict) -> str:
    """Both tables for the terminal."""
    figures = [[_cell(value) for value in row.values()] for row in result["heuristics"]]
    ratios = [[_cell(value) for value in row.values()] for row in result["ratios"]]
    heads = (list(rows[0]) if (rows := result[name]) else [] for name in ("heuristics", "ratios"))
    found = ", ".join(f"{name} {value}" for name, value in result.items() if name not in ("heuristics", "ratios"))
    return "\n\n".join([*(table(head, lines) for head, lines in zip(heads, (figures, ratios), strict=True)), found])


def _cell(value):
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1000 else f"{value:,.0f}"
    return ", ".join(f"{end:.3g}" for end in value) if isinstance(value, list) else value


if __name__ == "__main__":
    main()

"""Picture, page and README rows of the planning benchmark."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.page import shown, table, write_block
from benchmarks.planning.summary import AT, HARD, HARD_WEIGHT, Results
from hdsp.viz.style import BLACK, BLUE, GREEN, GREY, METHODS, ORANGE, PURPLE, SKY, VERMILLION, figure, quiet, save

AUTHOR = "benchmarks.planning"
#: Names in figures and tables of heuristics that others call differently.
NAMES = {"learned": "shipped", "paper": "paper's network"}
_KINDS = {"arena": BLUE, "course": VERMILLION, "row": ORANGE, "place": GREEN}
_COLORS = {
    "learned": METHODS["shipped"], "paper": METHODS["shipped-klamt2019"], "grid": SKY, "oracle": VERMILLION, **METHODS,
}  # fmt: skip
_HEURISTICS = "geometric", "grid", "manual", "trained", "learned", "paper", "oracle"


def write_page(page: Path, result: dict) -> None:
    """Writes the tables between the markers of a page."""
    write_block(page, AUTHOR, text(result))


def write_readme(page: Path, result: dict) -> None:
    """Writes the table of hard and easy pairs between the markers of the README."""
    write_block(page, AUTHOR, short_text(result))


def name_of(heuristic: str) -> str:
    """Returns a heuristic's name in tables; a commit follows it in brackets."""
    name, _, commit = heuristic.partition(AT)
    return NAMES.get(name, shown(name) or name) + (f" ({commit})" if commit else "")


def short_text(result: dict) -> str:
    """Table at W = 1.25: solved pairs, expansions of easy and hard ones, cost above the best known."""
    head = ["heuristic, W = 1.25", "solved", "expansions, easy", "expansions, hard", "CPU time", "above best known",
            "with polish"]  # fmt: skip
    lines = [
        [
            name_of(row["heuristic"]), f"{row['solved']} of {row['pairs']}", _count(row["expansions_easy"]),
            _count(row["expansions_hard"]), f"{row['cpu_s']:.3f} s", _share(row["above_best"]),
            _share(row["above_best_polished"]),
        ]
        for row in result["heuristics"] if row["weight"] == HARD_WEIGHT
    ]  # fmt: skip
    return f"{table(head, lines)}\n\n{pairs_in_words(result)}"


def pairs_in_words(result: dict) -> str:
    """Numbers of maps and pairs in a sentence."""
    return (
        f"{result['maps']} maps, {result['pairs']} random pairs: {result['solvable']} solvable ({result['hard']} hard: "
        f"the manual heuristic needs {HARD:,} expansions or more at W = {HARD_WEIGHT:g}), "
        f"{result['unsolvable_proved']} proved unsolvable, {result['undecided']} undecided. Expansions are geometric "
        f"means. `{result['command']}` makes these searches."
    )


def text(result: dict) -> str:
    """Tables of all heuristics and weights, and of all ratios."""
    head = [
        "heuristic", "W", "solved", "expansions, easy", "expansions, hard", "above best known", "with polish",
        "above the proved optimum (largest)", "with polish (largest)", "CPU s", "Dijkstra s", "search s", "proof s",
        "polish s",
    ]  # fmt: skip
    lines = [
        [
            name_of(row["heuristic"]), f"{row['weight']:g}", f"{row['solved']} of {row['pairs']}",
            _count(row["expansions_easy"]), _count(row["expansions_hard"]), _share(row["above_best"]),
            _share(row["above_best_polished"]), _largest(row, "above_optimum"), _largest(row, "polished"),
            *(f"{row[part]:.3f}" for part in ("cpu_s", "heuristic_s", "search_s", "proof_s", "polish_s")),
        ]
        for row in result["heuristics"]
    ]  # fmt: skip
    compared = [
        [
            name_of(row["heuristic"]), name_of(row["to"]), f"{row['weight']:g}", f"{row['group']} ({row['pairs']})",
            _interval(row, "expansions"), _interval(row, "cost"), " / ".join(map(str, row["capped"])),
        ]
        for row in result["ratios"]
    ]  # fmt: skip
    ratios = table(
        ["heuristic", "relative to", "W", "pairs", "expansions", "cost", "without a plan: heuristic / other"], compared
    )
    optima = f"{result['optimum_proved']} pairs have a proved optimum."
    return f"{table(head, lines)}\n\n{pairs_in_words(result)} {optima}\n\n{ratios}"


def draw(results: Results, path: Path) -> Path:
    """Expansions of the shipped heuristic against the manual one, pair by pair, and costs by weight."""
    made = figure(9, 4)
    effort, cost = made.subplots(1, 2)
    other = "learned" if results.of("learned", HARD_WEIGHT, results.solvable) else "geometric"
    for kind, color in _KINDS.items():
        pairs = [pair for pair in results.solvable if results.kinds[pair] == kind]
        runs = [[results.runs.get((pair, name, HARD_WEIGHT)) for name in ("manual", other)] for pair in pairs]
        both = [[a["expansions"], b["expansions"]] for a, b in runs if a and b]
        if both:
            effort.plot(*np.maximum(np.array(both), 1).T, "o", color=color, markersize=4, alpha=0.7, mew=0, label=kind)
    ends = [1, max(effort.get_xlim()[1], effort.get_ylim()[1])]
    effort.plot(ends, ends, color=GREY, linewidth=0.8)
    effort.axvline(HARD, color=GREY, linewidth=0.8, linestyle=":")
    effort.set(xscale="log", yscale="log", xlabel="expansions, manual", ylabel=f"expansions, {name_of(other)}")
    effort.set_title(f"each solvable pair at W = {HARD_WEIGHT:g}")
    if effort.lines[2:]:
        effort.legend(fontsize=8, frameon=False, loc="upper left")
    for name in _HEURISTICS:
        weights = sorted({weight for _, heuristic, weight in results.runs if heuristic == name})
        above = {
            what: [_mean_above(results, name, weight, what) for weight in weights] for what in ("cost", "polished_cost")
        }
        if weights:
            color = _COLORS.get(name, PURPLE)
            cost.plot(weights, above["cost"], "o-", color=color, markersize=4, linewidth=1.2, label=name_of(name))
            cost.plot(weights, above["polished_cost"], "o--", color=color, markersize=3, linewidth=1.0, mfc="white")
    cost.plot([], [], "o--", color=BLACK, markersize=3, linewidth=1.0, mfc="white", label="with polish")
    cost.set(xlabel="W", ylabel="mean cost above best known (%)", ylim=(0, None))
    cost.set_title("plans of all pairs that the heuristic solves")
    cost.legend(fontsize=8, frameon=False)
    for axes in (effort, cost):
        quiet(axes, "both")
    return save(made, path)


def _mean_above(results: Results, heuristic: str, weight: float, what: str) -> float:
    runs = results.of(heuristic, weight, results.solvable)
    above = [run[what] / results.best[run["pair"]] - 1 for run in runs if run[what]]
    return 100 * float(np.mean(above)) if above else float("nan")


def _count(value: float | None) -> str | None:
    return None if value is None else f"{value:,.0f}"


def _share(value: float | None) -> str | None:
    return None if value is None else f"{value:+.1%}"


def _largest(row: dict, name: str) -> str | None:
    mean, largest = _share(row[name]), _share(row[f"{name}_max"])
    return None if mean is None else f"{mean} ({largest})"


def _interval(row: dict, name: str) -> str | None:
    if row[name] is None:
        return None
    low, high = row[f"{name}_interval"]
    return f"{row[name]:.3f} ({low:.3f} to {high:.3f})"

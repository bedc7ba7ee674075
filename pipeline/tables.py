"""The paper's two tables beside ours, in Markdown, from stage reports."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from .paper import ABSTRACTION_QUALITY, HEURISTIC_PERFORMANCE
from .speedup import is_bound

METHOD_NAMES = {
    "trained": "trained",
    "shipped": "shipped",
    "shipped-klamt2019": "paper's network",
    "manual": "manually tuned",
    "flat": "flat ground",
}
#: Methods shown beside the paper's figures for another method.
AS_PAPER = {"trained": "learned", "shipped": "learned", "shipped-klamt2019": "learned"}
HEURISTIC_NAMES = {
    "geometric": "geometric",
    "manual": "manual abstraction",
    "trained": "trained abstraction",
    "shipped": "shipped abstraction",
    "shipped-klamt2019": "paper's network",
}
EMPTY = "–"


def abstraction_quality_table(quality: Mapping[str, Any], training: Mapping[str, Any] | None = None) -> str:
    """Table I: one column per set, with ours and, if the paper has the set, the paper's figures.

    Args:
        quality: contents of `reports/abstraction_quality.json`.
        training: contents of `reports/training.json`; names the network in the caption.
    """
    sets = quality["sets"]
    header, columns = ["ours / paper"], []
    for name, values in sets.items():
        paper = ABSTRACTION_QUALITY.get(values["paper"], {}) if values.get("paper") else {}
        paper = paper | {method: paper[other] for method, other in AS_PAPER.items() if other in paper}
        columns.append((values if values["available"] else None, paper))
        header.append(name if values.get("paper") in (None, name) else f"{name} (paper: {values['paper']})")
    rows = [
        ["maps / tasks", *(f"{ours['maps']:,} / {ours['tasks']:,}" if ours else EMPTY for ours, _ in columns)],
        _row("mean detailed cost", columns, ("detailed_cost_mean",), shown_cost),
        _row("its std. dev.", columns, ("detailed_cost_std",), shown_cost),
    ]
    methods = list(dict.fromkeys(m for values in sets.values() for m in values.get("methods", {})))
    for method in methods:
        label = METHOD_NAMES.get(method, method)
        rows += [
            _row(f"feasibility correct, {label}", columns, (method, "feasibility_accuracy"), percent),
            _row(f"mean abstract cost, {label}", columns, (method, "abstract_cost_mean"), shown_cost),
            _row(f"mean cost error, {label}", columns, (method, "cost_error"), shown_cost),
        ]
    network = f" Trained network: {training['model']}, {training['maps']:,} training maps." if training else ""
    notes = [f"Table I, abstraction quality: ours / the paper's.{network}"]
    if {"shipped", "shipped-klamt2019"} & set(methods):
        notes.append("The model cards (hdsp/learning/shipped) judge the shipped networks on more random maps.")
    missing = [name for name, values in sets.items() if not values["available"]]
    if missing:
        notes.append(f"No data for {', '.join(missing)}: reports/abstraction_quality.json gives the reason.")
    return markdown(header, rows) + "\n\n" + " ".join(notes)


def heuristic_table(planning: Mapping[str, Any]) -> str:
    """Table II: speed-up and cost increase against the optimal search with the geometric heuristic.

    Times and costs of each task follow.

    Args:
        planning: contents of `reports/planning.json`.
    """
    header = ["heuristic", "W", "solved", "mean time (s)", "mean expansions", "memory (MB)", "speed-up", "paper",
              "cost", "paper ", "above best known"]  # fmt: skip
    with_polish = any("polished_seconds_mean" in ours for by in planning["summary"].values() for ours in by.values())
    if with_polish:
        header += ["with polish", "mean time (s) "]
    rows = []
    for heuristic, by_weight in planning["summary"].items():
        for weight, ours in by_weight.items():
            theirs = HEURISTIC_PERFORMANCE.get(AS_PAPER.get(heuristic, heuristic), {}).get(float(weight), {})
            rows.append([
                HEURISTIC_NAMES.get(heuristic, heuristic),
                f"{float(weight):g}",
                f"{ours['solved']} of {ours['pairs']}",
                _bound(ours["seconds_is_lower_bound"]) + shown_seconds(ours["seconds_mean"]),
                f"{ours['expansions_mean']:,.0f}",
                f"{ours['memory_max'] / 1e6:,.0f}",
                shown_speedup(ours),
                shown_speedup(theirs),
                shown_increase(ours["cost_increase"]),
                shown_increase(theirs.get("cost_increase")),
                shown_increase(ours["cost_above_best"]),
            ])  # fmt: skip
            if with_polish:
                known = "polished_seconds_mean" in ours
                rows[-1] += [
                    shown_increase(ours["polished_above_best"]) if known else EMPTY,
                    shown_seconds(ours["polished_seconds_mean"]) if known else EMPTY,
                ]
    arena, once, checked = planning["arena"], planning["edges_seconds"], planning["collisions"]
    seconds = ", ".join(
        f"{HEURISTIC_NAMES.get(name, name)} {value:.1f} s{_part(planning['edges_share'][name])}"
        for name, value in once.items()
    )
    note = (
        f"Table II, heuristic performance: {arena['pairs']} start/goal pairs, {arena['source']}, "
        f"{arena['size']:g} x {arena['size']:g} m (the paper: seven goals, 10 x 10 m). Speed-up and cost compare with "
        "the geometric heuristic at W = 1. The speed-up is a mean over the pairs that the search solved, the cost a "
        "mean over the pairs that both searches solved. Above best known compares with the least cost found by any "
        "search. The columns with polish are for plans whose windows are planned again; the best known cost is the "
        "same. "
        "Memory is the largest over all pairs. Times include one Dijkstra search per goal. They exclude the "
        f"costs of abstract actions, which each map needs once ({seconds}; the paper: 239 s). "
        f"{_processes(planning['processes'])}≥ marks a lower bound: a search ended at a limit, here "
        f"{_limits(planning['limits'])}."
    )
    if checked["checked"]:
        note += (
            f" In the true geometry of the arena, {checked['free']} of {checked['checked']} paths are free of "
            f"collisions{_clearance(checked['least_body_clearance'])}."
        )
    return "\n\n".join([markdown(header, rows), note, markdown(*_tasks(planning)), _TASKS_NOTE])


_TASKS_NOTE = "Time (s) and cost of each task. ≥ marks a search that ended at a limit, × a task without a path."


def _tasks(planning: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Header and rows: time and cost of each task by heuristic and weight, then the least costs."""
    runs = planning["runs"]
    pairs = list(dict.fromkeys(run["pair"] for run in runs))
    found = {(run["heuristic"], run["weight"], run["pair"]): run for run in runs}
    rows = []
    for heuristic, weight in dict.fromkeys((run["heuristic"], run["weight"]) for run in runs):
        cells = [_task(found[heuristic, weight, pair]) for pair in pairs]
        rows.append([HEURISTIC_NAMES.get(heuristic, heuristic), f"{weight:g}", *cells])
    best = planning["best_known"]
    rows.append(
        ["best known", "", *(f"{best[str(pair)]['cost']:.2f}" if str(pair) in best else EMPTY for pair in pairs)]
    )
    return ["heuristic", "W", *pairs], rows


def _task(run: Mapping[str, Any]) -> str:
    cost = "×" if run["cost"] is None else f"{run['cost']:.2f}"
    return f"{_bound(is_bound(run))}{shown_seconds(run['seconds'])}, {cost}"


def random_task_table(random: Mapping[str, Any]) -> str:
    """Random tasks: expansions of easy and hard ones, and costs.

    Args:
        random: entry `random` of `reports/planning.json`.
    """
    header = ["heuristic", "solved", "expansions, easy", "expansions, hard", "mean time (s)", "above best known"]
    rows = [
        [
            HEURISTIC_NAMES.get(heuristic, heuristic),
            f"{ours['solved']} of {ours['solvable']}",
            *(f"{ours[part]:,.0f}" if _known(ours[part]) else EMPTY for part in ("expansions_easy", "expansions_hard")),
            shown_seconds(ours["seconds_mean"]) if _known(ours["seconds_mean"]) else EMPTY,
            shown_increase(ours["cost_above_best"]),
        ]
        for heuristic, ours in random["summary"].items()
    ]
    reference, first = next(iter(random["summary"].items()))
    note = (
        f"Random tasks, W = {random['weight']:g}: {random['tasks']} pairs of random poses on {random['arenas']} random "
        f"arenas, {random['size']:g} x {random['size']:g} m; {first['solvable']} have a plan, {first['hard']} are hard "
        f"for the {HEURISTIC_NAMES.get(reference, reference)}. A search ends at {random['expansions']:,} expansions. "
        "Expansions are geometric means."
    )
    return markdown(header, rows) + "\n\n" + note


def _limits(limits: Mapping[str, float]) -> str:
    return (
        f"{limits['time']:g} s, {limits['expansions'] / 1e6:g} million expansions, or {limits['memory'] / 1e9:g} GB "
        "of memory"
    )


def _part(share: float) -> str:
    return "" if share == 1 else f" for the {100 * share:.0f} % of the states that these tasks need"


def _processes(number: int) -> str:
    return "" if number == 1 else f"{number} processes search side by side. "


def _clearance(least: float | None) -> str:
    return "" if least is None else f"; the least distance between body and obstacle is {1000 * least:.0f} mm"


def _bound(is_lower: bool) -> str:
    return "≥ " if is_lower else ""


def shown_seconds(value: float) -> str:
    """Formats seconds with two or three digits."""
    return f"{value:.3f}" if value < 0.1 else f"{value:.2f}" if value < 10 else f"{value:.1f}"


def _row(label: str, columns: Sequence[tuple], keys: tuple[str, ...], show) -> list[str]:
    cells = []
    for ours, paper in columns:
        left = show(_lookup(ours and (ours if len(keys) == 1 else ours["methods"]), keys))
        right = _lookup(paper, keys)
        cells.append(left if right is None else f"{left} / {show(right)}")
    return [label, *cells]


def _lookup(values: Any, keys: tuple[str, ...]) -> float | None:
    for key in keys:
        if not values or key not in values:
            return None
        values = values[key]
    return values


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Formats a Markdown table, padded for reading in a terminal."""
    table = [list(header), *map(list, rows)]
    widths = [max(len(row[i]) for row in table) for i in range(len(header))]
    padded = [[cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in table]
    head, *lines = (f"| {' | '.join(row)} |" for row in padded)
    return "\n".join([head, "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines])


def _known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def percent(value: float | None) -> str:
    """Formats a share as percentage, alike in all tables."""
    return f"{100 * value:.2f} %" if value is not None and _known(value) else EMPTY


def shown_cost(value: float | None) -> str:
    """Formats a cost or a cost error."""
    return f"{value:.3f}" if value is not None and _known(value) else EMPTY


def shown_increase(value: float | None) -> str:
    """Formats a relative increase as percentage with its sign."""
    return f"{100 * value:+.1f} %" if value is not None and _known(value) else EMPTY


def shown_speedup(entry: Mapping[str, Any] | None) -> str:
    """Formats the speed-up of a summary's entry, with ≥ for a lower bound."""
    value = entry and entry.get("speedup")
    if not entry or not value or not _known(value):
        return EMPTY
    factor = f"{value:,.0f}x" if value >= 100 else f"{value:.1f}x"
    return _bound(entry.get("speedup_is_lower_bound", False)) + factor

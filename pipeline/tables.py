"""The paper's two tables beside ours, in markdown, from the reports of the stages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.paper import ABSTRACTION_QUALITY, HEURISTIC_PERFORMANCE

METHOD_NAMES = {"learned": "learned", "manual": "manually tuned", "flat": "flat ground"}
HEURISTIC_NAMES = {"geometric": "geometric", "manual": "manual abstraction", "learned": "learned abstraction"}
EMPTY = "–"


def abstraction_quality_table(quality: Mapping[str, Any], training: Mapping[str, Any] | None = None) -> str:
    """Table I: per set a column of ours and, where the paper has that set, one of the paper's.

    Args:
        quality: contents of `reports/abstraction_quality.json`.
        training: contents of `reports/training.json`; names the network in the caption.
    """
    sets = quality["sets"]
    header, columns = ["ours / paper"], []
    for name, values in sets.items():
        paper = ABSTRACTION_QUALITY.get(values["paper"], {}) if values.get("paper") else {}
        columns.append((values if values["available"] else None, paper))
        header.append(name if values.get("paper") in (None, name) else f"{name} (paper: {values['paper']})")
    rows = [
        ["maps / tasks", *(f"{ours['maps']:,} / {ours['tasks']:,}" if ours else EMPTY for ours, _ in columns)],
        _row("mean detailed cost", columns, ("detailed_cost_mean",), _cost),
        _row("its std. dev.", columns, ("detailed_cost_std",), _cost),
    ]
    methods = list(dict.fromkeys(m for values in sets.values() for m in values.get("methods", {})))
    for method in methods:
        label = METHOD_NAMES.get(method, method)
        rows += [
            _row(f"feasibility correct, {label}", columns, (method, "feasibility_accuracy"), _percent),
            _row(f"mean abstract cost, {label}", columns, (method, "abstract_cost_mean"), _cost),
            _row(f"mean cost error, {label}", columns, (method, "cost_error"), _cost),
        ]
    network = f" Network: {training['model']}, {training['maps']:,} training maps." if training else ""
    notes = [f"Table I, abstraction quality: ours / the paper's.{network}"]
    missing = [name for name, values in sets.items() if not values["available"]]
    if missing:
        notes.append(f"No data for {', '.join(missing)}: why is in reports/abstraction_quality.json.")
    return markdown(header, rows) + "\n\n" + " ".join(notes)


def heuristic_table(planning: Mapping[str, Any]) -> str:
    """Table II: speed-up and cost increase against the optimal search with the geometric heuristic.

    Args:
        planning: contents of `reports/planning.json`.
    """
    header = ["heuristic", "W", "solved", "mean time (s)", "mean expansions", "speed-up", "paper", "cost", "paper "]
    rows = []
    for heuristic, by_weight in planning["summary"].items():
        for weight, ours in by_weight.items():
            theirs = HEURISTIC_PERFORMANCE.get(heuristic, {}).get(float(weight), {})
            bound = "≥ " if ours["speedup_is_lower_bound"] else ""
            rows.append([
                HEURISTIC_NAMES.get(heuristic, heuristic),
                f"{float(weight):g}",
                f"{ours['solved']} of {ours['pairs']}",
                f"{ours['seconds_mean']:.2f}",
                f"{ours['expansions_mean']:,.0f}",
                bound + _factor(ours["speedup"]) if _known(ours["speedup"]) else EMPTY,
                _factor(theirs["speedup"]) if theirs else EMPTY,
                _increase(ours["cost_increase"]),
                _increase(theirs.get("cost_increase")),
            ])  # fmt: skip
    arena, once = planning["arena"], planning["edges_seconds"]
    seconds = ", ".join(f"{HEURISTIC_NAMES.get(name, name)} {value:.1f} s" for name, value in once.items())
    note = (
        f"Table II, heuristic performance: {arena['pairs']} start/goal pairs on a generated map of "
        f"{arena['size']:g} x {arena['size']:g} m (the paper: seven goals, 10 x 10 m), against the geometric heuristic "
        "at W = 1; means of the pairs' ratios, of cost where both are solved. Times include one Dijkstra search per "
        f"goal, not the costs of all abstract actions, needed once per map ({seconds}; the paper: 239 s). "
        "≥: a reference search ended by its limit."
    )
    return markdown(header, rows) + "\n\n" + note


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
    """Padded, so that it reads as well in a terminal."""
    table = [list(header), *map(list, rows)]
    widths = [max(len(row[i]) for row in table) for i in range(len(header))]
    padded = [[cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in table]
    head, *lines = (f"| {' | '.join(row)} |" for row in padded)
    return "\n".join([head, "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines])


def _known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def _percent(value: float | None) -> str:
    return f"{100 * value:.2f} %" if value is not None and _known(value) else EMPTY


def _cost(value: float | None) -> str:
    return f"{value:.3f}" if value is not None and _known(value) else EMPTY


def _increase(value: float | None) -> str:
    return f"{100 * value:+.1f} %" if value is not None and _known(value) else EMPTY


def _factor(value: float) -> str:
    return f"{value:,.0f}x" if value >= 100 else f"{value:.1f}x"

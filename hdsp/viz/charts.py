"""Charts: training curves, abstraction quality, planning experiment."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb

from hdsp.base.errors import InputError
from hdsp.viz.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    METHODS,
    NAMES,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    figure,
    quiet,
    save,
)

_SETS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY)
_SURE = 10  # tasks; a reliability diagram shows shares only for bins with at least this many


def save_training_beside(
    ours: Sequence[Mapping[str, Any]], theirs: Sequence[Mapping[str, Any]], path: str | os.PathLike, name: str
) -> Path:
    """Feasibility accuracy and cost error per epoch, for our training and a published training.

    Args:
        ours, theirs: one mapping per epoch with `epoch` (from 1), `feasibility_accuracy`, `cost_error`.
        path: PNG path.
        name: legend label for the published training.

    Raises:
        InputError: if a training has no epoch.
    """
    if not ours or not theirs:
        raise InputError("training curves: a history has no epoch")
    made = figure(9, 3.4)
    panels = zip(made.subplots(1, 2), ("feasibility_accuracy", "cost_error"), (100.0, 1.0), strict=True)
    labels = ("feasibility correct (%)", "mean cost error")
    for (axes, metric, scale), label in zip(panels, labels, strict=True):
        for rows, color, whose in ((theirs, GREY, name), (ours, BLUE, "ours")):
            values = scale * np.array([_value(row[metric]) for row in rows])
            axes.plot([row["epoch"] for row in rows], values, color=color, linewidth=1.5, label=whose)
        axes.set_ylabel(label)
        axes.set_xlabel("epoch")
        axes.set_xlim(0, max(len(ours), len(theirs)) + 1)
        quiet(axes)
    made.axes[0].set_ylim(85, 100)
    made.axes[1].set_ylim(0, 0.09)
    made.axes[0].legend(fontsize=8, frameon=False)
    return save(made, path)


def save_training_curves(history: Sequence[Mapping[str, Any]], path: str | os.PathLike) -> Path:
    """Feasibility accuracy, cost error, losses and loss weights per epoch of a training.

    Args:
        history: one mapping per epoch with `epoch` (from 0), `feasibility_accuracy/{set}`, `cost_error/{set}`,
            `loss/{feasibility,cost}`, `loss_weight/{feasibility,cost}`; absent entries are left out.
        path: PNG path.

    Raises:
        InputError: if the history is empty.
    """
    if not history:
        raise InputError("training curves: the history has no epoch")
    epochs = np.array([row["epoch"] for row in history]) + 1
    made = figure(9, 6)
    (accuracy, error), (losses, weights) = made.subplots(2, 2, sharex=True)
    panels = (
        (accuracy, "feasibility_accuracy/", "feasibility correct (%)", 100.0),
        (error, "cost_error/", "mean cost error", 1.0),
        (losses, "loss/", "training loss, before weighting", 1.0),
        (weights, "loss_weight/", "loss weight", 1.0),
    )
    for axes, prefix, label, scale in panels:
        names = list(dict.fromkeys(name for row in history for name in row if name.startswith(prefix)))
        for name, color in zip(names, _SETS, strict=False):
            values = scale * np.array([_value(row.get(name)) for row in history])
            drawstyle = "steps-mid" if axes is weights else "default"
            marker = "o" if len(epochs) < 30 else ""
            axes.plot(
                epochs, values, color=color, drawstyle=drawstyle, linewidth=1.5, marker=marker, markersize=3,
                label=name.removeprefix(prefix),
            )  # fmt: skip
        axes.set_ylabel(label)
        quiet(axes)
        if names:
            axes.legend(fontsize=8, frameon=False)
    error.set_ylim(bottom=0)
    losses.set_ylim(bottom=0)
    weights.set_yscale("log")
    for axes in (losses, weights):
        axes.set_xlabel("epoch")
        axes.set_xlim(0.5, epochs[-1] + 0.5)
        axes.xaxis.get_major_locator().set_params(integer=True)
    return save(made, path)


def save_quality_bars(sets: Mapping[str, Mapping[str, Any]], path: str | os.PathLike) -> Path:
    """Table I as bars: feasibility accuracy and cost error for each method and each set.

    Args:
        sets: results of `hdsp.labels.evaluation.evaluate_set` by set name; sets without `methods` are left out.
        path: PNG path.

    Raises:
        InputError: if no set has results.
    """
    shown = {name: figures for name, figures in sets.items() if figures.get("methods")}
    if not shown:
        raise InputError("abstraction quality: no set has figures")
    methods = list(dict.fromkeys(method for figures in shown.values() for method in figures["methods"]))
    made = figure(max(6.5, 1.5 + 1.6 * len(shown) * 2), 3.4)
    panels = zip(
        made.subplots(1, 2),
        ("feasibility_accuracy", "cost_error"),
        ("feasibility correct (%)", "mean cost error"),
        (100.0, 1.0),
        ("{:.1f}", "{:.3f}"),
        strict=True,
    )
    width = 0.8 / len(methods)
    for axes, figure_name, label, scale, digits in panels:
        for index, method in enumerate(methods):
            values = [_value(figures["methods"].get(method, {}).get(figure_name)) * scale for figures in shown.values()]
            places = np.arange(len(shown)) + (index - (len(methods) - 1) / 2) * width
            look = {"color": METHODS.get(method, PURPLE), "label": NAMES.get(method, method)}
            bars = axes.bar(places, values, width * 0.92, **look)
            axes.bar_label(bars, ["" if np.isnan(v) else digits.format(v) for v in values], fontsize=7, padding=1)
        names = [f"{name}\n{figures['tasks']:,} tasks" for name, figures in shown.items()]
        axes.set_xticks(range(len(shown)), names, parse_math=False)
        axes.set_ylabel(label)
        axes.margins(y=0.08)
        quiet(axes)
    made.axes[0].set_ylim(0, 108)
    _legend_above(made, len(methods))
    return save(made, path)


def save_reliability(sets: Mapping[str, Mapping[str, Any]], path: str | os.PathLike) -> Path:
    """Reliability diagrams, one for each set.

    A diagram shows the share of feasible tasks against the predicted probability, and below it the share of tasks in
    each bin. On the diagonal, predicted probabilities equal observed shares. Bins with fewer than ten tasks are not
    drawn in the upper diagram, because their share is too uncertain.

    Args:
        sets: results by set name. The entry `calibration` contains, for each method, the result of
            `hdsp.learning.calibration.calibration_figures`; sets and methods without it are left out.
        path: PNG path.
    """
    shown = {name: figures["calibration"] for name, figures in sets.items() if figures.get("calibration")}
    made = figure(max(3.0, 2.4 * len(shown)), 3.4)
    if not shown:
        made.text(0.5, 0.5, "no abstraction that states probabilities", ha="center", fontsize=9)
        return save(made, path)
    above, below = made.subplots(2, len(shown), sharex=True, squeeze=False, height_ratios=(3, 1))
    for diagram, histogram, (name, methods) in zip(above, below, shown.items(), strict=True):
        diagram.plot([0, 1], [0, 1], color=GREY, linewidth=0.8, linestyle="--")
        for method, figures in methods.items():
            bins, color = figures["bins"], METHODS.get(method, PURPLE)
            tasks, predicted, observed = (np.array(bins[key]) for key in ("tasks", "predicted", "observed"))
            sure = tasks >= _SURE
            label = f"{NAMES.get(method, method)}: ECE {figures['ece']:.3f}"
            line = {"color": color, "marker": "o", "markersize": 3, "linewidth": 1.2}
            diagram.plot(predicted[sure], observed[sure], label=label, **line)
            histogram.step(predicted, tasks / tasks.sum(), where="mid", color=color, linewidth=1.2)
        diagram.set_title(name)
        diagram.legend(loc="upper left", fontsize=7)
        diagram.set_ylim(-0.03, 1.45)
        diagram.set_yticks(np.linspace(0, 1, 6))
        histogram.set_yscale("log")
        histogram.set_xlabel("stated probability")
        diagram.set_xlim(-0.03, 1.03)
        for axes in (diagram, histogram):
            quiet(axes)
    above[0].set_ylabel("share that is feasible")
    below[0].set_ylabel("share of tasks")
    return save(made, path)


def save_planning_bars(runs: Sequence[Mapping[str, Any]], path: str | os.PathLike) -> Path:
    """Planning times (logarithmic) and path costs for each task, heuristic and weight, as in the paper's Sec. VI-B.

    A search without a path has the mark × instead of a cost. If a limit ended the search, its time is a lower bound:
    the bar is hatched, and an arrow points beyond it.

    Args:
        runs: mappings with `pair`, `heuristic`, `weight`, `status`, `seconds`, `cost` (None if unsolved).
        path: PNG path.

    Raises:
        InputError: if there are no runs.
    """
    if not runs:
        raise InputError("planning bars: there are no runs")
    pairs = list(dict.fromkeys(run["pair"] for run in runs))
    series = list(dict.fromkeys((run["heuristic"], run["weight"]) for run in runs))
    found = {(run["pair"], run["heuristic"], run["weight"]): run for run in runs}
    made = figure(max(7.0, 1.5 + 0.14 * len(pairs) * len(series)), 5.6)
    time, cost = made.subplots(2, 1, sharex=True)
    width = 0.84 / len(series)
    for index, (heuristic, weight) in enumerate(series):
        color = _tint(METHODS.get(heuristic, PURPLE), [w for h, w in series if h == heuristic].index(weight))
        for place, pair in enumerate(pairs):
            run = found.get((pair, heuristic, weight))
            if run is None:
                continue
            label = f"{NAMES.get(heuristic, heuristic)}, W = {weight:g}" if place == 0 else None
            x = place + (index - (len(series) - 1) / 2) * width
            look = {"color": color, "edgecolor": "black", "linewidth": 0.4}
            bars = time.bar(x, run["seconds"], width * 0.92, label=label, **look)
            if run["status"] == "solved":
                cost.bar(x, run["cost"], width * 0.92, **look)
                continue
            cost.text(x, 0, "×", ha="center", va="bottom", fontsize=9)
            if run["status"].endswith("_limit"):
                bars[0].set(hatch="////", edgecolor=GREY)
                time.annotate(
                    "", (x, run["seconds"]), (0, 11), textcoords="offset points", annotation_clip=False,
                    arrowprops={"arrowstyle": "<|-", "color": BLACK, "linewidth": 0.8, "mutation_scale": 6,
                                "shrinkA": 0, "shrinkB": 0},
                )  # fmt: skip
    time.set_yscale("log")
    time.margins(y=0.12)
    time.set_ylabel("planning time (s)")
    cost.set_ylabel("path cost (unitless)")
    cost.set_xlabel("task")
    cost.set_xticks(range(len(pairs)), [str(pair) for pair in pairs], parse_math=False)
    for axes in (time, cost):
        quiet(axes)
    all_solved = all(run["status"] == "solved" for run in runs)
    notes = "×: no path; hatched, with an arrow: ended by a limit, the time is a lower bound (≥)"
    _legend_above(made, 3, None if all_solved else notes)
    return save(made, path)


def _legend_above(made, columns: int, note: str | None = None) -> None:
    entries = made.axes[0].get_legend_handles_labels()
    made.legend(
        *entries, loc="outside upper center", ncols=columns, fontsize=8, frameon=False, title=note, title_fontsize=8
    )


def _tint(color: str, step: int) -> tuple[float, float, float]:
    """The colour, lighter with each step."""
    share = (1.0, 0.6, 0.3, 0.15)[min(step, 3)]
    red, green, blue = (1 - share * (1 - channel) for channel in to_rgb(color))
    return red, green, blue


def _value(value: Any) -> float:
    return float("nan") if value is None else float(value)

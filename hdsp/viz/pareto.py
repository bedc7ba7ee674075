"""Model errors over computation time."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from hdsp.base.errors import InputError
from hdsp.viz.style import BLUE, GREY, figure, quiet, save


def pareto_front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the Pareto-optimal points.

    A point is Pareto-optimal if no other point is better in one coordinate and at least as good in the other.

    Args:
        points: (x, y), lower is better in both.

    Returns:
        indices in ascending x; all of several equal points are included.
    """
    front: list[int] = []
    for index in sorted(range(len(points)), key=lambda i: points[i]):
        best = points[front[-1]] if front else (0.0, float("inf"))
        if points[index][1] < best[1] or points[index] == best:
            front.append(index)
    return front


def save_pareto(
    seconds: Mapping[str, float], panels: Mapping[str, Mapping[str, float]], path: str | os.PathLike
) -> Path:
    """Draws model errors over times on a logarithmic axis, one panel per error; a line joins the Pareto front.

    Args:
        seconds: time by model.
        panels: errors by axis label, then by model; lower is better.
        path: PNG path.

    Raises:
        InputError: if there is no model.
    """
    if not seconds:
        raise InputError("Pareto picture: there is no model")
    made = figure(5.0 * len(panels), 4.0)
    for axes, (label, errors) in zip(made.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True):
        points = [(seconds[name], errors[name]) for name in seconds]
        front = pareto_front(points)
        axes.step(*zip(*(points[i] for i in front), strict=True), where="post", color=BLUE, linewidth=1.0)
        for index, (name, point) in enumerate(zip(seconds, points, strict=True)):
            color = BLUE if index in front else GREY
            axes.plot(*point, "o", color=color, markersize=5)
            axes.annotate(name, point, (5, 4), textcoords="offset points", fontsize=8, color=color)
        axes.set_xscale("log")
        axes.set_ylim(0, 1.15 * max(errors[name] for name in seconds))
        axes.margins(x=0.2)
        axes.set_xlabel("costs of all actions of a 10 x 10 m map (s of one core)")
        axes.set_ylabel(label)
        quiet(axes)
    return save(made, path)

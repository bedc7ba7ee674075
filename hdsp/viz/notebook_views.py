"""Views of values in notebooks: a small picture beside a table of the main figures.

Importing this module registers the views of height maps, motions and task sets; Matplotlib loads when one is shown.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping
from html import escape
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

from hdsp.base.notebook import NotebookView, register_view
from hdsp.detailed.motion.motion import Motion
from hdsp.labels.tasks import TaskSet
from hdsp.terrain.height_map import HeightMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Figures of a value, by their names.
Rows = Mapping[str, str]

#: Largest picture, bytes, and its resolutions in dots per inch, the first that fits.
_LARGEST = 100_000
_RESOLUTIONS = 110, 80, 60, 45, 30
_COLOURS = 160

#: A value's picture, so that page and picture draw it once.
_PICTURES: WeakKeyDictionary[Any, bytes] = WeakKeyDictionary()

_PAGE = (
    '<div style="display:flex;flex-wrap:wrap;gap:1.2em;align-items:flex-start">'
    '<img alt="{title}" src="data:image/png;base64,{picture}" style="max-width:min(100%,{width}px);background:white">'
    '<table style="margin:0;border-collapse:collapse;font-size:90%;max-width:34em">'
    '<caption style="caption-side:top;text-align:left;font-weight:bold;padding:0 0 .4em">{title}</caption>'
    "<tbody>{rows}</tbody></table></div>"
)
_ROW = (
    '<tr><th scope="row" style="text-align:left;vertical-align:top;font-weight:normal;opacity:.7;white-space:nowrap;'
    'padding:.1em .9em .1em 0">{name}</th><td style="text-align:left;padding:.1em 0">{value}</td></tr>'
)


def view_of(
    title: Callable[[Any], str], rows: Callable[[Any], Rows], draw: Callable[[Any], Figure], width: int = 520
) -> NotebookView:
    """Returns a view.

    Args:
        title: title of the page.
        rows: its table; names and values are plain text.
        draw: draws the picture; may load Matplotlib.
        width: largest picture width on the page, pixels.
    """

    def picture(value: Any) -> bytes | None:
        if value not in _PICTURES:
            try:
                _PICTURES[value] = small_png(draw(value))
            except ModuleNotFoundError as error:
                if error.name is None or error.name.partition(".")[0] != "matplotlib":
                    raise
                return None
        return _PICTURES[value]

    def page(value: Any) -> str | None:
        drawn = picture(value)
        if drawn is None:
            return None
        table = "".join(_ROW.format(name=escape(name), value=escape(text)) for name, text in rows(value).items())
        encoded = base64.b64encode(drawn).decode()
        return _PAGE.format(title=escape(title(value)), picture=encoded, width=width, rows=table)

    return NotebookView(page, picture)


def small_png(figure: Figure) -> bytes:
    """Returns a figure as PNG with a palette, at most 100 kB, at a lower resolution if necessary."""
    from PIL import Image  # Matplotlib depends on it

    for resolution in _RESOLUTIONS:
        drawn, small = io.BytesIO(), io.BytesIO()
        figure.savefig(drawn, format="png", dpi=resolution, facecolor="white")
        palette = Image.open(drawn).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE)
        palette.save(small, format="png", optimize=True)
        if small.tell() <= _LARGEST:
            break
    return small.getvalue()


def map_rows(terrain: HeightMap) -> Rows:
    """Returns size, cells, heights and frame of a map."""
    (nx, ny), (length, width), (x, y) = terrain.shape, terrain.size, terrain.origin
    known = terrain.heights[np.isfinite(terrain.heights)]
    rows = {
        "size": f"{length:.2f} × {width:.2f} m",
        "cells": f"{nx:,} × {ny:,}, {terrain.resolution:g} m",
        "lower corner": f"({x:.2f}, {y:.2f}) m",
        "unknown": f"{1 - known.size / terrain.heights.size:.1%}" if known.size < terrain.heights.size else "none",
    }
    if known.size:
        rows["heights"] = f"{known.min():z.2f} to {known.max():z.2f} m, median {np.median(known):z.2f} m"
    named = ", ".join(filter(None, (terrain.frame.name, terrain.frame.crs[:60])))
    if named:
        rows["frame"] = named
    if terrain.frame.notes:
        rows["notes"] = "; ".join(terrain.frame.notes)
    return rows


def _draw_map(terrain: HeightMap) -> Figure:
    from hdsp.viz.scan_figure import map_figure

    return map_figure(terrain, side=4.2)


def _motion_rows(motion: Motion) -> Rows:
    lengths, margins = motion.leg_lengths(), motion.margins()
    way = float(np.hypot(*np.diff(motion.base[:, :2], axis=0).T).sum())
    steps = int((np.diff(motion.phase == 2, prepend=False) & (motion.phase == 2)).sum())
    return {
        "robot": motion.robot.name,
        "duration": f"{motion.duration:.1f} s",
        "configurations": f"{len(motion):,}",
        "actions": f"{len(np.unique(motion.action)):,}, {steps} of them steps",
        "way of the base": f"{way:.2f} m, {motion.base[:, 2].min():.2f} to {motion.base[:, 2].max():.2f} m high",
        "support margin": f"at least {margins.min():.3f} m",
        "leg lengths": f"{lengths.min():.2f} to {lengths.max():.2f} m",
    }


def _draw_motion(motion: Motion) -> Figure:
    from hdsp.viz.motion_figure import motion_profile

    return motion_profile(motion)


def _task_rows(tasks: TaskSet) -> Rows:
    names, counts = np.unique(tasks.category, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    kinds = [f"{names[k]} ({counts[k]:,})" for k in order[:6]]
    if len(names) > len(kinds):
        kinds.append(f"{len(names) - len(kinds)} more")
    rows = {
        "maps": f"{len(tasks):,}",
        "tasks": f"{tasks.feasible.size:,}",
        "feasible": f"{tasks.feasible.mean():.1%}" if len(tasks) else "none",
        "categories": ", ".join(kinds) or "none",
    }
    costs = tasks.cost[tasks.feasible]
    if costs.size:
        rows["costs"] = f"{costs.min():.2f} to {costs.max():.2f}, median {np.median(costs):.2f}"
    rows["costs for planning"] = "no" if tasks.planning_cost is None else "yes"
    return rows


def _draw_tasks(tasks: TaskSet) -> Figure:
    from hdsp.viz.patch_figure import label_figure

    return label_figure(tasks)


register_view(HeightMap, view_of(lambda _: "Height map", map_rows, _draw_map))
register_view(Motion, view_of(lambda _: "Motion", _motion_rows, _draw_motion, width=680))
register_view(TaskSet, view_of(lambda _: "Labelled tasks", _task_rows, _draw_tasks, width=620))

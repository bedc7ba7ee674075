"""Two pictures for docs/your-map.md: a map before and after its conditioning, and the cause of a failure at its place.

    python -m examples.your_map

The example writes the pictures into docs/figures and prints one line of JSON.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from hdsp import HeightMap, Planner
from hdsp.planning.answers.plans import Plan
from hdsp.terrain.obstacles import Block, Scene
from hdsp.viz.style import BLUE, GREY, VERMILLION, draw_terrain, figure, quiet, save

DOCS = Path(__file__).resolve().parents[1] / "docs"
CELL, KERB, NOISE = 0.05, 0.15, 0.01  # m: measured cells, height of the kerb, standard deviation of the noise
UNKNOWN, SPIKES = 0.02, 0.005  # shares of the cells
SIDE = 4.0  # m
SECTION = 2.0  # m, y of the section through the map

#: A kerb, and a post of 0.2 m.
SCENE = Scene((Block(3.2, 2.0, 0.15, 2.4, 8.0, KERB), Block(1.0, 3.0, 0.0, 0.2, 0.2, 0.6)))


def exact(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights of the scene at positions (m)."""
    return SCENE.heights_at(np.asarray(x, float), np.asarray(y, float))


def measured_map(seed: int = 0) -> HeightMap:
    """The scene as a robot measures it: coarse cells with noise, spikes and unknown cells."""
    rng = np.random.default_rng(seed)
    middles = (np.arange(round(SIDE / CELL)) + 0.5) * CELL
    x, y = np.meshgrid(middles, middles, indexing="ij")
    heights = exact(x, y) + NOISE * rng.standard_normal(x.shape)
    heights += (rng.random(x.shape) < SPIKES) * rng.uniform(0.2, 0.5, x.shape)
    heights[rng.random(x.shape) < UNKNOWN] = np.nan
    return HeightMap(heights, resolution=CELL)


def unseen_doorway() -> HeightMap:
    """A wall of 1 m across 6 x 4 m, with a door of 1.2 m; the floor behind it was not seen over 1.1 m."""
    heights = np.zeros((240, 160))
    heights[119:123] = 1.0
    heights[119:123, 56:104] = 0.0
    heights[123:168] = np.nan
    return HeightMap(heights)


def draw_conditioning(measured: HeightMap, path: Path) -> str:
    """Draws a map before and after its conditioning, and one section through both; returns the report in words."""
    after, report = measured.conditioned()
    made = figure(9.0, 6.6)
    above, below = made.subfigures(2, 1, height_ratios=(3, 2))
    titles = f"measured: cells of {100 * CELL:g} cm", f"conditioned: cells of {100 * after.resolution:g} cm"
    for axes, terrain, title in zip(above.subplots(1, 2), (measured, after), titles, strict=True):
        image = draw_terrain(axes, terrain, 0.0, 0.6)
        axes.axhline(SECTION, color=BLUE, linewidth=0.8, linestyle="--")
        axes.set(title=title, xlabel="x (m)", ylabel="y (m)")
    above.colorbar(image, ax=above.axes, shrink=0.8).set_label("height (m)", fontsize=9)
    axes = below.subplots()
    fine = np.arange(0.0, SIDE, 0.005)
    axes.plot(fine, exact(fine, np.full_like(fine, SECTION)), color=GREY, linewidth=3, alpha=0.6, label="true ground")
    for terrain, look, name in ((measured, {"marker": ".", "linestyle": "none", "color": VERMILLION}, "measured"),
                                (after, {"color": BLUE, "drawstyle": "steps-mid"}, "conditioned")):  # fmt: skip
        x = (np.arange(terrain.shape[0]) + 0.5) * terrain.resolution
        axes.plot(x, terrain.height_at(x, np.full_like(x, SECTION)), label=name, **look)
    axes.set(xlabel="x (m)", ylabel="height (m)", title=f"section at y = {SECTION:g} m", xlim=(0, SIDE))
    axes.legend(fontsize=8, frameon=False, loc="upper left")
    quiet(axes)
    save(made, path)
    return str(report)


def failed_plan() -> Plan:
    """A query through the doorway with unseen ground."""
    planner = Planner(unseen_doorway(), heuristic="manual")
    return planner.plan((1.2, 2.0, 0.0), (5.2, 2.0, 0.0), weight=1.25)


def run(folder: Path) -> dict:
    """Writes both pictures into a folder; returns the results in words and numbers."""
    measured = measured_map()
    report = draw_conditioning(measured, folder / "conditioned_map.png")
    after = measured.conditioned().terrain
    middles = [(np.arange(count) + 0.5) * after.resolution for count in after.shape]
    off = abs(after.heights - exact(*np.meshgrid(*middles, indexing="ij")))
    plan = failed_plan()
    plan.show(folder / "no_plan.png")
    return {
        "conditioning": report,
        "median_error_cm": round(100 * float(np.median(off)), 2),
        "status": str(plan.status),
        "causes": [{"kind": str(cause.kind), "place": [round(v, 2) for v in cause.place]} for cause in plan.causes],
        "nearest": None if plan.nearest is None else round(plan.nearest.distance, 2),
        "words": plan.explain(),
    }


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("--docs", type=Path, default=DOCS, help="folder of figures/")
    print(json.dumps(run(arguments.parse_args().docs / "figures")))


if __name__ == "__main__":
    main()

"""Similarity between simulated sensor maps and scanned maps: unknown cells, noise, steps between cells.

    python -m benchmarks.sensing outputs/beyond/data/labels/val_sensed data/simulated data/real data/labels/random

For each shard or folder, the figures cover all its patches: the share of unknown cells; among known neighbours, the
shares with differences from 1 to 5 cm and from 5 to 15 cm; on even ground, the residual noise. Even ground is a square
of 9 x 9 known cells that span less than 8 cm; its fitted plane is subtracted. Noise is listed as median and 90th
percentile of its standard deviation in mm, and as correlation over one and two cells. The last line is JSON.
"""

import argparse
import json

import numpy as np

from hdsp.labels.shards import read_tasks
from hdsp.labels.tasks import TaskSet

_SIDE = 9  # cells of a square
_SPAN = 0.08  # m
_SQUARES = 40  # drawn from a patch


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("places", nargs="+", help="shards, or folders with shards")
    arguments = parser.parse_args(argv)
    result = {place: describe(read_tasks(place)) for place in arguments.places}
    for place, values in result.items():
        print(f"{place}: {values}")
    print(json.dumps(result))
    return result


def describe(tasks: TaskSet) -> dict[str, float | int | None]:
    """Figures for a set, by name; None without even ground or without noise."""
    heights = tasks.heights.astype(float)
    steps = np.abs(np.concatenate([np.diff(heights, axis=axis).ravel() for axis in (1, 2)]))
    steps = steps[np.isfinite(steps)]
    rest = np.array(even_ground(heights))
    noise = rest.std(axis=(1, 2)) if len(rest) else np.zeros(0)
    variance = float((rest**2).mean()) if len(rest) else 0.0

    def correlation(cells: int) -> float | None:
        return round(float((rest[:, cells:] * rest[:, :-cells]).mean()) / variance, 2) if variance else None

    return {
        "patches": len(tasks),
        "unknown": round(float(np.isnan(heights).mean()), 3),
        "feasible": round(float(tasks.feasible.mean()), 3),
        "steps_1_to_5_cm": round(float(((steps >= 0.01) & (steps < 0.05)).mean()), 4),
        "steps_5_to_15_cm": round(float(((steps >= 0.05) & (steps < 0.15)).mean()), 4),
        "noise_median_mm": round(1e3 * float(np.median(noise)), 2) if len(noise) else None,
        "noise_90_mm": round(1e3 * float(np.quantile(noise, 0.9)), 2) if len(noise) else None,
        "correlation_1_cell": correlation(1),
        "correlation_2_cells": correlation(2),
    }


def even_ground(heights: np.ndarray) -> list[np.ndarray]:
    """Residuals, [9, 9] each, after a plane fit to even squares at random places in patches [n, 72, 72]."""
    random = np.random.default_rng(0)
    plane = np.column_stack([np.ones(_SIDE**2), *np.indices((_SIDE, _SIDE)).reshape(2, -1)])
    off = np.eye(_SIDE**2) - plane @ np.linalg.pinv(plane)
    found = []
    for patch in heights:
        for i, j in random.integers(0, len(patch) - _SIDE, (_SQUARES, 2)):
            square = patch[i : i + _SIDE, j : j + _SIDE]
            if np.ptp(square) < _SPAN:  # false where a cell is unknown
                found.append((off @ square.ravel()).reshape(_SIDE, _SIDE))
    return found


if __name__ == "__main__":
    main()

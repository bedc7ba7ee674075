"""The paper's results (Klamt & Behnke 2019, Tables I and II), as data for comparison with ours."""

from typing import Any

#: Table I, per set: detailed costs, then for each method feasibility accuracy, mean abstract cost, mean cost error.
ABSTRACTION_QUALITY: dict[str, dict[str, Any]] = {
    "random": {
        "detailed_cost_mean": 0.476,
        "detailed_cost_std": 0.222,
        "learned": {"feasibility_accuracy": 0.9504, "abstract_cost_mean": 0.453, "cost_error": 0.027},
        "manual": {"feasibility_accuracy": 0.7927, "abstract_cost_mean": 0.435, "cost_error": 0.057},
    },
    "simulated": {
        "detailed_cost_mean": 0.466,
        "detailed_cost_std": 0.202,
        "learned": {"feasibility_accuracy": 0.9669, "abstract_cost_mean": 0.469, "cost_error": 0.013},
        "manual": {"feasibility_accuracy": 0.6535, "abstract_cost_mean": 0.402, "cost_error": 0.021},
    },
    "real": {
        "detailed_cost_mean": 0.509,
        "detailed_cost_std": 0.236,
        "learned": {"feasibility_accuracy": 0.9262, "abstract_cost_mean": 0.446, "cost_error": 0.081},
        "manual": {"feasibility_accuracy": 0.6977, "abstract_cost_mean": 0.429, "cost_error": 0.103},
    },
}

#: Table II: heuristic -> weight -> speed-up and cost increase against the geometric heuristic at W = 1.
HEURISTIC_PERFORMANCE = {
    "learned": {
        1.0: {"speedup": 27.80, "cost_increase": 0.0477},
        1.25: {"speedup": 708.5, "cost_increase": 0.105},
        2.0: {"speedup": 10860.0, "cost_increase": 0.331},
    },
    "geometric": {
        1.25: {"speedup": 12.00, "cost_increase": 0.0607},
        2.0: {"speedup": 27.88, "cost_increase": 0.339},
    },
}

#: Sec. V-C and VI-A: generated maps, kept maps and their tasks; costs for the random set from Table I.
LABELS = {
    "train": {"maps_before": 18_000, "maps": 11_327, "tasks": 249_194},
    "random": {"maps_before": 1_800, "maps": 1_124, "tasks": 24_728, "cost_mean": 0.476, "cost_std": 0.222},
}

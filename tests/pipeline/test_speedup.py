"""Speed-ups and cost increases as in the paper's Table II."""

import pytest

from pipeline.paper import HEURISTIC_PERFORMANCE
from pipeline.speedup import best_known, is_bound, summarise

# Seconds and costs in the paper's plots for goals I to VII, geometric W = 1 and learned W = 1.25.
GEOMETRIC = [(6.63, 4.54), (3.42, 5.77), (794, 9.61), (5.18, 7.22), (130.9, 8.42), (5932, 10.81), (4.73, 3.79)]
LEARNED = [(0.10, 5.06), (0.23, 6.37), (23.88, 10.12), (0.12, 7.86), (4.25, 9.15), (1.25, 12.75), (0.19, 4.20)]


def run(pair, heuristic, weight, seconds, cost, status="solved"):
    base = {"pair": pair, "heuristic": heuristic, "weight": weight, "expansions": 10, "status": status}
    base["stats"] = {"memory": 1000 * (pair + 1)}
    return base | {"seconds": seconds, "cost": cost if status == "solved" else None}


def test_the_papers_own_figures_give_the_papers_table():
    runs = [run(i, "geometric", 1.0, *values) for i, values in enumerate(GEOMETRIC)]
    runs += [run(i, "trained", 1.25, *values) for i, values in enumerate(LEARNED)]
    ours, theirs = summarise(runs)["trained"]["1.25"], HEURISTIC_PERFORMANCE["learned"][1.25]
    assert ours["speedup"] == pytest.approx(theirs["speedup"], rel=0.02)
    assert ours["cost_increase"] == pytest.approx(theirs["cost_increase"], abs=0.01)
    assert not ours["speedup_is_lower_bound"]


def test_a_reference_that_hit_its_limit_gives_a_lower_bound_and_no_cost():
    runs = [run(0, "geometric", 1.0, 6.0, None, "expansion_limit"), run(0, "trained", 2.0, 0.5, 7.0)]
    entry = summarise(runs)["trained"]["2.0"]
    assert (entry["speedup"], entry["speedup_is_lower_bound"]) == (12.0, True)
    assert (entry["cost_increase"], entry["cost_pairs"]) == (None, 0)


def test_searches_that_failed_count_as_unsolved():
    runs = [run(0, "geometric", 1.0, 3.0, 4.0), run(0, "trained", 1.0, 1.0, None, "infeasible")]
    entry = summarise(runs)["trained"]["1.0"]
    assert (entry["pairs"], entry["solved"], entry["speedup"]) == (1, 0, None)


def test_costs_are_compared_with_the_least_that_any_search_found():
    runs = [
        run(0, "geometric", 1.0, 40.0, None, "time_limit"),
        run(0, "manual", 1.0, 3.0, 4.0),
        run(0, "trained", 1.25, 1.0, 5.0),
        run(1, "geometric", 1.0, 40.0, 8.0),
        run(1, "trained", 1.25, 1.0, 8.8),
        run(2, "trained", 1.25, 1.0, None, "infeasible"),
    ]
    assert best_known(runs) == {
        0: {"cost": 4.0, "heuristic": "manual", "weight": 1.0},
        1: {"cost": 8.0, "heuristic": "geometric", "weight": 1.0},
    }
    trained, geometric = summarise(runs)["trained"]["1.25"], summarise(runs)["geometric"]["1.0"]
    assert trained["cost_above_best"] == pytest.approx((0.25 + 0.1) / 2)
    assert trained["cost_increase"] == pytest.approx(0.1)
    assert (trained["speedup"], trained["speedup_least"], trained["speedup_is_lower_bound"]) == (40.0, 40.0, True)
    assert geometric["seconds_is_lower_bound"] and not trained["seconds_is_lower_bound"]
    assert trained["memory_max"] == 3000


@pytest.mark.parametrize("status", ["time_limit", "expansion_limit", "memory_limit"])
def test_what_a_limit_ended_is_a_bound(status):
    assert is_bound(run(0, "geometric", 1.0, 1.0, None, status))
    assert not is_bound(run(0, "geometric", 1.0, 1.0, 2.0)) and not is_bound(
        run(0, "geometric", 1.0, 1.0, None, "infeasible")
    )

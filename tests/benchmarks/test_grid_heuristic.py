import pytest

from benchmarks import grid_heuristic


def test_grid_searches_find_the_optimum_of_geometric_ones_with_less(tmp_path):
    arguments = ["--tasks", "VII", "--scan", str(tmp_path / "absent.npz"), "--limit", "300000"]
    result = grid_heuristic.main(arguments)
    geometric, grid = result["runs"]
    assert (geometric["status"], grid["status"], result["arena"]) == ("solved", "solved", "true heights")
    assert grid["cost"] == pytest.approx(geometric["cost"], abs=1e-3)
    assert grid["lower_bound"] <= grid["cost"] and grid["settled"] > 0 == geometric["settled"]
    assert (result["others"], result["others_capped"], result["vi_cost"], result["iii_bound"]) == (1, 0, None, None)
    ratio = grid["expansions"] / geometric["expansions"]
    assert result["others_expansions"] == pytest.approx(ratio, abs=1e-4) and ratio < 0.15


def test_a_search_that_ends_at_its_limit_bounds_the_cost_from_below(tmp_path):
    scan = ["--scan", str(tmp_path / "absent.npz")]
    limits = ["--limit", "100", "--iii-limit", "2000", "--polish", "0"]
    result = grid_heuristic.main(["--tasks", "III", *scan, *limits])
    geometric, grid = result["runs"]
    assert {geometric["status"], grid["status"]} == {"expansion_limit"} and grid["cost"] is None
    assert 0 < geometric["lower_bound"] < grid["lower_bound"]
    assert 1 <= result["iii_bound"] < 2 and result["others_expansions"] is None
    assert (result["iii_expansions"], result["iii_cost"]) == (2000, None)

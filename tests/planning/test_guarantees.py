"""The benchmarks behind docs/guarantees.md: their measurements hold, and the page has a place for them."""

import re
import shutil

import numpy as np
import pytest

from benchmarks import inadmissibility, multi_heuristic, page
from hdsp import InputError
from tests import ROOT

PAGE = ROOT / "docs" / "guarantees.md"


def a_copy(folder):
    (folder / "figures").mkdir()
    return shutil.copy(PAGE, folder / "guarantees.md")


def test_anchored_searches_prove_their_bound_on_a_random_arena(tmp_path):
    copy = a_copy(tmp_path)
    kept = ["--out", str(tmp_path / "out")]
    options = ["--tasks", "1", "--seed", "1002", "--bounds", "2", "--expansions", "20000", *kept]
    result = multi_heuristic.main([*options, "--page", str(copy), "--json", str(tmp_path / "found.json")])
    assert [run["search"] for run in result["runs"]] == [
        "geometric", "grid", "plain", "anchored 1 x W", "anchored W^1/2 x W^1/2",
    ]  # fmt: skip
    runs = {run["search"]: run for run in result["runs"]}
    anchored = [run for name, run in runs.items() if name.startswith("anchored") and run["status"] == "solved"]
    assert anchored and all(1 <= run["proved"] <= 2 for run in anchored)
    assert runs["plain"]["proved"] is None and runs["plain"]["settled"] == runs["geometric"]["settled"] == 0
    assert runs["grid"]["settled"] > 0
    ratio = runs["geometric"]["expansions"] / runs["anchored W^1/2 x W^1/2"]["expansions"]
    assert result["bound_2_expansions"] == pytest.approx(ratio, rel=1e-3)
    assert "| 2 | manual, anchored 1 x W | " in copy.read_text()
    assert (tmp_path / "found.json").stat().st_size > 0
    assert multi_heuristic.main(options)["runs"] == result["runs"]  # kept, times included


def test_a_search_that_ends_at_its_limit_counts_with_it():
    def run(search, task, expansions, cost):
        return {
            "place": "a", "task": task, "search": search, "guide": None, "bound": 2.0, "expansions": expansions,
            "status": "expansion_limit" if cost is None else "solved", "cost": cost, "settled": 0,
            "cpu_s": expansions / 1000, "proved": None if cost is None else 2.0,
        }  # fmt: skip

    runs = [
        run("geometric", "1", 900, None), run("grid", "1", 100, 1.5),
        run("geometric", "2", 400, 1.0), run("grid", "2", 100, 1.0),
        run("geometric", "3", 900, None), run("grid", "3", 900, None),
    ]  # fmt: skip
    geometric, grid = multi_heuristic.summary(runs)
    assert (grid["tasks"], grid["compared"], grid["geometric_solved"], geometric["solved"]) == (2, 2, 1, 1)
    assert grid["expansions"].mean == pytest.approx(6) and grid["time"].mean == pytest.approx(6)
    assert grid["time_both"].mean == pytest.approx(4)


def test_measured_inadmissibility_is_that_of_exact_costs(tmp_path):
    copy = a_copy(tmp_path)
    options = ["--seeds", "1", "--pairs", "5", "--far", "0.6", "--expansions", "30000", "--guides", "manual"]
    result = inadmissibility.main([*options, "--page", str(copy)])
    assert result["pairs_solved"] >= 1
    geometric, manual = (result["heuristics"][name] for name in ("geometric", "manual"))
    for kind in ("pairs", "with_ways"):
        assert geometric[kind]["above_1"] == 0 and geometric[kind]["max"] <= 1
        assert manual[kind]["max"] >= manual[kind]["q99"] >= manual[kind]["q50"] >= geometric[kind]["q50"]
    assert geometric["with_ways"]["n"] > geometric["pairs"]["n"] == result["pairs_solved"]
    assert "| manual | random pairs | " in copy.read_text()
    assert (tmp_path / "figures" / "inadmissibility.png").stat().st_size > 1000


def test_quantiles_are_those_of_the_ratios():
    assert inadmissibility.scores(np.linspace(0, 2, 101)) == {
        "n": 101, "q50": 1.0, "q90": 1.8, "q95": 1.9, "q99": 1.98, "max": 2.0, "above_1": 0.495,
    }  # fmt: skip


def test_a_block_replaces_what_was_there_and_nothing_else(tmp_path):
    shown = tmp_path / "page.md"
    begin, end = "<!-- written by me: begin -->\n", "<!-- written by me: end -->\nafter\n"
    shown.write_text(f"before\n{begin}old\n{end}")
    page.write_block(shown, "me", page.table(["a", "b"], [[1, None]]))
    assert shown.read_text() == f"before\n{begin}| a | b |\n| --- | --- |\n| 1 |  |\n{end}"
    with pytest.raises(InputError, match="marks"):
        page.write_block(shown, "you", "")


def test_the_page_shows_measured_figures():
    text = PAGE.read_text()
    for author in ("benchmarks.multi_heuristic", "benchmarks.inadmissibility"):
        (block,) = re.findall(rf"written by {author}: begin -->\n(.*?)<!-- written by {author}: end", text, re.S)
        assert block.count("\n|") > 3

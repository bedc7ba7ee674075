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
    options = ["--seeds", "1", "--bounds", "2", "--expansions", "20000", "--guides", "manual"]
    result = multi_heuristic.main([*options, "--page", str(copy), "--json", str(tmp_path / "found.json")])
    assert [run["search"] for run in result["runs"]] == [
        "geometric", "plain", "anchored 1 x W", "anchored W^1/2 x W^1/2",
    ]  # fmt: skip
    anchored = [run for run in result["runs"] if run["search"].startswith("anchored") and run["status"] == "solved"]
    assert anchored and all(1 <= run["proved"] <= 2 for run in anchored)
    assert all(run["proved"] is None for run in result["runs"] if run["search"] == "plain")
    assert {row["search"] for row in result["summary"]} == {"anchored 1 x W", "anchored W^1/2 x W^1/2"}
    assert "| manual | 2 | 1 x W | " in copy.read_text()
    assert (tmp_path / "found.json").stat().st_size > 0


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

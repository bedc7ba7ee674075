"""The tables show our numbers beside the paper's; missing numbers stay empty."""

import json

import pytest

from hdsp.base.errors import InputError
from pipeline.config import configure
from pipeline.headline import headline_table
from pipeline.publish_pages import HEADLINE, TABLES, put_between_markers
from pipeline.random_tasks import summarise_random
from pipeline.report import all_tables, summary
from pipeline.tables import abstraction_quality_table, heuristic_table, random_task_table
from tests import ROOT

METHOD = {"feasibility_accuracy": 0.9512, "cost_error": 0.0201, "abstract_cost_mean": 0.44}
QUALITY = {
    "sets": {
        "random": {
            "available": True, "paper": "random", "maps": 150, "tasks": 3300,
            "detailed_cost_mean": 0.45, "detailed_cost_std": 0.21,
            "methods": {"trained": METHOD, "flat": {**METHOD, "feasibility_accuracy": 0.61}},
        },
        "real": {"available": False, "paper": "real", "reason": "data/real is not there yet"},
    }
}  # fmt: skip
ENTRY = {
    "pairs": 3, "solved": 3, "seconds_mean": 1.5, "seconds_is_lower_bound": False, "expansions_mean": 1e5,
    "memory_max": 2_400_000, "cost_increase": 0.021, "cost_above_best": 0.034, "speedup": 26.94,
}  # fmt: skip
RUNS = [
    {"pair": "I", "heuristic": "geometric", "weight": 1.0, "status": "time_limit", "seconds": 40.02, "cost": None},
    {"pair": "I", "heuristic": "trained", "weight": 1.25, "status": "solved", "seconds": 0.0213, "cost": 4.567},
]
PLANNING = {
    "arena": {"source": "the scanned arena", "size": 5.0, "pairs": 3},
    "limits": {"time": 40.0, "expansions": 50_000_000, "memory": 6_000_000_000},
    "processes": 2,
    "edges_seconds": {"trained": 21.4, "shipped": 8.0},
    "edges_share": {"trained": 0.663, "shipped": 1.0},
    "runs": RUNS,
    "best_known": {"I": {"cost": 4.567, "heuristic": "trained", "weight": 1.25}},
    "collisions": {"checked": 5, "free": 4, "least_body_clearance": 0.0213},
    "summary": {
        "geometric": {
            "1.0": {
                **ENTRY, "speedup": 1.0, "cost_increase": 0.0, "speedup_is_lower_bound": False,
                "seconds_is_lower_bound": True,
            }
        },
        "trained": {"1.25": {**ENTRY, "speedup_is_lower_bound": True}},
    },
}  # fmt: skip


def cells(table: str, row: str) -> list[str]:
    line = next(line for line in table.splitlines() if line.startswith(f"| {row}"))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_ours_stand_beside_the_papers():
    table = abstraction_quality_table(QUALITY)
    assert cells(table, "feasibility correct, trained")[1:] == ["95.12 % / 95.04 %", "– / 92.62 %"]
    assert cells(table, "mean cost error, trained")[1:] == ["0.020 / 0.027", "– / 0.081"]
    assert cells(table, "feasibility correct, flat")[1:] == ["61.00 %", "–"]
    assert "No data for real" in table


def test_speed_ups_and_times_that_are_bounds_are_marked():
    table = heuristic_table(PLANNING)
    trained = cells(table, "trained abstraction")
    assert trained[1:] == ["1.25", "3 of 3", "1.50", "100,000", "2", "≥ 26.9x", "708x", "+2.1 %", "+10.5 %", "+3.4 %"]
    assert cells(table, "geometric")[3] == "≥ 1.50" and cells(table, "geometric")[6:9] == ["1.0x", "–", "+0.0 %"]
    assert "here 40 s, 50 million expansions, or 6 GB of memory" in table
    seconds = "trained abstraction 21.4 s for the 66 % of the states that these tasks need, shipped abstraction 8.0 s;"
    assert seconds in table and "2 processes search side by side" in table


def test_each_task_has_its_time_and_cost():
    table = heuristic_table(PLANNING).split("\n\n")[2]
    assert cells(table, "heuristic")[2:] == ["I"]
    assert cells(table, "geometric")[2:] == ["≥ 40.0, ×"]
    assert cells(table, "trained abstraction")[2:] == ["0.021, 4.57"]
    assert cells(table, "best known")[2:] == ["4.57"]


def test_the_check_against_the_truth_is_told_where_there_is_one():
    told = "4 of 5 paths are free of collisions; the least distance between body and obstacle is 21 mm."
    assert told in heuristic_table(PLANNING)
    unchecked = {**PLANNING, "collisions": {"checked": 0, "free": 0, "least_body_clearance": None}}
    assert "collisions" not in heuristic_table(unchecked)


def test_the_summary_holds_the_headlines():
    assert summary(QUALITY, PLANNING) == {
        "feasibility_accuracy": {"random": {"trained": 0.9512, "flat": 0.61}},
        "cost_error": {"random": {"trained": 0.0201, "flat": 0.0201}},
        "speedup": {"trained": {"W1.25": 26.94}},
    }


def test_tables_go_between_the_markers_and_nowhere_else(tmp_path):
    readme = tmp_path / "README.md"
    begin, end = TABLES
    readme.write_text(f"before\n{begin}\nold\n{end}\nafter\n")
    put_between_markers(readme, "| new |\n", *TABLES)
    assert readme.read_text() == f"before\n{begin}\n\n| new |\n\n{end}\nafter\n"
    readme.write_text("no markers")
    with pytest.raises(InputError, match="lacks the markers"):
        put_between_markers(readme, "| new |\n", *TABLES)


def test_the_page_of_results_shows_the_tables_of_the_reports():
    tables = (ROOT / "reports/tables.md").read_text()
    assert f"{TABLES[0]}\n\n{tables}\n{TABLES[1]}" in (ROOT / "docs/results.md").read_text()


def test_the_readme_shows_the_headline_numbers_of_the_reports():
    quality, planning = (
        json.loads((ROOT / f"reports/{name}.json").read_text()) for name in ("abstraction_quality", "planning")
    )
    shown = f"{HEADLINE[0]}\n\n{headline_table(quality, planning)}\n\n{HEADLINE[1]}"
    assert shown in (ROOT / "README.md").read_text()


def test_headlines_stand_beside_the_papers_and_may_be_missing():
    shipped = {"1.25": {**ENTRY, "speedup_is_lower_bound": True}}
    table = headline_table(QUALITY, {"summary": {"shipped": shipped}})
    assert cells(table, "feasibility correct, scans of real places")[1:] == ["–", "–", "92.62 %"]
    assert cells(table, "mean planning time in the arena")[1:] == ["1.50 s", "–", "–"]
    assert cells(table, "speed-up in the arena")[1:] == ["≥ 26.9x", "–", "708x"]
    assert cells(table, "cost above the optimum in the arena")[1:] == ["+2.1 %", "–", "+10.5 %"]


def test_the_tables_can_be_traced_to_the_reports():
    names = ("abstraction_quality", "planning", "training")
    quality, planning, training = (json.loads((ROOT / f"reports/{name}.json").read_text()) for name in names)
    assert all_tables(quality, planning, training) == (ROOT / "reports/tables.md").read_text()


def test_random_tasks_are_judged_pair_by_pair():
    section = configure().planner.random
    runs = [
        {"pair": "0.0", "heuristic": "manual", "status": "solved", "cost": 2.0, "expansions": 100, "seconds": 0.1},
        {"pair": "0.1", "heuristic": "manual", "status": "expansion_limit", "cost": None, "expansions": 500_000,
         "seconds": 0.5},
        {"pair": "0.2", "heuristic": "manual", "status": "infeasible", "cost": None, "expansions": 9, "seconds": 0.1},
        {"pair": "0.0", "heuristic": "trained", "status": "solved", "cost": 2.2, "expansions": 50, "seconds": 0.1},
        {"pair": "0.1", "heuristic": "trained", "status": "solved", "cost": 4.0, "expansions": 2_000, "seconds": 0.1},
        {"pair": "0.2", "heuristic": "trained", "status": "infeasible", "cost": None, "expansions": 9, "seconds": 0.1},
    ]  # fmt: skip
    table = random_task_table({
        "arenas": 1, "size": 5.0, "weight": 1.25, "tasks": 3, "expansions": 500_000,
        "summary": summarise_random(runs, section),
    })  # fmt: skip
    assert cells(table, "manual abstraction")[1:4] == ["1 of 2", "100", "500,000"]
    assert cells(table, "trained abstraction")[1:] == ["2 of 2", "50", "2,000", "0.10", "+5.0 %"]
    assert "2 have a plan, 1 are hard for the manual abstraction" in table

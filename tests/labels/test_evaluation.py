import json
from dataclasses import replace

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.labels.evaluation import COLUMNS, evaluate_set, predict, rows
from hdsp.labels.tasks import FIELDS, TaskSet
from hdsp.robot.lattice import robot_frame_goals


class Answers:
    """A predictor with fixed predictions."""

    def __init__(self, feasible, cost):
        self.feasible, self.cost = feasible, cost

    def predict(self, patches, goals):
        return self.feasible, self.cost


def a_set(feasible, cost, categories):
    arrays = {name: np.zeros((len(categories), *shape), dtype) for name, (dtype, shape) in FIELDS.items()}
    arrays |= {"feasible": feasible, "cost": np.where(feasible, cost, 0), "category": categories}
    arrays["goals"] = np.repeat(robot_frame_goals(0)[None], len(categories), axis=0)
    return TaskSet(**arrays)


@pytest.fixture
def four_maps():
    rng = np.random.default_rng(5)
    feasible = rng.random((4, 22)) < 0.6
    return a_set(feasible, rng.uniform(0.1, 1.0, (4, 22)), ["wall_1", "cuboid_1", "wall_1", "staircase"])


def test_the_labels_themselves_are_perfect(four_maps):
    figures = evaluate_set({"it": Answers(four_maps.feasible, four_maps.cost)}, four_maps)["methods"]["it"]
    assert figures["feasibility_accuracy"] == 1.0
    assert figures["cost_error"] == 0.0
    assert figures["both_feasible"] == figures["judged_feasible"] == four_maps.feasible.sum()


def test_cost_counts_only_where_both_judge_feasible():
    feasible = np.zeros((1, 22), bool)
    feasible[0, :4] = True
    tasks = a_set(feasible, np.full((1, 22), 0.5), ["wall_1"])
    judged, cost = np.zeros((1, 22), bool), np.full((1, 22), np.inf)
    judged[0, 2:6] = True  # two right, two wrongly feasible, two wrongly infeasible
    cost[0, 2:6] = [0.4, 0.7, 100.0, 100.0]
    figures = evaluate_set({"it": Answers(judged, cost)}, tasks)
    it = figures["methods"]["it"]
    assert it["feasibility_accuracy"] == pytest.approx(18 / 22)
    assert it["both_feasible"] == 2
    assert it["cost_error"] == pytest.approx(0.15)
    assert it["abstract_cost_mean"] == pytest.approx(0.55)
    assert it["compared_cost_mean"] == pytest.approx(0.5)
    assert figures["detailed_cost_mean"] == pytest.approx(0.5)
    assert figures["detailed_cost_std"] == pytest.approx(0.0)


def test_costs_for_planning_are_compared_where_both_sides_have_them(four_maps):
    class Planning(Answers):
        predicts_planning_cost = True

        def for_planning(self):
            return Answers(self.feasible, 0.5 * self.cost + 0.1)

    planned = replace(four_maps, planning_cost=0.5 * four_maps.cost)
    known, unknown = Planning(four_maps.feasible, four_maps.cost), Answers(four_maps.feasible, four_maps.cost)

    def errors(tasks):
        methods = evaluate_set({"known": known, "unknown": unknown}, tasks)["methods"]
        return [methods[name]["planning_cost_error"] for name in ("known", "unknown")]

    assert errors(planned) == [pytest.approx(0.1), None]
    assert errors(four_maps) == [None, None]


def test_categories_add_up_to_the_set(four_maps):
    rng = np.random.default_rng(0)
    figures = evaluate_set({"it": Answers(rng.random((4, 22)) < 0.5, rng.random((4, 22)))}, four_maps)
    parts = figures["categories"]
    assert list(parts) == ["wall_1", "cuboid_1", "staircase"]
    assert parts["wall_1"]["maps"] == 2
    for count in ("maps", "tasks", "feasible"):
        assert sum(part[count] for part in parts.values()) == figures[count]
    it, of_parts = figures["methods"]["it"], [part["methods"]["it"] for part in parts.values()]
    assert sum(part["both_feasible"] for part in of_parts) == it["both_feasible"]
    weighted = sum(part["cost_error"] * part["both_feasible"] for part in of_parts)
    assert weighted / it["both_feasible"] == pytest.approx(it["cost_error"])


def test_rows_have_the_columns_of_the_table(four_maps):
    figures = evaluate_set(
        {"a": Answers(four_maps.feasible, four_maps.cost), "b": Answers(*flat(four_maps))}, four_maps
    )
    table = rows({"random": {"available": True, **figures}, "real": {"available": False, "reason": "no scans"}})
    assert [set(row) for row in table] == [set(COLUMNS)] * len(table)
    assert [(row["category"], row["method"]) for row in table[:2]] == [("all", "a"), ("all", "b")]
    assert len(table) == 2 * (1 + 3)
    assert {row["set"] for row in table} == {"random"}
    json.dumps(table, allow_nan=False)


def test_a_predictor_that_sees_nothing_feasible_has_no_cost_error(four_maps):
    nothing = Answers(np.zeros((4, 22), bool), np.full((4, 22), np.inf))
    figures = evaluate_set({"it": nothing}, four_maps)["methods"]["it"]
    assert figures["cost_error"] is None
    assert figures["abstract_cost_mean"] is None
    assert figures["feasibility_accuracy"] == pytest.approx(1 - four_maps.feasible.mean())


@pytest.mark.parametrize(
    ("feasible", "cost", "named"),
    [
        (np.ones((4, 21), bool), np.ones((4, 21)), r"\(4, 21\)"),
        (np.ones((4, 22), bool), np.full((4, 22), np.nan), "finite"),
    ],
)
def test_answers_that_are_none_are_named(four_maps, feasible, cost, named):
    with pytest.raises(InputError, match=named):
        predict(Answers(feasible, cost), four_maps)


def test_an_empty_set_is_refused():
    with pytest.raises(InputError, match="no tasks"):
        evaluate_set({}, TaskSet.empty())


def flat(tasks):
    return np.ones(tasks.feasible.shape, bool), np.full(tasks.cost.shape, 0.3)

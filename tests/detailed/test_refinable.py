"""Steps without a motion are reported, and the planner plans again without them."""

import math

import numpy as np
import pytest

import hdsp.planning.answers.plans
from hdsp import HeightMap, Planner, RefinementError, Status
from hdsp.detailed.actions.action import BASE_FORWARD, STEP, ActionKind, action_of
from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.motion.refinement import ban, last_step
from hdsp.detailed.world.world import cell_index
from tests.detailed.instances import successor_arrays
from tests.detailed.test_refine import stretched, with_bar

START, GOAL = (0.5, 0.75, 0.0), (1.6, 0.75, 0.0)


@pytest.fixture(scope="module")
def planner():
    made = Planner(with_bar(), heuristic="manual").prepare()
    made.plan(START, GOAL, weight=2, refinable=True)  # the first query of its kind compiles by a trial, which refines
    return made


def steps_of(plan):
    steps = [k for k, action in enumerate(plan.actions) if action.kind is ActionKind.STEP]
    return [(plan.actions[k], *plan.states[k].round(6)) for k in steps]


def refusing(refused_steps, monkeypatch):
    """Makes refinement refuse certain steps; returns its calls."""
    refine, asked = hdsp.planning.answers.plans.refine_steps, []

    def strict(terrain, robot, states, actions):
        asked.append(actions)
        for k, action in enumerate(actions):
            if (action, *states[k].round(6)) in refused_steps:
                raise RefinementError(k, f"{action} cannot be carried out: the test says so")
        return refine(terrain, robot, states, actions)

    monkeypatch.setattr(hdsp.planning.answers.plans, "refine_steps", strict)
    return asked


def test_a_step_that_cannot_be_carried_out_is_reported_and_avoided(planner, monkeypatch):
    before = planner.plan(START, GOAL, weight=2, polish=0)
    unwanted = steps_of(before)[1]
    asked = refusing({unwanted}, monkeypatch)
    plan = planner.plan(START, GOAL, weight=2, refinable=True, polish=0)
    assert plan.solved and unwanted not in steps_of(plan)
    assert len(plan.refused) == len(asked) - 1 >= 1
    assert str(unwanted[0]) in plan.refused[0] and "the test says so" in plan.refused[0]
    assert plan.refine().check() == [] and len(asked) == len(plan.refused) + 1  # the motion is kept
    assert plan.stats["expansions"] > before.stats["expansions"]
    assert len(planner.world.banned) == 0
    assert steps_of(planner.plan(START, GOAL, weight=2, polish=0)) == steps_of(before)


def test_a_plan_whose_steps_can_all_be_carried_out_stays_as_it_is(planner):
    plain, refinable = (planner.plan(START, GOAL, weight=2, refinable=wanted) for wanted in (False, True))
    assert refinable.refused == () and plain.actions == refinable.actions


def test_what_cannot_be_carried_out_without_a_step_to_blame_is_an_error(planner, monkeypatch):
    def refuse(*_):
        raise RefinementError(0, "drive cannot be carried out")

    monkeypatch.setattr(hdsp.planning.answers.plans, "refine_steps", refuse)
    with pytest.raises(RefinementError, match="drive"):
        planner.plan(START, GOAL, weight=2, refinable=True)


def test_legs_too_short_for_any_step_leave_no_plan():
    planner = Planner(with_bar(), stretched(min_length=0.6, max_length=0.68), heuristic="manual")
    plan = planner.plan(START, GOAL, weight=2, refinable=True, expansions=400_000)
    assert not plan.solved and plan.status in (Status.INFEASIBLE, Status.EXPANSION_LIMIT)
    assert plan.refused and "0.6 to 0.68 m" in plan.refused[0]
    assert "could not be carried out" in plan.explain()


def kernel_steps(world, state):
    _, _, codes = successor_arrays(world, state)
    return sorted((action_of(int(code)) for code in codes if code >= STEP), key=str)


def test_a_ban_takes_one_step_of_a_foot_and_grows_when_it_fails_again(planner):
    plan = planner.plan(START, GOAL, weight=2)
    k = last_step(plan.actions, len(plan.actions) - 1)
    state = planner.grid.to_lattice(plan.states[k, :3], plan.states[k, 3:])
    world, action = planner.world, plan.actions[k]
    before = kernel_steps(world, state)
    assert action in before
    banned = ban(world.banned, world, planner.grid, plan.states[k], action)
    assert kernel_steps(world._replace(banned=banned), state) == [step for step in before if step != action]

    foot = action.stepping_foot
    near = state.copy()
    near[3 + (foot + 1) % 4] += 1  # another foot a cell farther
    tolerance = [0]
    for _ in range(3):
        banned = ban(banned, world, planner.grid, plan.states[k], action)
        tolerance.append(int(banned[-1, 6]))
    assert tolerance == [0, 1, 2, 4]
    if action in kernel_steps(world, near):
        assert action not in kernel_steps(world._replace(banned=banned), near)
    row = foot_row(world.tables, int(state[2]), foot, int(state[3 + foot]) - world.tables.lowest)
    cell = int(cell_index(world, state[0], state[1])) + int(world.tables.feet[row])
    assert (banned[:, :3] == (foot, cell, state[2])).all()


def test_the_last_step_before_an_action_is_to_blame():
    actions = [action_of(code) for code in (0, STEP + 26, BASE_FORWARD, STEP + 32 + 26)]
    assert [last_step(actions, k) for k in (-1, 0, 1, 2, 3)] == [None, None, 1, 1, 3]


def ramp(degrees):
    """A ramp of 1.5 m along x for a robot with short legs, whose cheapest plan is at the end of their reach."""
    along = (np.arange(240) + 0.5) * 0.025
    heights = np.clip(along - 1.8, 0, 1.5) * math.tan(math.radians(degrees))
    return Planner(HeightMap(np.repeat(heights[:, None], 120, axis=1)), "go2w", "manual")


@pytest.mark.parametrize("degrees", [24, -24])
def test_without_a_step_to_blame_the_polished_plan_is_carried_out(degrees):
    planner, ends = ramp(degrees), ((1.0, 1.5, 0.0), (5.0, 1.5, 0.0))
    assert planner.plan(*ends, refinable=True).refine().check() == []
    plans = list(planner.improve(*ends, refinable=True, expansions=20_000))
    assert plans and all(plan.refine().check() == [] for plan in plans)

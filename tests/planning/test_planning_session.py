"""The session behind the viewer, without a browser: the latest request counts, and everything arrives in order."""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from hdsp import HeightMap, Planner
from hdsp.detailed.search.outcome import Status
from hdsp.planning.viewing import planning_session
from hdsp.planning.viewing.first_poses import first_poses
from hdsp.planning.viewing.map_layers import LayerSources, abstract_edges, costs_to_go, foot_costs, searched_cells
from hdsp.planning.viewing.planning_session import PlanningRequest, PlanningSession

SECONDS = 300  # of patience, also for kernels that are compiled
START, GOAL, ON_WALL = (0.8, 0.8, 0.0), (2.2, 2.2, 0.0), (1.5, 1.0, 0.0)


def walled_room():
    """3 x 3 m with a wall across the lower half."""
    heights = np.zeros((120, 120), np.float32)
    heights[56:64, :60] = 1.0
    return HeightMap(heights)


class Recorder:
    """A listener that keeps what it hears."""

    def __init__(self):
        self.answers, self.motions, self.causes, self.words, self.errors, self.works = [], [], [], [], [], []
        self.explained = threading.Event()

    def on_answer(self, answer):
        self.answers.append(answer)

    def on_motion(self, answer, motion, refusal):
        self.motions.append((answer, motion, refusal))

    def on_causes(self, answer):
        self.causes.append((answer, answer.plan.causes))

    def on_explanation(self, answer, words):
        self.words.append(words)
        self.explained.set()

    def on_error(self, request, words):
        self.errors.append((request, words))

    def on_work(self, words, share):
        self.works.append((words, share))


@pytest.fixture
def heard():
    return Recorder()


@pytest.fixture
def session(heard):
    session = PlanningSession(walled_room(), heard)
    yield session
    session.close()


def test_a_plan_its_polish_and_its_motion_arrive(session, heard):
    request = PlanningRequest(START, GOAL)
    session.ask(request)
    assert session.wait(SECONDS)
    assert heard.errors == []
    assert all(answer.request is request and answer.plan.solved for answer in heard.answers)
    costs = [answer.plan.cost for answer in heard.answers]
    assert costs == sorted(costs, reverse=True) and len(costs) <= 2
    ((answer, motion, refusal),) = heard.motions
    assert answer is heard.answers[-1] and motion.problems() == [] and refusal == ""
    # The heuristic is then known for the whole map.
    assert answer.planner.heuristic.known.share == 1
    assert heard.works[-1] == ("", None)

    session.change(goal=(2.2, 0.8, 0.0), tolerance=0.2)
    assert session.wait(SECONDS)
    last = heard.answers[-1]
    assert (last.request.start, last.request.tolerance) == (START, 0.2)
    assert np.hypot(*(last.plan.states[-1, :2] - (2.2, 0.8))) <= 0.2 + 0.025
    assert last.planner is answer.planner


def test_the_latest_request_ends_a_running_search(session, heard):
    begun, planned = threading.Event(), []

    def plan(start, goal, weight, *, progress, **_):
        planned.append(goal)
        begun.set()
        for expansions in range(5000):
            if goal == GOAL:
                break
            progress(expansions, 0.0)
            time.sleep(0.001)
        return SimpleNamespace(solved=True, cost=1.0, ends=(), refine_until=lambda ends: True, refine=lambda: None)

    heuristic = SimpleNamespace(admissible=True)
    session.planner = lambda request: SimpleNamespace(plan=plan, heuristic=heuristic)
    session.ask(PlanningRequest(START, (0.9, 2.0, 0.0)))
    assert begun.wait(5)
    for x in np.linspace(1.0, 2.0, 5):
        session.change(goal=(float(x), 2.0, 0.0))
    began = time.perf_counter()
    session.change(goal=GOAL)
    assert session.wait(5)
    assert time.perf_counter() - began < 2.5  # the searches for older goals would take 5 s each
    assert [answer.request.goal for answer in heard.answers] == [GOAL]
    assert len(planned) <= 3


def test_kernels_that_an_answer_does_not_need_are_compiled_behind_it(session, heard, monkeypatch):
    answers_before = []
    monkeypatch.setattr(planning_session, "compile_for", lambda *_: answers_before.append(len(heard.answers)))
    for goal in (GOAL, (1.0, 2.0, 0.0)):
        session.ask(PlanningRequest(START, goal, heuristic="geometric"))
        assert session.wait(60)
    assert [answer.plan.solved for answer in heard.answers[-2:]] == [True, True]
    assert len(answers_before) == 1 and answers_before[0] > 0


def test_a_failure_comes_with_its_causes(session, heard):
    session.ask(PlanningRequest(START, ON_WALL))
    assert session.wait(SECONDS) and heard.explained.wait(SECONDS)
    (answer,) = heard.answers
    assert answer.plan.status == Status.INVALID_GOAL
    ((failed, causes),) = heard.causes
    assert failed is answer and causes and all(cause.pose is not None for cause in causes)
    assert heard.words == [answer.plan.explain()]
    assert heard.motions == []


def test_an_error_ends_no_session(session, heard):
    for wrong, words in (({"robot": "nobody"}, "unknown robot"), ({"start": (99.0, 0.0, 0.0)}, "outside the map")):
        session.ask(PlanningRequest(**{"start": START, "goal": GOAL, **wrong}))
        assert session.wait(SECONDS)
        assert words in heard.errors[-1][1]
    session.ask(PlanningRequest(START, GOAL))
    assert session.wait(SECONDS)
    assert heard.answers[-1].plan.solved


def test_another_robot_gets_a_planner_that_is_kept(session, heard):
    planners = []
    for robot in ("momaro", "go2w", "momaro"):
        session.ask(PlanningRequest(START, (0.8, 2.2, None), robot, heuristic="geometric"))
        assert session.wait(SECONDS)
        planners.append(heard.answers[-1].planner)
    assert [planner.robot.name for planner in planners] == ["momaro", "go2w", "momaro"]
    assert planners[0] is planners[2]


def test_open_poses_are_chosen_far_apart_and_later_requests_keep_them(session, heard):
    session.ask(PlanningRequest(goal=GOAL))
    assert session.wait(SECONDS)
    chosen = session.request
    assert chosen.goal == GOAL and np.hypot(chosen.start[0] - 2.2, chosen.start[1] - 2.2) > 1
    session.change(weight=2.0)
    assert session.wait(SECONDS)
    assert session.request.start == chosen.start and heard.answers[-1].plan.stats.weight == 2.0
    start, goal = first_poses(heard.answers[-1].planner)
    assert np.hypot(start[0] - goal[0], start[1] - goal[1]) > 1


def test_layers_show_what_the_planner_knows():
    planner = Planner(walled_room(), heuristic="manual")
    request = PlanningRequest(START, (2.2, 0.8, 0.0))
    plan = planner.plan(request.start, request.goal, request.weight, polish=0.0)
    planner.prepare()
    costs = foot_costs(planner)
    assert (costs[..., 3] > 0).all()
    on_floor, at_wall = costs[20, 20, :3].astype(int), costs[54, 20, :3].astype(int)
    assert at_wall[0] > at_wall[2] and on_floor[2] > on_floor[0]  # red carries no foot

    planner.heuristic.set_goal(planner.grid.to_lattice(request.goal))
    brightness = costs_to_go(planner)[..., :3].astype(int).sum(axis=-1)
    assert brightness[88, 32] < brightness[88, 88] < brightness[20, 20]  # the way leads around the wall

    ground = planner.terrain.with_heights(planner.terrain.heights + 2)
    lines = abstract_edges(planner, ground)
    assert (lines.ends[..., 2] > 2).all()
    crossing = (lines.ends[:, :, 0] < 1.45).any(axis=1) & (lines.ends[:, :, 0] > 1.55).any(axis=1)
    assert len(lines.ends) > 500 and not (crossing & (lines.ends[:, :, 1] < 1.2).all(axis=1)).any()
    assert abstract_edges(Planner(walled_room(), heuristic="geometric"), ground) is None

    answer = SimpleNamespace(request=request, plan=plan, planner=planner)
    seen = searched_cells(answer)
    on_path = planner.grid.cell(plan.states[:-1, :2])
    assert seen[tuple(on_path.T)].all() and not seen.all()


def test_a_layer_of_an_answer_that_is_gone_is_not_taken_for_that_of_a_newer_one():
    layers, planners = LayerSources(("foot costs",)), [SimpleNamespace(), SimpleNamespace()]
    for name in ("cost-to-go", "foot costs"):
        layers.set(name, SimpleNamespace(planner=planners[0]))  # freed at once; the next object takes its place
        assert not layers.has(name, SimpleNamespace(planner=planners[1]))
    assert not layers.has("cost-to-go", SimpleNamespace(planner=planners[0]))
    assert layers.has("foot costs", SimpleNamespace(planner=planners[0]))
    layers.forget()
    assert not layers.has("foot costs", SimpleNamespace(planner=planners[0]))

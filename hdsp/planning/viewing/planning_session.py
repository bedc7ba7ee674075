"""Planning for a user who changes start, goal, robot or heuristic at any moment: the latest wish counts.

One thread plans. It answers the latest request; a newer one ends the search for an older one. After an answer, the
thread continues in short steps with work that can wait: a polished plan, the refined motion, and the map-wide part of
the heuristic. Another thread finds the reasons for the absence of a plan, which may take half a minute.

In a new installation, a query compiles only the kernels that it uses, so that the first path is there soon. A thread
compiles the others behind the first answer.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from hdsp.base.compilation import compilations
from hdsp.base.errors import InputError, RefinementError
from hdsp.base.gradual import Gradual, now
from hdsp.base.messages import shown
from hdsp.base.scalars import real
from hdsp.detailed.motion.motion import Motion
from hdsp.planning.answers.plans import Plan
from hdsp.planning.arguments import number
from hdsp.planning.compiled import compile_for, compile_on_use
from hdsp.planning.heuristics import AbstractHeuristic
from hdsp.planning.planner import Planner
from hdsp.planning.viewing.first_poses import Pose, first_poses
from hdsp.terrain.height_map import HeightMap

_LOG = logging.getLogger("hdsp")
_SLICE = 0.03  # s, of work that can wait; a new request waits at most so long, and for one step
_PLANNERS = 4  # planners that are kept for other robots and heuristics
_KERNELS = 70  # of a query, roughly
_TRIED = 20_000  # expansions of a query that compiles the kernels of the next ones


@dataclass(frozen=True)
class PlanningRequest:
    """A user's wish.

    Attributes:
        start, goal: poses as for `Planner.plan`; None for poses that the session chooses.
        robot: preset name or path to a YAML file.
        heuristic: name as for `Planner`.
        weight: W >= 1.
        tolerance: distance from the goal within which the plan may end, m; 0: at the nearest pose on the lattice.
        margin: distance between body and obstacles, m.
        time: limit of a query, s.

    Raises:
        InputError: weight, tolerance, margin or time is out of range, or a pose has values that are not finite.
    """

    start: Pose | None = None
    goal: Pose | None = None
    robot: Any = "momaro"
    heuristic: str = "manual"
    weight: float = 1.25
    tolerance: float = 0.0
    margin: float = 0.0
    time: float = 60.0

    def __post_init__(self) -> None:
        for name, least in (("weight", 1.0), ("tolerance", 0.0), ("margin", 0.0)):
            number(name, getattr(self, name), least)
        number("time", self.time, 0.0, infinite=True)
        for name, pose in (("start", self.start), ("goal", self.goal)):
            if pose is not None and not all(math.isfinite(real(value)) for value in pose if value is not None):
                raise InputError(f"{name} {shown(pose)}: need finite numbers")


@dataclass(frozen=True, eq=False)
class PlanningAnswer:
    """An answer to a request.

    Attributes:
        request: the request.
        planner: the planner that answered.
        plan: the plan, or the absence of one.
        seconds: time from the request to the plan.
    """

    request: PlanningRequest
    planner: Planner
    plan: Plan
    seconds: float


class PlanningListener(Protocol):
    """Receives everything that a session finds; its methods are called from threads of the session."""

    def on_answer(self, answer: PlanningAnswer) -> None:
        """Takes a plan, or the absence of one; a polished plan comes as another answer to the same request."""

    def on_motion(self, answer: PlanningAnswer, motion: Motion | None, refusal: str) -> None:
        """Takes the refined motion of a plan; None with the reason in words if the plan cannot be carried out."""

    def on_causes(self, answer: PlanningAnswer) -> None:
        """Takes an answer without a plan whose causes are now known."""

    def on_explanation(self, answer: PlanningAnswer, words: str) -> None:
        """Takes the explanation for the absence of a plan, after its causes."""

    def on_error(self, request: PlanningRequest, words: str) -> None:
        """Takes an error in a request."""

    def on_work(self, words: str, share: float | None) -> None:
        """Takes a description of the current work, "" for none, and its share that is done, if known."""


class Superseded(Exception):
    """A newer request ends the search for an older one."""


@dataclass
class PlanningSession:
    """Answers the latest of a user's requests.

    Args:
        terrain: the map.
        listener: receives the answers.
    """

    terrain: HeightMap
    listener: PlanningListener
    _wanted: PlanningRequest | None = None
    _asked_at: float = 0.0
    _number: int = 0
    _closed: bool = False
    _planners: dict[tuple, Planner] = field(default_factory=dict)
    _untried: bool = False

    def __post_init__(self) -> None:
        self._changed = threading.Condition()
        #: Held while a planner works; a planner answers one caller at a time.
        self.working = threading.Lock()
        self._idle = threading.Event()
        self._thread = threading.Thread(target=self._run, name="planning session", daemon=True)
        self._thread.start()

    @property
    def request(self) -> PlanningRequest | None:
        """The latest request."""
        return self._wanted

    def ask(self, request: PlanningRequest) -> None:
        """Asks for a plan; a running search for an older request ends."""
        with self._changed:
            self._wanted, self._asked_at = request, now()
            self._number += 1
            self._idle.clear()
            # The thread sees the number before it sees the end of its query, and begins no other one meanwhile.
            for planner in list(self._planners.values()):
                planner.cancel()
            self._changed.notify_all()

    def change(self, **changes: Any) -> None:
        """Asks for a plan with some values of the latest request changed."""
        if self._wanted is not None:
            self.ask(replace(self._wanted, **changes))

    def wait(self, timeout: float) -> bool:
        """Waits until the session has nothing to do; returns whether this came true in time (s)."""
        return self._idle.wait(timeout)

    def close(self) -> None:
        """Ends the session; a running search ends soon."""
        with self._changed:
            self._closed = True
            self._number += 1
            self._changed.notify_all()
        self._thread.join(timeout=2.0)

    def planner(self, request: PlanningRequest) -> Planner:
        """Returns the planner for a request; the last few are kept."""
        key = request.robot, request.heuristic, request.margin
        found = self._planners.pop(key, None)
        if found is None:
            self.listener.on_work(f"compiling the terrain for {request.robot}", None)
            found = Planner(self.terrain, request.robot, request.heuristic, request.margin)
            self._untried = True
        self._planners[key] = found
        while len(self._planners) > _PLANNERS:
            self._planners.pop(next(iter(self._planners)))
        return found

    def _run(self) -> None:
        compile_on_use()
        answered = 0
        while True:
            with self._changed:
                while self._number == answered and not self._closed:
                    self._idle.set()
                    self._changed.wait()
                if self._closed:
                    return
                assert self._wanted is not None
                answered, request, asked = self._number, self._wanted, self._asked_at
            try:
                self._answer(request, asked, partial(self._is_old, answered))
            except Superseded:
                continue
            except (InputError, RefinementError) as error:
                self.listener.on_error(request, str(error))
            except Exception as error:  # a defect ends no session
                _LOG.exception("the planning session failed")
                self.listener.on_error(request, f"{type(error).__name__}: {error}")
            self.listener.on_work("", None)

    def _is_old(self, number: int) -> bool:
        """Whether there is a newer request than the one with this number."""
        return self._number != number

    def _answer(self, request: PlanningRequest, asked: float, superseded: Callable[[], bool]) -> None:
        with compilations.told(_KERNELS):
            planner = self.planner(request)
            if request.start is None or request.goal is None:
                request = self._with_ends(planner, request)
            self._try(planner, request, superseded)
        self.listener.on_work("planning", None)
        answer = self._planned(planner, request, asked, superseded, polish=0.0)
        self.listener.on_answer(answer)
        if not answer.plan.solved:
            threading.Thread(target=self._explain, args=(answer, superseded), daemon=True).start()
        else:
            answer = self._polished(answer, asked, superseded)
            self._refine(answer, superseded)
        self._compile_rest(planner)
        self._prepare(answer, superseded)

    def _try(self, planner: Planner, request: PlanningRequest, superseded: Callable[[], bool]) -> None:
        """Compiles the kernels of a query with a new planner, which would count as time of the query."""
        if self._untried:
            self._searched(planner, request, superseded, expansions=_TRIED, polish=0.0)

    def _compile_rest(self, planner: Planner) -> None:
        """Compiles the kernels that other queries with a new planner may need, in another thread."""
        if not self._untried:
            return
        self._untried = False
        arguments = planner.robot, planner.heuristic
        threading.Thread(target=compile_for, args=arguments, name="compilation", daemon=True).start()

    def _with_ends(self, planner: Planner, request: PlanningRequest) -> PlanningRequest:
        """Chooses the poses that a request leaves open; later requests keep them."""
        self.listener.on_work("looking for places to stand", None)
        start, goal = first_poses(planner, request.start, request.goal)
        chosen = replace(request, start=start, goal=goal)
        with self._changed:
            if self._wanted is request:
                self._wanted = chosen
        return chosen

    def _planned(
        self, planner: Planner, request: PlanningRequest, asked: float, superseded: Callable[[], bool], polish: float
    ) -> PlanningAnswer:
        plan = self._searched(planner, request, superseded, time=request.time, polish=polish)
        return PlanningAnswer(request, planner, plan, now() - asked)

    def _searched(
        self, planner: Planner, request: PlanningRequest, superseded: Callable[[], bool], **options: Any
    ) -> Plan:
        def progress(expansions: int, seconds: float) -> None:
            if superseded():
                raise Superseded
            self.listener.on_work(f"planning, {expansions:,} states expanded", None)

        with self.working:
            plan = planner.plan(
                request.start, request.goal, request.weight, progress=progress, tolerance=request.tolerance or None,
                **options,
            )  # fmt: skip
        if superseded():
            raise Superseded
        return plan

    def _polished(self, answer: PlanningAnswer, asked: float, superseded: Callable[[], bool]) -> PlanningAnswer:
        """The same query with the planner's polish; the first plan came without, because a polish takes time."""
        request = answer.request
        if answer.planner.heuristic.admissible or request.weight == 1 or answer.plan.stats.seconds > 1.0:
            return answer
        self.listener.on_work("polishing the plan", None)
        better = self._planned(answer.planner, request, asked, superseded, polish=_POLISH)
        if not better.plan.cost < answer.plan.cost - 1e-9:
            return answer
        better = replace(better, seconds=answer.seconds)
        self.listener.on_answer(better)
        return better

    def _refine(self, answer: PlanningAnswer, superseded: Callable[[], bool]) -> None:
        self.listener.on_work("refining the plan to a motion", None)
        try:
            while not answer.plan.refine_until(now() + _SLICE):
                if superseded():
                    raise Superseded
        except RefinementError as error:
            self.listener.on_motion(answer, None, str(error))
        else:
            self.listener.on_motion(answer, answer.plan.refine(), "")

    def _prepare(self, answer: PlanningAnswer, superseded: Callable[[], bool]) -> None:
        """Prepares the heuristic for the whole map, so that later answers come sooner."""
        heuristic, ends = answer.planner.heuristic, answer.plan.ends
        if not isinstance(heuristic, AbstractHeuristic) or len(ends) < 2 or len(ends[1]) < 7:
            return
        goal = answer.planner.grid.to_lattice(ends[1][:3], ends[1][3:])
        steps: Gradual = Gradual(heuristic.steps_to(np.asarray(goal)[None]))
        while True:
            with self.working:
                if steps.run(now() + _SLICE):
                    return
            if superseded():
                raise Superseded
            self.listener.on_work("preparing the heuristic for the whole map", heuristic.known.share)

    def _explain(self, answer: PlanningAnswer, superseded: Callable[[], bool]) -> None:
        _ = answer.plan.causes  # computed at the first use
        if superseded():
            return
        self.listener.on_causes(answer)
        words = answer.plan.explain()
        if not superseded():
            self.listener.on_explanation(answer, words)


_POLISH = 0.2  # s, as in `Planner.plan`

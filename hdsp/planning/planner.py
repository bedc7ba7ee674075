"""What users call: a planner for one terrain and robot."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from copy import copy
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from hdsp.abstract.abstract_costs import AbstractCosts, Region
from hdsp.abstract.transform import feet_at
from hdsp.base.errors import InputError, RefinementError
from hdsp.detailed.motion.refinement import ban, last_step
from hdsp.detailed.relaxed.proofs import Unreachable, why_unreachable
from hdsp.detailed.relaxed.validity import in_words, problems
from hdsp.detailed.search import anytime
from hdsp.detailed.search.bounds import LEAST_GAIN, rounding, suboptimality
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.multi_heuristic import solve_multi
from hdsp.detailed.search.outcome import Limits, SearchResult, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.states import action_name
from hdsp.detailed.world.world import World, build_world
from hdsp.detailed.world.world_update import updated_world
from hdsp.learning.loading import abstraction_of, load_abstraction
from hdsp.planning.heuristics import AbstractHeuristic, GeometricHeuristic, Heuristic, changed_cells
from hdsp.planning.plans import Plan
from hdsp.robot.lattice import RESOLUTION, Grid, heading_index, is_detailed
from hdsp.robot.robot import Box, Robot
from hdsp.terrain.height_map import HeightMap


class Planner:
    """Plans hybrid driving-stepping locomotion on one terrain.

    Args:
        terrain: height map at the detailed resolution.
        robot: a ``Robot``, the name of a preset, or the path of a YAML file.
        heuristic: ``"geometric"``, ``"manual"``, ``"learned"`` (the trained abstraction of this robot that comes with
            the package), ``"learned:FOLDER"`` (one of your own), any ``AbstractCosts`` (learned, manual, ...), or a
            ``Heuristic`` made for the same terrain and robot.
        margin: m by which the base keeps clear of what it could hit, see ``with_margin``.

    Raises:
        InputError: for another resolution, an unknown robot or heuristic, an abstraction of another robot, or a margin
            below 0.
    """

    def __init__(
        self,
        terrain: HeightMap,
        robot: str | Path | dict | Robot = "momaro",
        heuristic: str | AbstractCosts | Heuristic = "geometric",
        margin: float = 0.0,
    ):
        self.robot = Robot.load(robot)
        self._wider = with_margin(self.robot, margin)
        self.terrain = self._check(terrain)
        self.grid = Grid(terrain.origin, terrain.shape)
        self.world = build_world(terrain, self._wider)
        self.heuristic = self._make_heuristic(heuristic)

    def _check(self, terrain: HeightMap) -> HeightMap:
        if not is_detailed(terrain.resolution):
            raise InputError(f"terrain has cells of {terrain.resolution:g} m; the planner needs {RESOLUTION:g} m")
        return terrain

    def update(self, terrain: HeightMap, region: Region | None = None) -> Planner:
        """Take over a changed terrain; returns the planner. Plans are then those of a new planner.

        Computed again is only what the changed cells touch: costs of the terrain, edges of the abstraction, and
        costs-to-go of the last goal. Where the map has another shape or origin than before, all is.

        Args:
            terrain: the whole height map as it is now.
            region: rectangle of cells (first ix, first iy, end ix, end iy) outside of which nothing has changed; None =
                anything may have. It saves a comparison, no more.

        Raises:
            InputError: for another resolution, or a region that does not lie within the map.
        """
        changed = changed_cells(self.terrain, self._check(terrain), region)
        if changed is None:
            self.grid, self.world = Grid(terrain.origin, terrain.shape), build_world(terrain, self._wider)
        else:
            self.world = updated_world(self.world, terrain, self._wider, changed)
        self.terrain = terrain
        self.heuristic.update(self.world, terrain, region)
        return self

    def _make_heuristic(self, heuristic) -> Heuristic:
        if isinstance(heuristic, Heuristic):
            return heuristic
        if isinstance(heuristic, AbstractCosts):
            return AbstractHeuristic(self.world, self.terrain, heuristic, type(heuristic).__name__)
        if heuristic == "geometric":
            return GeometricHeuristic(self.world)
        if heuristic == "manual":
            from hdsp.abstract.manual import ManualCosts

            return AbstractHeuristic(self.world, self.terrain, ManualCosts(self.robot), "manual")
        if isinstance(heuristic, str) and (heuristic == "learned" or heuristic.startswith("learned:")):
            folder = heuristic.removeprefix("learned").removeprefix(":")
            abstraction = load_abstraction(folder, self.robot) if folder else abstraction_of(self.robot)
            from hdsp.learning.learned_costs import LearnedCosts

            return AbstractHeuristic(self.world, self.terrain, LearnedCosts(abstraction), "learned")
        raise InputError(
            f"heuristic {heuristic!r}: need 'geometric', 'manual', 'learned', 'learned:FOLDER', an AbstractCosts or a "
            "Heuristic"
        )

    def prepare(self) -> Planner:
        """Compute what the heuristic needs of the whole map now instead of at the first query; returns the planner."""
        if isinstance(self.heuristic, AbstractHeuristic):
            self.heuristic.prepare()
        return self

    def forget(self) -> None:
        """Drop what earlier questions left behind: poses that were looked at, costs-to-go of the last goal. What holds
        for the whole map stays. For measurements: the next question takes as long as a first one."""
        self.world.base[:] = 0
        self.heuristic.forget()

    def valid(self, pose) -> bool:
        """Whether the robot can stand at a world pose (x, y, theta) with some feet, or in a state of 7 values.

        Raises:
            InputError: if a value is not finite.
        """
        return not self._locate(pose, "pose")[1]

    def plan(
        self,
        start,
        goal,
        weight: float = 1.0,
        *,
        anchor_weight: float | None = None,
        cost: float = np.inf,
        expansions: int = Limits.expansions,
        memory: int = Limits.memory,
        time: float = Limits.time,
        refinable: bool = False,
        progress=None,
    ) -> Plan:
        """Plan from start to goal.

        Args:
            start: world pose (x, y, theta) in m and rad, or 7 values with the four foot offsets in m. Values are taken
                to the nearest lattice state. Without feet, the least-cost feet closest to neutral are chosen (T_a->d).
            goal: the same.
            weight: W >= 1 of weighted A*. With an admissible heuristic the cost is at most W times optimal.
            anchor_weight: W2 >= 1 of multi-heuristic A*: the heuristic, learned or otherwise not admissible, guides,
                the geometric one is the anchor, and the cost is at most W * W2 times optimal, which ``bound`` says;
                often it proves less. An admissible heuristic needs no anchor. None: weighted A*, which proves nothing
                with a heuristic that is not admissible.
            cost: look for no plan that costs more.
            expansions, memory, time: give up after so many expanded states, bytes of states, seconds.
            refinable: refine the plan, and as long as one of its steps cannot be carried out, report that step in
                ``refused`` and search again without it.
            progress: called now and then with (expansions, seconds).

        Returns:
            A plan; ``status`` says how it ended, ``explain()`` in words. A start or goal at which the robot cannot
            stand is reported there.

        Raises:
            InputError: if a value is not a number, a pose lies off the map, or a weight < 1.
            RefinementError: if ``refinable`` and something other than a step cannot be carried out.
        """
        _check_weight(weight)
        if anchor_weight is not None:
            _check_weight(anchor_weight, "anchor_weight")
        began = _now()
        ends, without = self._locate_ends(start, goal, weight)
        if without is not None:
            return without
        kernel_view = self.heuristic.set_goal(ends["goal"])
        prepared = _now() - began
        limits = Limits(cost=cost, expansions=expansions, memory=memory, time=time)
        if anchor_weight is None or self.heuristic.admissible:
            search = partial(self._search, ends, kernel_view, weight, progress)
        else:
            search = partial(self._search_anchored, ends, kernel_view, weight, anchor_weight, progress)
        plan = self._search_or_proof(ends, search, limits)
        if refinable:
            plan = self._refined(plan, search, limits)
        plan.stats |= {"heuristic_seconds": prepared, "seconds": _now() - began}
        return plan

    def improve(
        self,
        start,
        goal,
        weights: Sequence[float] = (3.0, 2.0, 1.5, 1.25, 1.0),
        *,
        cost: float = np.inf,
        expansions: int = Limits.expansions,
        memory: int = Limits.memory,
        time: float = Limits.time,
        refinable: bool = False,
        progress=None,
    ) -> Iterator[Plan]:
        """Plan from start to goal: a plan soon, then better ones, each with a proven ``bound`` (ARA*).

        The search goes through rounds of weighted A* with falling weights that share what was found. It ends with a
        plan that is proved to cost at most the last weight times the least possible, or at a limit. With a heuristic
        that is not admissible, a round with the geometric one follows, which may take long.

        Args:
            start, goal: as in ``plan``.
            weights: of the rounds, falling, each >= 1.
            cost, expansions, memory, time: as in ``plan``, for all rounds together. Time counts from when the first
                plan is asked for, also while the caller does something else.
            refinable: yield only plans that can be carried out; as in ``plan``.
            progress: as in ``plan``; its numbers begin anew when a step is refused.

        Yields:
            Plans, each of which costs less than the one before it or proves a smaller ``bound``. Once the search is
            over, ``stats["ended"]`` of the last one says what ended it: ``solved``, or the limit in the words of
            ``Status``. Without any plan, one ``Plan`` is yielded whose ``status`` says how the search ended.

        Raises:
            InputError: at once, if a value is not a number, a pose lies off the map, or the weights are not >= 1 and
                falling.
            RefinementError: as in ``plan``.
        """
        weights = tuple(weights)
        for weight in weights:
            _check_weight(weight)
        if not weights or any(after >= before for before, after in pairwise(weights)):
            raise InputError(f"weights are {weights}; each must be smaller than the one before it")
        began = _now()
        ends, without = self._locate_ends(start, goal, weights[0])
        if without is not None:
            without.stats["ended"] = str(without.status)
            return (plan for plan in [without])
        kernel_view = self.heuristic.set_goal(ends["goal"])
        prepared = _now() - began
        limits = Limits(cost=cost, expansions=expansions, memory=memory, time=time)
        return self._improving(ends, kernel_view, weights, limits, refinable, progress, prepared)

    def _search_or_proof(self, ends, search: Callable[[World, Limits], Plan], limits: Limits) -> Plan:
        """Search a little; if that finds no plan, try to prove that there is none, which also says why; else search on.

        A proof takes longer than most searches, and searches without a plan would take forever.
        """
        few = replace(limits, expansions=min(limits.expansions, _FEW))
        plan = search(self.world, few)
        undecided = plan.status == Status.EXPANSION_LIMIT and limits.expansions > _FEW
        if not undecided and plan.status != Status.INFEASIBLE:
            return plan
        proof = why_unreachable(self.world, ends["start"], ends["goal"])
        if proof is None:
            return plan if not undecided else search(self.world, limits)
        self._note_proof(plan, proof)
        return plan

    def _note_proof(self, plan: Plan, proof: Unreachable) -> None:
        plan.status, plan.problems = Status.INFEASIBLE, [in_words(proof, self.world, self.grid)]
        plan.stats["lower_bound"] = np.inf

    def _search(self, ends, kernel_view, weight: float, progress, world: World, limits: Limits) -> Plan:
        start, goal = ends["start"], ends["goal"]
        once = weight > 1 and limits.cost == np.inf and self._may_expand_once()
        result = solve(
            world, start, goal, kernel_view, weight=weight, admissible=self.heuristic.admissible, reopen=not once,
            limits=limits, progress=progress,
        )  # fmt: skip
        plan = self._plan_of(result, weight)
        plan.bound = result.bound
        plan.stats["lower_bound"] = result.lower_bound
        return plan

    def _may_expand_once(self) -> bool:
        """Whether no bound is lost if no state is expanded twice: the heuristic is consistent, or proves none."""
        return self.heuristic.consistent or not self.heuristic.admissible

    def _search_anchored(self, ends, guide, weight, anchor_weight, progress, world: World, limits: Limits) -> Plan:
        result = solve_multi(
            world,
            ends["start"],
            ends["goal"],
            geometric_estimate(world, ends["goal"]),
            [guide],
            weight=weight,
            anchor_weight=anchor_weight,
            limits=limits,
            progress=progress,
        )
        plan = self._plan_of(result, weight)
        plan.bound = result.bound
        anchored, guided = result.expansions_by or (0, 0)
        plan.stats |= {
            "lower_bound": result.lower_bound,
            "anchor_weight": float(anchor_weight),
            "expansions_by": {"geometric": anchored, self.heuristic.name: guided},
        }
        return plan

    def _plan_of(self, result: SearchResult, weight: float) -> Plan:
        """What a search for one goal found; nothing is said of the bound."""
        stats = {
            "heuristic": self.heuristic.name,
            "weight": float(weight),
            "expansions": result.expansions,
            "seen": result.seen,
            "memory": result.memory,
            "search_seconds": result.seconds,
            "lower_bound": 0.0,
        }
        states, codes, costs = result.paths[0] or (np.empty((0, 7)), [], np.empty(0))
        return Plan(
            status=result.status[0],
            cost=float(result.cost[0]),
            states=self.grid.to_world(states) if len(states) else states,
            actions=[action_name(int(code)) for code in codes],
            action_costs=costs,
            stats=stats,
            terrain=self.terrain,
            robot=self.robot,
        )

    def _refined(self, plan: Plan, search: Callable[[World, Limits], Plan], limits: Limits) -> Plan:
        """Search again, without the steps that cannot be carried out, until all can; or until there is no other plan.

        Raises:
            RefinementError: if an action before the first step cannot be carried out.
        """
        refused: list[str] = []
        banned = self.world.banned
        spent = {name: plan.stats[name] for name in ("expansions", "search_seconds")}
        while plan.solved:
            now_banned = self._ban_what_cannot_be_done(plan, banned, refused)
            if now_banned is None:
                break
            banned = now_banned
            left = Limits(
                cost=limits.cost,
                expansions=limits.expansions - spent["expansions"],
                memory=limits.memory,
                time=limits.time - spent["search_seconds"],
            )
            plan = search(self.world._replace(banned=banned), left)
            for name in spent:
                spent[name] += plan.stats[name]
        plan.refused = refused
        plan.stats |= spent
        return plan

    def _ban_what_cannot_be_done(self, plan: Plan, banned, refused: list[str]):
        """Refine a plan; if one of its steps cannot be carried out, add it to those refused and return what is banned.

        Raises:
            RefinementError: if an action before the first step cannot be carried out.
        """
        try:
            plan.refine()
        except RefinementError as error:
            to_blame = last_step(plan.actions, error.action)
            if to_blame is None:
                raise
            refused.append(str(error))
            return ban(banned, self.world, self.grid, plan.states[to_blame], plan.actions[to_blame])
        return None

    def _improving(self, ends, kernel_view, weights, limits: Limits, refinable: bool, progress, prepared: float):
        """The plans of ``improve`` that are news."""
        best, last, shown, lower, refused = None, None, np.inf, 0.0, []
        error = rounding(self.world)
        rounds = self._rounds(ends, kernel_view, weights, limits, refinable, progress, refused)
        with closing(rounds):
            for plan, least, ended in rounds:
                lower = max(lower, least)
                better = plan.solved and (best is None or plan.cost < best.cost * (1 - LEAST_GAIN))
                best = plan if better else best
                if best is None and ended is None:
                    continue
                if best is not None and ended in (Status.INFEASIBLE, Status.COST_LIMIT):
                    ended = Status.SOLVED  # there is no other plan without the refused steps
                bound = np.inf if best is None else suboptimality(best.cost, lower, error)
                how = None if ended is None else str(ended)
                if last is not None and not better and bound >= shown:
                    last.stats["ended"] = how
                    continue
                last, shown = copy(best or plan), bound
                last.bound, last.refused = bound, list(refused)
                seconds = plan.stats["search_seconds"] + prepared
                last.stats = plan.stats | {
                    "lower_bound": lower, "ended": how, "heuristic_seconds": prepared, "seconds": seconds
                }  # fmt: skip
                yield last

    def _rounds(self, ends, kernel_view, weights, limits: Limits, refinable: bool, progress, refused: list[str]):
        """Plans, cost below which there is none, and what ended the search, of all rounds; where a step is refused,
        they begin anew without it."""
        began, spent, cost, world, proofs = _now(), 0, np.inf, self.world, []

        def hopeless() -> bool:
            proofs.append(why_unreachable(self.world, ends["start"], ends["goal"]))
            return proofs[-1] is not None

        guided = not self.heuristic.admissible
        admissible = geometric_estimate(self.world, ends["goal"]) if guided else kernel_view
        while True:
            left = replace(limits, expansions=limits.expansions - spent, time=limits.time - (_now() - began))
            rounds = anytime.improve(
                world, ends["start"], ends["goal"], weights, admissible, kernel_view if guided else None,
                limits=left, hopeless=None if proofs else hopeless, ask_after=_FEW, progress=progress,
            )  # fmt: skip
            for found in rounds:
                plan = self._plan_of(found.result, found.weight)
                plan.stats |= {"expansions": plan.stats["expansions"] + spent, "search_seconds": _now() - began}
                if refinable and plan.solved and plan.cost < cost * (1 - LEAST_GAIN):
                    banned = self._ban_what_cannot_be_done(plan, world.banned, refused)
                    if banned is not None:
                        world, spent = world._replace(banned=banned), plan.stats["expansions"]
                        weights = weights[weights.index(found.weight) :]
                        break
                    cost = plan.cost
                if found.ended == Status.INFEASIBLE and not plan.solved and not refused:
                    proof = proofs[-1] if proofs else why_unreachable(self.world, ends["start"], ends["goal"])
                    if proof is not None:
                        self._note_proof(plan, proof)
                yield plan, found.result.lower_bound, found.ended
            else:
                return

    def _locate_ends(self, start, goal, weight: float) -> tuple[dict[str, np.ndarray], Plan | None]:
        """The detailed states of both ends; and a plan that says so if the robot cannot stand at one of them."""
        began, ends = _now(), {}
        for status, pose, name in ((Status.INVALID_START, start, "start"), (Status.INVALID_GOAL, goal, "goal")):
            ends[name], wrong = self._locate(pose, name)
            if wrong:
                return ends, self._without_path(status, wrong, weight, _now() - began)
        return ends, None

    def _without_path(self, status: Status, wrong: list[str], weight: float, seconds: float) -> Plan:
        stats = {
            "heuristic": self.heuristic.name, "weight": float(weight), "expansions": 0, "seen": 0, "memory": 0,
            "heuristic_seconds": 0.0, "search_seconds": 0.0, "seconds": seconds, "lower_bound": 0.0,
        }  # fmt: skip
        empty = np.empty((0, 7))
        return Plan(status, np.inf, empty, [], np.empty(0), stats, wrong, terrain=self.terrain, robot=self.robot)

    def _locate(self, pose, name: str) -> tuple[np.ndarray, list[str]]:
        """The detailed state of a pose, int64 [7], and what is wrong with it."""
        try:
            values = np.asarray(pose, dtype=float)
        except (TypeError, ValueError):
            values = np.empty(0)
        if values.shape not in ((3,), (7,)) or not np.isfinite(values).all():
            raise InputError(f"{name} {pose!r}: need (x, y, theta) or these and 4 foot offsets, all finite numbers")
        state = self.grid.to_lattice(values[:3], values[3:] if len(values) == 7 else (0.0,) * 4)
        if len(values) == 3:
            chosen = feet_at(self.world, (int(state[0]), int(state[1]), int(heading_index(values[2]))))
            if chosen is not None:
                return chosen, []
        return state, problems(self.world, self.grid, self._wider, state)


def with_margin(robot: Robot, margin: float) -> Robot:
    """The robot with its base wider by a margin (m) to all sides.

    The body is tested at the centres of cells. What stands in a cell is up to half its diagonal, 18 mm, from there:
    with that margin a turned base touches no cell that the map shows as too high. Noise of the map comes on top. Feet
    keep their own clearance, and the room between the legs stays as it is: on stairs the next edge fills it nearly.

    Raises:
        InputError: if the margin is not a number >= 0.
    """
    if not (np.isfinite(margin) and margin >= 0):
        raise InputError(f"margin is {margin}; it must be a finite number >= 0, in m")
    base = max((box.above for box in robot.body.boxes), default=0.0)
    boxes = tuple(_widened(box, margin) if box.above == base else box for box in robot.body.boxes)
    return replace(robot, body=replace(robot.body, boxes=boxes))


def _widened(box: Box, margin: float) -> Box:
    return replace(box, x_min=box.x_min - margin, x_max=box.x_max + margin, half_width=box.half_width + margin)


def _check_weight(weight, name: str = "weight") -> None:
    if not (np.isfinite(weight) and weight >= 1):
        raise InputError(f"{name} is {weight}; it must be a finite number >= 1")


_now = time.perf_counter
_FEW = 50_000  # expansions; about a tenth of a second

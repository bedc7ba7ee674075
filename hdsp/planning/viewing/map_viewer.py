"""The viewer: a map in the browser, start and goal to drag, and the plan between them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.detailed.motion.motion import Motion
from hdsp.planning.compiled import compile_on_use
from hdsp.planning.planner import Planner
from hdsp.planning.viewing.control_panel import EDGES, FOOT_COSTS, SEARCHED, TO_GO, UNKNOWN, ControlPanel
from hdsp.planning.viewing.map_layers import LayerSources, abstract_edges, costs_to_go, foot_costs, searched_cells
from hdsp.planning.viewing.planning_session import PlanningAnswer, PlanningRequest, PlanningSession
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.palette import GOAL, PURPLE, START
from hdsp.viz.viewer.local_server import PORT, address, close_server, open_server
from hdsp.viz.viewer.plan_scene import PlanScene
from hdsp.viz.viewer.playback import Playback
from hdsp.viz.viewer.pose_handle import PoseHandle
from hdsp.viz.viewer.static_page import plan_page
from hdsp.viz.viewer.textures import mark_colors
from hdsp.viz.viewer.timeline import Timeline, timeline_of_motion, timeline_of_states

_LOG = logging.getLogger("hdsp")
_ASIDE = 0.22  # share of the map's size; the panel covers the right side of the picture
_LOOK = 0.2  # s, between two looks whether the session is idle, before layers are drawn


class MapViewer:
    """Shows a map in browsers on this machine, and plans on it.

    All browsers share one state. The viewer goes on when the last browser closes; `close` ends it.

    Args:
        terrain: the map.
        request: the first request.
        port: first port to try.
        play: whether the robot moves as soon as there is a plan.

    Attributes:
        answered: set with an answer, or with an error.
        explained: set while the answer is explained; an absent plan needs time for its reasons.
        answer: the last answer; None before the first one.
        motion: the refined motion of its plan; None without one.
        error: the last error in a request, in words; "" before the first one.
        work: the present work in words.

    Raises:
        InputError: viser is not installed, no port is free, or the robot or the heuristic does not exist.
    """

    def __init__(self, terrain: HeightMap, request: PlanningRequest, port: int = PORT, play: bool = False):
        self.answered, self.explained = threading.Event(), threading.Event()
        self.work = ""
        self._play_first = play
        self.answer: PlanningAnswer | None = None
        self.motion: Motion | None = None
        self.words = self.error = ""
        robot = Robot.load(request.robot)
        self.server = open_server(port)
        try:
            self._fill_server(terrain, request, robot)
        except BaseException:
            close_server(self.server)
            raise
        self.playback = Playback(self._show_moment, self._at_end)
        self._closed = threading.Event()
        self._layers = threading.Event()
        self.session = PlanningSession(terrain, self)
        self.session.ask(request)
        self._layer_thread = threading.Thread(target=self._draw_layers, name="layers", daemon=True)
        self._layer_thread.start()

    def _fill_server(self, terrain: HeightMap, request: PlanningRequest, robot: Robot) -> None:
        """Creates the scene, the controls and the handles."""
        self.scene = PlanScene(self.server, terrain, robot, _ASIDE)
        self.panel = ControlPanel(self.server.gui, request, self, bool(np.isnan(terrain.heights).any()))
        self.start = PoseHandle(self.server.scene, "/start", "start", START, lambda pose: self.change(start=pose))
        self.goal = PoseHandle(self.server.scene, "/goal", "goal", GOAL, lambda pose: self.change(goal=pose))
        self._visible = {UNKNOWN}
        self._drawn = LayerSources((FOOT_COSTS, EDGES))
        self._place_ends(request, robot)

    @property
    def address(self) -> str:
        """Address for a browser."""
        return address(self.server)

    def close(self) -> None:
        """Ends planning, playback and server."""
        self._closed.set()
        self._layers.set()
        self.session.close()
        self.playback.close()
        close_server(self.server)

    def save_page(self, path: str | Path) -> Path:
        """Writes the last answer as an HTML page, see `Plan.view`."""
        assert self.answer is not None
        return self.answer.plan.view(path)

    # Actions of the panel.

    def change(self, **changes: Any) -> None:
        self.session.change(**changes)

    def play(self) -> None:
        self.playback.play(not self.playback.playing)
        self.panel.show_playing(self.playback.playing)

    def jump(self, time: float) -> None:
        self.playback.jump(time)

    def set_speed(self, speed: float) -> None:
        self.playback.speed = speed

    def show_layer(self, name: str, visible: bool) -> None:
        if visible:
            self._visible.add(name)
        else:
            self._visible.discard(name)
        if name == UNKNOWN and self.scene.unknown is not None:
            self.scene.unknown.visible = visible
            return
        if not visible:
            self._hide(name)
        self._layers.set()

    def _hide(self, name: str) -> None:
        self.scene.remove_layer(name)
        self._drawn.forget(name)

    def send_page(self, client: Any) -> None:
        if self.answer is None or client is None:
            return
        self.panel.show_work("writing the page", None)
        client.send_file_download("plan.html", self._page().encode(), save_immediately=True)
        self.panel.show_work("", None)

    def _page(self) -> str:
        assert self.answer is not None
        plan = self.answer.plan
        failure = None if plan.solved else plan.failure()
        return plan_page(plan.terrain, plan.robot, plan.states, plan.actions, self.motion, plan.ends, failure)

    # Answers of the session.

    def on_answer(self, answer: PlanningAnswer) -> None:
        plan, again = answer.plan, self.answer is not None and self.answer.request is answer.request
        self.answer, self.motion, self.words = answer, None, plan.explain() if plan.solved else ""
        self.explained.clear()
        if plan.solved:
            self.explained.set()
        with self.server.atomic():
            self._use(answer.planner)
            self.scene.draw_failure(None)
            self.scene.draw_path(plan.states, plan.actions)
        self.panel.show_answer(answer, self.words)
        self._snap_ends(answer)
        if plan.solved:
            self._load(timeline_of_states(self.scene.surface, plan.robot, plan.states), keep=again)
        else:
            self.playback.load(None)
            self.panel.show_duration(None)
            self.panel.show_playing(False)
            self.scene.remove_robot()
        self._layers.set()
        self.answered.set()
        if plan.solved and self._play_first:
            self._play_first = False
            self.play()

    def on_motion(self, answer: PlanningAnswer, motion: Motion | None, refusal: str) -> None:
        if answer is not self.answer:
            return
        if motion is None:
            self.words += f"; it cannot be carried out: {refusal}"
            self.panel.show_answer(answer, self.words)
            return
        self.motion = motion
        self.scene.draw_path(answer.plan.states, answer.plan.actions, motion)
        self._load(timeline_of_motion(motion), keep=True)

    def on_causes(self, answer: PlanningAnswer) -> None:
        if answer is not self.answer:
            return
        with self.server.atomic():
            self.scene.draw_failure(answer.plan.failure())
        self.panel.show_answer(answer, "; ".join(map(str, answer.plan.causes)))

    def on_explanation(self, answer: PlanningAnswer, words: str) -> None:
        if answer is not self.answer:
            return
        self.words = words
        self.panel.show_answer(answer, words)
        self.explained.set()

    def on_error(self, request: PlanningRequest, words: str) -> None:
        self.error = words
        self.panel.show_error(words)
        self.answered.set()

    def on_work(self, words: str, share: float | None) -> None:
        self.work = words
        self.panel.show_work(words, share)

    def _use(self, planner: Planner) -> None:
        """Draws for another planner, whose robot or conditioned terrain may differ."""
        if planner.robot != self.scene.robot:
            self.scene.remove_robot()
            self.scene.robot = planner.robot
        if planner.terrain is not self.scene.terrain:
            self.scene.draw_terrain(planner.terrain)
            self._drawn.forget()

    def _place_ends(self, request: PlanningRequest, robot: Robot) -> None:
        for handle, pose in ((self.start, request.start), (self.goal, request.goal)):
            if pose is not None:
                handle.place(self.scene.surface, robot, np.array([0.0 if v is None else v for v in pose], float))

    def _snap_ends(self, answer: PlanningAnswer) -> None:
        """Moves the handles to the lattice; a free heading is that of the plan."""
        grid, request, ends = answer.planner.grid, answer.request, []
        for pose, state in zip((request.start, request.goal), (0, -1), strict=True):
            assert pose is not None
            x, y, heading = pose[:3]
            if heading is None:
                heading = float(answer.plan.states[state, 2]) if answer.plan.solved else 0.0
            feet = pose[3:] or (0.0, 0.0, 0.0, 0.0)
            ends.append(tuple(grid.to_world(grid.to_lattice((x, y, heading), feet)).tolist()))
        self._place_ends(replace(request, start=ends[0], goal=ends[1]), answer.plan.robot)

    def _load(self, line: Timeline, keep: bool) -> None:
        """Takes a timeline for playback; a robot on its way stays at its share of the time."""
        before = self.playback.line
        share = self.playback.time / before.duration if keep and before is not None and before.duration > 0 else 0.0
        self.panel.show_duration(line.duration)
        self.playback.load(line, share * line.duration)

    def _show_moment(self, line: Timeline, time: float) -> None:
        self.scene.place_robot(*line.at(time))
        self.panel.show_time(time)

    def _at_end(self) -> None:
        self.panel.show_playing(False)

    # Layers, drawn in a thread of their own after the session has become idle.

    def _draw_layers(self) -> None:
        draw: dict[str, Callable[[PlanningAnswer], None]] = {
            FOOT_COSTS: lambda answer: self.scene.draw_layer(FOOT_COSTS, foot_costs(answer.planner)),
            TO_GO: lambda answer: self.scene.draw_layer(TO_GO, costs_to_go(answer.planner)),
            EDGES: self._draw_edges,
            SEARCHED: self._draw_searched,
        }
        compile_on_use()
        while True:
            self._layers.wait()
            while not self._closed.is_set() and not self.session.wait(_LOOK):
                pass
            if self._closed.is_set():
                return
            self._layers.clear()
            answer = self.answer
            if answer is None:
                continue
            for name in [name for name in draw if name in self._visible]:
                if self._drawn.has(name, answer):
                    continue
                try:
                    with self.session.working:
                        draw[name](answer)
                    self._drawn.set(name, answer)
                except Exception:  # a layer that fails leaves the viewer as it is
                    _LOG.exception("layer %s", name)
                if name not in self._visible:  # hidden meanwhile
                    self._hide(name)

    def _draw_edges(self, answer: PlanningAnswer) -> None:
        lines = abstract_edges(answer.planner, self.scene.surface)
        if lines is None:
            self.scene.remove_layer(EDGES)
        else:
            self.scene.draw_lines(EDGES, lines.ends, lines.colors)

    def _draw_searched(self, answer: PlanningAnswer) -> None:
        cells = searched_cells(answer)
        if cells is None:
            self.scene.remove_layer(SEARCHED)
        else:
            self.scene.draw_layer(SEARCHED, mark_colors(cells, PURPLE))

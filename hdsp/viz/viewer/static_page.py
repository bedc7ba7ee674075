"""A plan as one HTML file: terrain, path and a robot that moves along it, in three dimensions, without a server."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hdsp.base.files import replacing, writable_file
from hdsp.detailed.actions.action import Action
from hdsp.detailed.motion.motion import Motion
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.failure_marks import Failure
from hdsp.viz.palette import GOAL, START
from hdsp.viz.viewer.local_server import close_server, open_server
from hdsp.viz.viewer.plan_scene import PlanScene
from hdsp.viz.viewer.timeline import Timeline, timeline_of_motion, timeline_of_states

#: Pictures per second of the recorded motion.
_RATE = 12.0
#: Longest recording, s; a longer motion is shown faster.
_LONGEST = 40.0


def plan_page(
    terrain: HeightMap,
    robot: Robot,
    states: np.ndarray,
    actions: Sequence[Action],
    motion: Motion | None = None,
    ends: Sequence[np.ndarray] = (),
    failure: Failure | None = None,
) -> str:
    """Returns the text of an HTML page; see `save_page` for the arguments."""
    server = open_server(0)
    try:
        scene = PlanScene(server, terrain, robot)
        scene.draw_path(states, actions, motion)
        scene.draw_failure(failure)
        for name, pose, color in zip(("start", "goal"), ends, (START, GOAL), strict=False):
            values = np.asarray(pose, float)
            scene.add_ghost(f"/{name}", np.concatenate([values, np.zeros(7 - len(values))]), color, 0.35)
        if not len(states):
            return server.get_scene_serializer().as_html()
        line = timeline_of_states(scene.surface, robot, states) if motion is None else timeline_of_motion(motion)
        return _recorded(server, scene, line)
    finally:
        close_server(server)


def save_page(
    path: str | os.PathLike,
    terrain: HeightMap,
    robot: Robot,
    states: np.ndarray,
    actions: Sequence[Action],
    motion: Motion | None = None,
    ends: Sequence[np.ndarray] = (),
    failure: Failure | None = None,
) -> Path:
    """Writes a plan as an HTML page that any browser shows in three dimensions, without a network.

    The robot moves along the plan; the page has controls for the playback. The file contains the program of the
    viewer, somewhat less than 1 MB, and compressed data.

    Args:
        path: the file, .html.
        terrain: the map of the plan.
        robot: the plan's robot.
        states: float64 [n, 7], world coordinates; [0, 7] without a path.
        actions: the n - 1 actions between the states.
        motion: the refined plan; None: the robot stands in each of the states.
        ends: start and goal, poses (x, y, theta) in m and rad or states with 7 values; both may be left out.
        failure: causes and the area in reach, if no plan was found.

    Raises:
        InputError: viser is not installed, or the path is not writable.
    """
    writable_file(path, "page", (".html",))
    page = plan_page(terrain, robot, states, actions, motion, ends, failure)
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return Path(path)


def temporary_page() -> Path:
    """Returns a path for a page that a user looks at once, in a new folder for temporary files."""
    return Path(tempfile.mkdtemp(prefix="hdsp-")) / "plan.html"


def _recorded(server, scene: PlanScene, line: Timeline) -> str:
    """The scene of a server as a page, with a recording of the robot along a timeline."""
    scene.place_robot(*line.at(0.0))
    recording = server.get_scene_serializer()
    seconds = min(line.duration, _LONGEST)
    count = max(2, int(np.ceil(seconds * _RATE)) + 1)
    for moment in np.linspace(0.0, line.duration, count):
        scene.place_robot(*line.at(float(moment)))
        recording.insert_sleep(seconds / (count - 1))
    return str(recording.as_html())

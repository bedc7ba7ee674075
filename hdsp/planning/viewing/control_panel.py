"""The control panel of the viewer: robot, heuristic, weight, playback, layers, and the answer in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from hdsp.detailed.search.outcome import Status
from hdsp.planning.answers.plans import Plan
from hdsp.planning.viewing.planning_session import PlanningAnswer, PlanningRequest
from hdsp.robot.robot import Robot

HEURISTICS = "manual", "learned", "geometric", "grid"
#: Layers by name in the panel.
FOOT_COSTS, UNKNOWN, EDGES, TO_GO, SEARCHED = (
    "foot costs", "unknown ground", "abstract edges", "cost-to-go", "states searched",
)  # fmt: skip
_MOST_TOLERANCE, _MOST_WEIGHT = 1.0, 4.0
_TITLES = {
    Status.INFEASIBLE: "No plan exists",
    Status.COST_LIMIT: "No plan within the cost limit",
    Status.INVALID_START: "The robot cannot stand at the start",
    Status.INVALID_GOAL: "The robot cannot stand at the goal",
}


class PanelActions(Protocol):
    """The actions behind the controls."""

    def change(self, **changes: Any) -> None:
        """Asks for a plan with other values; see `PlanningRequest`."""

    def play(self) -> None:
        """Starts or pauses the playback."""

    def jump(self, time: float) -> None:
        """Shows the robot at a time, s."""

    def set_speed(self, speed: float) -> None:
        """Sets the speed of the playback; 1 is real time."""

    def show_layer(self, name: str, visible: bool) -> None:
        """Shows or hides a layer."""

    def send_page(self, client: Any) -> None:
        """Sends the plan as an HTML page to a browser."""


class ControlPanel:
    """Creates and updates the controls.

    Args:
        gui: the interface of a viser server.
        request: the first request.
        actions: called when a user changes a control.
        has_unknown: whether the map has unknown cells.
    """

    def __init__(self, gui: Any, request: PlanningRequest, actions: PanelActions, has_unknown: bool):
        self._actions = actions
        self.work = gui.add_markdown("starting")
        self.answer = gui.add_markdown("Drag **start** or **goal** over the ground; a plan follows.")
        self._add_choices(gui, request)
        self._add_playback(gui)
        with gui.add_folder("Layers"):
            for name in (FOOT_COSTS, UNKNOWN, EDGES, TO_GO, SEARCHED):
                if name != UNKNOWN or has_unknown:
                    self._add_layer(gui, name)
        self.page = gui.add_button("Save as page", hint="One HTML file with the plan in three dimensions")
        self.page.on_click(lambda event: actions.send_page(event.client))

    def _add_choices(self, gui: Any, request: PlanningRequest) -> None:
        with gui.add_folder("Planner"):
            name, heuristic = str(request.robot), request.heuristic
            self.robot = gui.add_dropdown("Robot", _with(Robot.presets(), name), initial_value=name)
            self.heuristic = gui.add_dropdown("Heuristic", _with(HEURISTICS, heuristic), initial_value=heuristic)
            self.weight = gui.add_slider("Weight", 1.0, max(_MOST_WEIGHT, request.weight), 0.05, request.weight)
            most = max(_MOST_TOLERANCE, request.tolerance)
            self.tolerance = gui.add_slider("Tolerance (m)", 0.0, most, 0.05, request.tolerance)
        for name in ("robot", "heuristic", "weight", "tolerance"):
            self._changes(getattr(self, name), name)

    def _changes(self, control: Any, name: str) -> None:
        @control.on_update
        def _(event: Any) -> None:
            if event.client is not None:
                self._actions.change(**{name: control.value})

    def _add_playback(self, gui: Any) -> None:
        with gui.add_folder("Motion"):
            self.time = gui.add_slider("Time (s)", 0.0, 1.0, 0.01, 0.0, disabled=True)
            self.play = gui.add_button("Play", disabled=True)
            self.speed = gui.add_slider("Speed", 0.25, 8.0, 0.25, 1.0)

        @self.time.on_update
        def _(event: Any) -> None:
            if event.client is not None:
                self._actions.jump(float(self.time.value))

        self.play.on_click(lambda _: self._actions.play())
        self.speed.on_update(lambda _: self._actions.set_speed(float(self.speed.value)))

    def _add_layer(self, gui: Any, name: str) -> None:
        box = gui.add_checkbox(name, initial_value=name == UNKNOWN)
        box.on_update(lambda _: self._actions.show_layer(name, bool(box.value)))

    def show_playing(self, playing: bool) -> None:
        """Shows whether the robot moves."""
        self.play.label = "Pause" if playing else "Play"

    def show_duration(self, duration: float | None) -> None:
        """Sets the motion's length, s; None without a motion."""
        self.time.disabled = self.play.disabled = duration is None
        if duration is not None:
            self.time.value = 0.0
            self.time.max = max(round(duration, 2), 0.01)

    def show_time(self, time: float) -> None:
        """Moves the time slider."""
        self.time.value = round(time, 2)

    def show_work(self, words: str, share: float | None) -> None:
        """Shows the current work, and its share that is done."""
        if not words:
            self.work.content = "ready"
        else:
            self.work.content = f"*{words} …*" if share is None else f"*{words}: {share:.0%} …*"

    def show_error(self, words: str) -> None:
        """Shows an error in a request."""
        self.answer.content = f"**Error.** {words}"

    def show_answer(self, answer: PlanningAnswer, words: str) -> None:
        """Shows an answer in words and figures."""
        plan = answer.plan
        if not plan.solved:
            title = "No plan" if words else _title(plan)
            self.answer.content = f"**{title}.** {words[:1].upper()}{words[1:] or 'Looking for the reasons …'}"
            return
        rows = {
            "cost": f"{plan.cost:.3f}",
            "proved": f"at most {plan.bound:.2f} times the least cost",
            "time": f"{1000 * plan.stats.seconds:.0f} ms",
            "states expanded": f"{plan.stats.expansions:,}",
        }
        table = "\n".join(f"| {name} | {value} |" for name, value in rows.items())
        self.answer.content = f"{words}\n\n| | |\n|---|---|\n{table}"


def _title(plan: Plan) -> str:
    return _TITLES.get(plan.status, f"Not decided: {str(plan.status).replace('_', ' ')}")


def _with(options: Sequence[str], value: str) -> tuple[str, ...]:
    """Options of a dropdown with a value that may come from elsewhere."""
    return tuple(options) if value in options else (value, *options)

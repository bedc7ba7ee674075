"""Playback of a timeline: a clock that moves a robot, with pause, speed and jumps."""

from __future__ import annotations

import threading
from collections.abc import Callable

from hdsp.base.gradual import now
from hdsp.viz.viewer.timeline import Timeline

_PERIOD = 1 / 25  # s, from one picture to the next


class Playback:
    """Plays a timeline in a thread of its own.

    Args:
        show: called with (timeline, time in s) for each picture.
        stopped: called when the playback reaches the end.
    """

    def __init__(self, show: Callable[[Timeline, float], None], stopped: Callable[[], None]):
        self.time, self.speed = 0.0, 1.0
        self._show, self._stopped = show, stopped
        self._line: Timeline | None = None
        self._state = threading.Condition()
        self._playing = self._closed = False
        self._thread = threading.Thread(target=self._run, name="playback", daemon=True)
        self._thread.start()

    @property
    def playing(self) -> bool:
        """Whether the robot moves."""
        return self._playing

    @property
    def line(self) -> Timeline | None:
        """The timeline; None without one."""
        return self._line

    def load(self, line: Timeline | None, time: float = 0.0) -> None:
        """Takes another timeline, and shows it at a time; None ends the playback."""
        with self._state:
            self._line = line
            self._playing = self._playing and line is not None
        if line is not None:
            self.jump(time)

    def jump(self, time: float) -> None:
        """Shows the timeline at a time, s."""
        with self._state:
            line = self._line
            if line is None:
                return
            self.time = min(max(time, 0.0), line.duration)
            self._show(line, self.time)

    def play(self, playing: bool = True) -> None:
        """Starts or pauses; at the end, the playback starts from the beginning."""
        with self._state:
            if playing and self._line is not None and self.time >= self._line.duration:
                self.time = 0.0
            self._playing = playing and self._line is not None
            self._state.notify_all()

    def close(self) -> None:
        """Ends the thread."""
        with self._state:
            self._closed = True
            self._state.notify_all()
        self._thread.join(timeout=1.0)

    def _run(self) -> None:
        last = now()
        while True:
            with self._state:
                while not (self._playing or self._closed):
                    self._state.wait()
                    last = now()
                if self._closed:
                    return
                moment, line = now(), self._line
                assert line is not None
                self.time = min(self.time + (moment - last) * self.speed, line.duration)
                last = moment
                self._show(line, self.time)
                at_end = self.time >= line.duration
                self._playing = not at_end
            if at_end:
                self._stopped()
            with self._state:
                self._state.wait(_PERIOD)

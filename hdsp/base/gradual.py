"""Computations in short steps: a query with a time limit stops between two steps, and another query continues.

Convention: a generator function yields None between its steps and returns its result. Its local variables keep the work
done so far, so that nothing is computed twice.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

Result = TypeVar("Result")

#: A computation in steps.
Steps = Generator[None, None, Result]

#: Moment in seconds; every deadline is on this clock.
now = time.perf_counter


_thread = threading.local()


class Cancelled(Exception):
    """Another thread has cancelled the computation."""


@contextmanager
def cancelled_by(event: threading.Event) -> Iterator[None]:
    """Within this block, ``checkpoint`` raises ``Cancelled`` in this thread once the event is set."""
    before, _thread.event = getattr(_thread, "event", None), event
    try:
        yield
    finally:
        _thread.event = before


def checkpoint() -> None:
    """Place at which a computation may end early, without harm to results that others continue.

    Raises:
        Cancelled: see ``cancelled_by``.
    """
    event = getattr(_thread, "event", None)
    if event is not None and event.is_set():
        raise Cancelled


def finished(steps: Steps[Result]) -> Result:
    """Runs all steps and returns the result."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


class Gradual(Generic[Result]):
    """A computation that may pause. Several threads may continue it, one at a time.

    Attributes:
        done: whether the result is there.
        failed: whether a step raised an exception; there will be no result.
        seconds: time spent in the steps so far.
    """

    def __init__(self, steps: Steps[Result]):
        self.done = self.failed = False
        self.seconds = 0.0
        self._steps, self._lock = steps, threading.Lock()
        self._result: Result

    def step(self) -> bool:
        """Takes one step, or none after the last one; returns ``done``."""
        with self._lock:
            if self.done:
                return True
            if self.failed:
                raise RuntimeError("the computation failed at an earlier step")
            began = now()
            try:
                next(self._steps)
            except StopIteration as end:
                self._result, self.done = end.value, True
            except BaseException:
                self.failed = True
                raise
            finally:
                self.seconds += now() - began
            return self.done

    def run(self, ends: float) -> bool:
        """Continues until the result is there or a moment on the clock ``now`` would pass; returns ``done``.

        The longest step so far tells whether another one fits. The first step always runs, so that repeated queries
        with little time get to an end.

        Raises:
            Cancelled: between two steps; a later call continues.
        """
        longest = 0.0
        while not self.done:
            checkpoint()
            began = now()
            self.step()
            longest = max(longest, now() - began)
            if now() + longest > ends:
                break
        return self.done

    @property
    def result(self) -> Result:
        """The result; only after ``done``."""
        if not self.done:
            raise RuntimeError("the computation is not finished")
        return self._result

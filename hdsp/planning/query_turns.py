"""Several threads and one planner: queries and updates take turns, and another thread cancels queries."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from hdsp.base.gradual import Cancelled, cancelled_by
from hdsp.planning.answers.plans import Plan

Answer = TypeVar("Answer")


class QueryTurns:
    """One lock for a planner. Kernels release Python's global lock, so threads without this planner go on."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self._events: set[threading.Event] = set()

    def cancel(self) -> None:
        """Ends all queries that have begun, also those that wait for their turn."""
        for event in tuple(self._events):
            event.set()

    @contextmanager
    def _event(self) -> Iterator[threading.Event]:
        event = threading.Event()
        self._events.add(event)
        try:
            yield event
        finally:
            self._events.discard(event)

    def answer(self, query: Callable[[], Answer], cancelled: Callable[[], Answer]) -> Answer:
        """Returns the result of a query or a part of it in its turn, or the answer to a cancelled one."""
        with self._event() as event, self.lock, cancelled_by(event):
            try:
                return query()
            except Cancelled:
                return cancelled()

    def answers(self, plans: Iterator[Plan], cancelled: Callable[[], Plan]) -> Iterator[Plan]:
        """Yields plans, each computed in a turn of its own; ends after a cancellation."""
        last = None
        with self._event() as event:
            while True:
                try:
                    with self.lock, cancelled_by(event):
                        plan = next(plans, None)
                except Cancelled:
                    if last is None:
                        yield cancelled()
                    else:
                        last.stats.end("cancelled")
                    return
                if plan is None:
                    return
                last = plan
                yield plan

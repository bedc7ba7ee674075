"""Compilation of kernels: said once in a process, with a line of progress every two seconds while it lasts."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

from hdsp.base.gradual import now

_LOG = logging.getLogger("hdsp")
_PACKAGE = __name__.partition(".")[0]
_INTERVAL = 1.5  # s between lines; a busy machine wakes a thread late, and two seconds are promised


class Compilations(event.Listener):
    """Listens to Numba: logs the first compilation of a kernel of this package. Kernels from disk do not count.

    Attributes:
        names: names of the kernels whose compilation has begun.
        done: number of kernels compiled so far.
    """

    def __init__(self) -> None:
        self.names: list[str] = []
        self.done = 0
        self._expected: int | None = None
        self._over: threading.Event | None = None

    def on_start(self, event: Any) -> None:
        function = event.data["dispatcher"].py_func
        if not _is_ours(function):
            return
        if not self.names:
            _LOG.warning("compiling the planner for this machine, once; it takes about a minute")
        self.names.append(f"{function.__module__}.{function.__qualname__}")
        if self._expected is not None and self._over is None:
            self._over = threading.Event()
            arguments = self._over, self._expected + self.done, now()
            threading.Thread(target=self._tell, args=arguments, name="hdsp-compilation", daemon=True).start()

    def on_end(self, event: Any) -> None:
        self.done += _is_ours(event.data["dispatcher"].py_func)

    @contextmanager
    def told(self, expected: int) -> Iterator[None]:
        """Logs lines of progress during a block, from the first compilation in it on.

        Args:
            expected: number of kernels in the block, roughly.
        """
        if self._expected is not None:  # an outer block tells already
            yield
            return
        self._expected = expected
        try:
            yield
        finally:
            self._expected = None
            if self._over is not None:
                self._over.set()
                self._over = None

    def _tell(self, over: threading.Event, expected: int, began: float) -> None:
        while not over.wait(_INTERVAL):
            _LOG.warning(
                "compiling: %d of about %d kernels, %.0f s", self.done, max(expected, self.done + 1), now() - began
            )


def _is_ours(function: Any) -> bool:
    return function.__module__.partition(".")[0] == _PACKAGE


#: All compilations of this process.
compilations = Compilations()
event.register("numba:compile", compilations)

"""Compilation of kernels: said once in a process, because it takes about a minute in a new installation."""

from __future__ import annotations

import logging
from typing import Any

from numba.core import event

_LOG = logging.getLogger("hdsp")
_PACKAGE = __name__.partition(".")[0]


class Compilations(event.Listener):
    """Listens to Numba and logs the first compilation of a kernel of this package; kernels from disk do not count.

    Attributes:
        names: names of the kernels compiled so far.
    """

    def __init__(self) -> None:
        self.names: list[str] = []

    def on_start(self, event: Any) -> None:
        function = event.data["dispatcher"].py_func
        if function.__module__.partition(".")[0] != _PACKAGE:
            return
        if not self.names:
            _LOG.warning("compiling the planner for this machine, once; it takes about a minute")
        self.names.append(f"{function.__module__}.{function.__qualname__}")

    def on_end(self, event: Any) -> None:
        """Nothing is to do."""


#: All compilations of this process.
compilations = Compilations()
event.register("numba:compile", compilations)

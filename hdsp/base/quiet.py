"""Silence in one thread, for libraries with more to say than their results.

Warning filters and hooks for errors belong to the whole process. Changing and restoring them
(``warnings.catch_warnings``) silences other threads, too; two threads in turn may leave the process silent for good.
Here, filter and hooks stay in place while any thread is quiet, and ask which thread speaks.
"""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

_HOOKS = "excepthook", "unraisablehook"


class _SpeakingThread(threading.local):
    """The present thread.

    Attributes:
        blocks: number of quiet blocks around its code.
    """

    blocks = 0

    @property
    def is_quiet(self) -> bool:
        """Whether the code runs in a quiet block."""
        return self.blocks > 0

    def match(self, _text: str) -> bool:
        """The answer to a warning filter, which asks a regular expression for a match."""
        return self.is_quiet


class _QuietHook:
    """A hook of ``sys``: nothing in quiet threads, else the hook before it."""

    def __init__(self, former: Callable[..., Any]):
        self.former = former

    def __call__(self, *details: Any) -> None:
        if not _THREAD.is_quiet:
            self.former(*details)


_THREAD = _SpeakingThread()
_FILTER = ("ignore", _THREAD, Warning, None, 0)
_LOCK = threading.Lock()
_quiet_blocks = 0
_installed: dict[str, _QuietHook] = {}


@contextmanager
def quiet_thread() -> Iterator[None]:
    """Hides warnings and tracebacks from uncatchable errors in this thread during a block.

    Other threads keep theirs. Afterwards, filters and hooks are as before, also if several threads were quiet.
    """
    with _LOCK:
        _enter()
    _THREAD.blocks += 1
    try:
        yield
    finally:
        _THREAD.blocks -= 1
        with _LOCK:
            _leave()


def _enter() -> None:
    global _quiet_blocks
    _quiet_blocks += 1
    filters: list[Any] = warnings.filters  # type: ignore[assignment]
    if filters[:1] != [_FILTER]:  # other code may have entered filters of its own, or restored former ones
        filters.insert(0, _FILTER)
    if _quiet_blocks == 1:
        for name in _HOOKS:
            _installed[name] = _QuietHook(getattr(sys, name))
            setattr(sys, name, _installed[name])


def _leave() -> None:
    global _quiet_blocks
    _quiet_blocks -= 1
    if _quiet_blocks:
        return
    filters: list[Any] = warnings.filters  # type: ignore[assignment]
    while _FILTER in filters:
        with suppress(ValueError):
            filters.remove(_FILTER)
    for name, hook in _installed.items():
        if getattr(sys, name) is hook:  # else another hook has taken its place, and may call this one
            setattr(sys, name, hook.former)

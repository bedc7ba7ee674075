"""Trials: tests against one mutant, in a fork of a process that holds modules, maps and textbook results already.

Kernels run as plain Python, so that no mutant is compiled. A fork exchanges the code of one function, which all modules
share, and runs the tests up to the first failure.
"""

import importlib
import inspect
import os
import resource
import signal
from typing import Any, NamedTuple

import pytest

from tests.mutants.changes import Mutant

KILLED, HANGS, SURVIVED = "killed", "hangs", "survived"
_MEMORY = 8 << 30  # bytes of a fork's address space
_PATIENCE = 100  # times the limit on CPU time, by the clock: other work may take nearly all of a machine
_FAULT = 99  # exit status of a fork that could not try its mutant
_OPTIONS = ["-q", "-x", "--no-header", "--no-summary", "--tb=no", "--durations=0", "-p", "no:cacheprovider"]


class Trial(NamedTuple):
    """Result of a trial.

    Attributes:
        result: KILLED (a test fails, or memory ends), HANGS (no end within the time) or SURVIVED (all tests pass).
        seconds: CPU time.
    """

    result: str
    seconds: float


def run_tests(tests: list[str]) -> bool:
    """Runs tests in this process; returns whether all pass."""
    return pytest.main([*_OPTIONS, *tests]) == pytest.ExitCode.OK


def tried(mutant: Mutant, tests: list[str], seconds: float) -> Trial:
    """Tries a mutant in a fork, with a limit on CPU time."""
    before = _children_seconds()
    if (child := os.fork()) == 0:
        _try_and_exit(mutant, tests, seconds)
    _, status = os.waitpid(child, 0)
    spent = _children_seconds() - before
    if os.WIFSIGNALED(status):
        hangs = os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGALRM)
        return Trial(HANGS if hangs else KILLED, spent)
    if (code := os.WEXITSTATUS(status)) == _FAULT:
        raise RuntimeError(f"could not try {mutant.name}")
    return Trial(SURVIVED if code == pytest.ExitCode.OK else KILLED, spent)


def _try_and_exit(mutant: Mutant, tests: list[str], seconds: float) -> None:
    status = _FAULT
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        exchange(mutant)
        for number in (signal.SIGXCPU, signal.SIGALRM):
            signal.signal(number, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 2))
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE * seconds)
        status = int(pytest.main([*_OPTIONS, *tests]))
    finally:
        os._exit(status)


def exchange(mutant: Mutant) -> None:
    """Exchanges the code of a function, for all modules that name it."""
    module = importlib.import_module(mutant.file.removesuffix(".py").replace("/", "."))
    *classes, name = mutant.function.split(".")
    owner: Any = module
    for inner in classes:
        owner = getattr(owner, inner)
    function = inspect.getattr_static(owner, name)
    function = getattr(function, "fget", None) or getattr(function, "__func__", function)
    inspect.unwrap(function).__code__ = mutant.code()
    for value in vars(module).values():  # results of the former code
        if hasattr(value, "cache_clear"):
            value.cache_clear()


def _children_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime

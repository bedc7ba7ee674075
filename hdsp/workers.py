"""One function over many jobs in several processes, results in order."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import Any, TypeVar

from hdsp.errors import InputError

Job = TypeVar("Job")
Result = TypeVar("Result")


def default_workers() -> int:
    """Number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def parallel_map(
    function: Callable[..., Result], constants: tuple[Any, ...], jobs: Iterable[Job], workers: int | None = None
) -> Iterator[Result]:
    """Yields ``function(*constants, job)`` for each job, in the order of the jobs.

    The first job runs alone, so that one process fills the cache of compiled kernels before the others read it.
    Processes are spawned: they import what the function needs and nothing else. They end when this process ends,
    however it ends.

    Args:
        function: found by its name in a worker, as are functions among the constants.
        constants: sent once to each worker.
        jobs: sent one by one.
        workers: processes; None = one for each core, 1 = no process but this one.

    Raises:
        InputError: if a worker was killed. What ``function`` raises is passed on.
    """
    jobs = list(jobs)
    workers = min(workers or default_workers(), len(jobs))
    if workers <= 1:
        for job in jobs:
            yield function(*constants, job)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(function, constants))
    try:
        yield pool.submit(_work, jobs[0]).result()
        yield from pool.map(_work, jobs[1:])
    except BrokenProcessPool as error:
        raise InputError(
            f"one of {workers} worker processes was ended from outside (out of memory?); try again with fewer workers"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


_function: Callable | None = None
_constants: tuple = ()


def _begin(function: Callable, constants: tuple) -> None:
    global _function, _constants
    _function, _constants = function, constants
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the first one decides what it means
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


def _work(job: Any) -> Any:
    assert _function is not None
    return _function(*_constants, job)

"""Parts of a stage in several processes of this machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

from hdsp.base.errors import InputError

from .config_types import Config


def side_by_side(jobs: Sequence[Callable[[], Any]], processes: int) -> list[Any]:
    """Runs jobs, earlier ones first, and returns their results in the order of the jobs.

    Jobs and results have to be picklable, except with one process, which is this one.

    Raises:
        InputError: a process was killed.
    """
    if processes == 1:
        return [job() for job in jobs]
    # A fork would copy the threads of loaded libraries in an unknown state.
    with ProcessPoolExecutor(min(processes, len(jobs)), get_context("spawn")) as pool:
        try:
            return [running.result() for running in [pool.submit(job) for job in jobs]]
        except BrokenProcessPool as error:
            raise InputError("a process of this stage was killed; out of memory? Try runtime.workers=1") from error


def with_threads(config: Config, threads: int) -> Config:
    """Returns a configuration whose networks compute with this number of threads, unless it names another one."""
    runtime, hardware = config.runtime, config.runtime.hardware
    known = hardware.threads or threads
    return replace(config, runtime=replace(runtime, hardware=replace(hardware, threads=known)))

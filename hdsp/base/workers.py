"""Dask worker processes: on this machine, at a running scheduler, or as SLURM jobs.

A run in a single process does not import Dask.
"""

import logging
import os
import re
import resource
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator

from hdsp.base.ending import Ended, end_children
from hdsp.base.errors import InputError
from hdsp.base.settings import Count, checked, fault

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

#: Address schemes for Dask schedulers.
SCHEMES = ("tcp://", "tls://", "ucx://", "ws://", "wss://", "inproc://")

#: Start attempts for a local cluster that loses a worker during its start.
START_ATTEMPTS = 5


def _size(text: str) -> str:
    if not re.fullmatch(r"[0-9]+(\.[0-9]+)? ?([kMGTP]i?)?B?", text, re.IGNORECASE):
        raise fault("", text, "a number of bytes, such as 2GB")
    return text


def _scheduler(text: str) -> str:
    if text != "slurm" and not text.startswith(SCHEMES):
        raise fault("", text, "null (this machine), slurm, or an address like tcp://host:8786")
    return text


def _slurm(options: dict[str, Any]) -> dict[str, Any]:
    for name in ("jobs", "cores", "processes"):
        value = options.get(name)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < 1):
            raise fault(name, value, "a whole number of at least 1")
    return options


MemorySize = Annotated[str, AfterValidator(_size)]
Scheduler = Annotated[str, AfterValidator(_scheduler)]
SlurmOptions = Annotated[dict[str, Any], AfterValidator(_slurm)]


@checked
class ClusterSettings:
    """Worker processes; no result depends on these settings.

    Attributes:
        workers: processes in a local cluster; None = one per core; 1 = this process only.
        scheduler: None = a local cluster; the address of a running Dask scheduler; ``slurm``.
        slurm: for ``slurm``: ``jobs`` (number of jobs to submit) and options for ``dask_jobqueue.SLURMCluster`` (cores,
            memory, walltime, queue, account, ...). Each core gets a worker process unless ``processes`` is set.
        dashboard: address for a local scheduler's Dask dashboard; None = no dashboard.
        memory: memory limit per local worker, e.g. ``2GB``; a worker above it is restarted. None = no limit.

    Raises:
        InputError: the worker count is below 1, or the scheduler kind is unknown.
    """

    workers: Count | None = None
    scheduler: Scheduler | None = None
    slurm: SlurmOptions = field(default_factory=dict)
    dashboard: str | None = "127.0.0.1:8787"
    memory: MemorySize | None = None

    def processes(self, jobs: int) -> int:
        """Returns the number of local worker processes for a number of jobs; 1 = this process only."""
        return max(1, min(self.workers or default_workers(), jobs))


def default_workers() -> int:
    """Returns the number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def connected(settings: ClusterSettings, jobs: int) -> Iterator["Client"]:
    """Yields a cluster client; the block's end also ends everything started for it.

    Local workers end with this process in any case.

    Args:
        settings: cluster settings.
        jobs: number of jobs, which limits the workers in a local cluster.

    Raises:
        InputError: a package is missing, no scheduler answers, or workers end whenever they do a part of the work.

    Warns:
        UserWarning: the scheduler takes work from anybody who reaches it.
    """
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        raise InputError(f"several workers need Dask: pip install 'dask[distributed]' ({error})") from error

    _warn_of_open(settings.scheduler)
    if settings.scheduler is not None and settings.scheduler != "slurm":
        try:
            client = Client(settings.scheduler, timeout="10s")
        except (OSError, ValueError) as error:
            raise InputError(f"no Dask scheduler answers at {settings.scheduler}: {error}") from error
        with client, _killed_workers_told():
            yield client
        return
    # Workers that are ended leave their folders; in this one they are removed.
    with (
        TemporaryDirectory(prefix="hdsp-workers-", ignore_cleanup_errors=True) as folder,
        dask.config.set({"temporary-directory": folder}),
    ):
        is_local = settings.scheduler is None
        cluster = _local_cluster(settings, jobs) if is_local else _slurm_cluster(settings.slurm)
        client, at_once = Client(cluster), False
        try:
            with _killed_workers_told():
                yield client
        except Ended:
            at_once = is_local  # Dask would wait for the work, or start the ended workers anew
            raise
        finally:
            if at_once:
                cluster.shutdown_on_close = False
                end_children()
            else:
                client.close()
                with suppress(TimeoutError):  # on a busy machine, workers end slowly; they end with this process
                    cluster.close()


@contextmanager
def _killed_workers_told() -> Iterator[None]:
    """Tells in one line of work on which Dask has lost one worker after the other."""
    from distributed import KilledWorker

    try:
        yield
    except KilledWorker as error:
        raise InputError(
            "worker processes end whenever they do a part of the work; out of memory? Try again with fewer workers"
        ) from error


def _warn_of_open(scheduler: str | None) -> None:
    """Warns of connections to other machines without TLS: a Dask scheduler runs any function that it is sent."""
    if scheduler is None or scheduler.startswith(("tls://", "wss://", "inproc://")):
        return
    host = scheduler.partition("://")[2].rpartition(":")[0].strip("[]")
    if host == "localhost" or host == "::1" or host.startswith("127."):
        return
    place = "of SLURM jobs" if scheduler == "slurm" else scheduler
    warnings.warn(
        f"the Dask scheduler {place} has no TLS: whoever reaches its port runs code as its user. Keep it in a closed "
        "network, or use tls:// (docs/pipeline.md)",
        stacklevel=4,
    )


def dead_workers(cluster: "LocalCluster") -> set[Any]:
    """Returns the names of local cluster workers without a process."""
    from distributed.core import Status

    ended = (Status.stopped, Status.failed, Status.closed)
    return {
        name
        for name, nanny in dict(cluster.workers).items()
        if nanny.status in ended or (nanny.process is not None and nanny.process.status in ended)
    }


def replace_workers(cluster: "LocalCluster", names: set[Any]) -> None:
    """Replaces workers in a local cluster.

    Dask itself replaces workers, except a worker that ends during its start.
    """
    if names:
        wanted = len(cluster.worker_spec)
        for name in names:
            cluster.worker_spec.pop(name, None)
        cluster.scale(wanted)


def peak_memory() -> int:
    """Returns this process's peak memory in bytes."""
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines() if ":" in line)
        return 1024 * int(lines["VmHWM"].split()[0])
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _local_cluster(settings: ClusterSettings, jobs: int) -> "LocalCluster":
    from distributed import LocalCluster

    # Of workers that are ended, a process of Python clears away what they share, and would tell of it.
    told = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [told, "ignore:resource_tracker:UserWarning"]))
    for attempt in range(START_ATTEMPTS):
        try:
            return LocalCluster(
                n_workers=settings.processes(jobs),
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address=settings.dashboard,
                memory_limit=settings.memory or 0,
                silence_logs=logging.CRITICAL,  # a lost worker is restarted; no message is needed
            )
        except RuntimeError as error:  # Dask restarts workers, except a worker killed during its first start
            if attempt == START_ATTEMPTS - 1:
                raise InputError(f"worker processes end while they start: {error}") from error
    raise AssertionError("unreachable")


def _slurm_cluster(options: Mapping[str, Any]):
    try:
        from dask_jobqueue import SLURMCluster
    except ImportError as error:
        raise InputError("scheduler is slurm: needs the package dask-jobqueue (pip install dask-jobqueue)") from error
    given = {name: value for name, value in options.items() if value is not None}
    jobs = given.pop("jobs", 1)
    if missing := sorted({"cores", "memory"} - set(given)):
        raise InputError(f"scheduler is slurm: {missing[0]} of a job is not set; need cores and memory")
    try:
        cluster = SLURMCluster(**{"processes": given["cores"], **given})
    except (TypeError, ValueError) as error:
        raise InputError(f"scheduler is slurm: {error}") from error
    cluster.scale(jobs=jobs)
    return cluster

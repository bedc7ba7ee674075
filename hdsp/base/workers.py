"""Worker processes, by way of Dask: on this machine, at a scheduler that runs already, or as jobs of SLURM.

Dask is imported when it is needed: a run in one process does without.
"""

import logging
import os
import resource
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hdsp.base.errors import InputError

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

#: Schemes of the addresses of Dask schedulers.
SCHEMES = ("tcp://", "tls://", "ucx://", "ws://", "wss://", "inproc://")

#: How often a local cluster is started that loses a worker while it starts.
START_ATTEMPTS = 5


@dataclass(frozen=True)
class ClusterSettings:
    """Which processes do the work; no result depends on it.

    Attributes:
        workers: processes of a local cluster; None = one for each core; 1 = no process but this one.
        scheduler: None = a local cluster; the address of a running Dask scheduler; ``slurm``.
        slurm: for ``slurm``: ``jobs``, how many to submit, and the options of ``dask_jobqueue.SLURMCluster`` (cores,
            memory, walltime, queue, account, ...). Each core gets a worker process unless ``processes`` says otherwise.
        dashboard: address at which the scheduler of a local cluster serves Dask's dashboard; None = nowhere.
        memory: limit of a worker of a local cluster, ``2GB``; one that exceeds it is started anew. None = none.

    Raises:
        InputError: for a number of workers below 1, or a scheduler of no known kind.
    """

    workers: int | None = None
    scheduler: str | None = None
    slurm: Mapping[str, Any] = field(default_factory=dict)
    dashboard: str | None = "127.0.0.1:8787"
    memory: str | None = None

    def __post_init__(self):
        if self.workers is not None and self.workers < 1:
            raise InputError(f"workers is {self.workers}; need at least 1, or null for one per core")
        if self.scheduler not in (None, "slurm") and not str(self.scheduler).startswith(SCHEMES):
            raise InputError(
                f"scheduler is {self.scheduler!r}; need null (this machine), slurm, or an address like tcp://host:8786"
            )

    def processes(self, jobs: int) -> int:
        """Local worker processes for a number of jobs; 1 = none but this one."""
        return max(1, min(self.workers or default_workers(), jobs))


def default_workers() -> int:
    """Number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def connected(settings: ClusterSettings, jobs: int) -> Iterator["Client"]:
    """A client of the cluster; what was started for it ends with the block. Local workers also end with this process,
    however it ends.

    Args:
        settings: which cluster.
        jobs: how many there are to do; a local cluster has no more workers than that.

    Raises:
        InputError: if a package is missing, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(f"several workers need Dask: pip install 'dask[distributed]' ({error})") from error

    if settings.scheduler is not None and settings.scheduler != "slurm":
        try:
            client = Client(settings.scheduler, timeout="10s")
        except (OSError, ValueError) as error:
            raise InputError(f"no Dask scheduler answers at {settings.scheduler}: {error}") from error
        with client:
            yield client
        return
    if settings.scheduler == "slurm":
        cluster = _slurm_cluster(settings.slurm)
    else:
        cluster = _local_cluster(settings, jobs)
    try:
        with Client(cluster) as client:
            yield client
    finally:
        with suppress(TimeoutError):  # on a busy machine workers are slow to end; they end with this process
            cluster.close()


def dead_workers(cluster: "LocalCluster") -> set[Any]:
    """Names of the workers of a local cluster that have no process."""
    from distributed.core import Status

    ended = (Status.stopped, Status.failed, Status.closed)
    return {
        name
        for name, nanny in dict(cluster.workers).items()
        if nanny.status in ended or (nanny.process is not None and nanny.process.status in ended)
    }


def replace_workers(cluster: "LocalCluster", names: set[Any]) -> None:
    """Starts others in the place of workers of a local cluster. Dask does so itself, unless one ended as it began."""
    if names:
        wanted = len(cluster.worker_spec)
        for name in names:
            cluster.worker_spec.pop(name, None)
        cluster.scale(wanted)


def peak_memory() -> int:
    """Most bytes that this process has held at a time."""
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines() if ":" in line)
        return 1024 * int(lines["VmHWM"].split()[0])
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _local_cluster(settings: ClusterSettings, jobs: int) -> "LocalCluster":
    from distributed import LocalCluster

    for attempt in range(START_ATTEMPTS):
        try:
            return LocalCluster(
                n_workers=settings.processes(jobs),
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address=settings.dashboard,
                memory_limit=settings.memory or 0,
                silence_logs=logging.CRITICAL,  # a lost worker is started anew: no news
            )
        except RuntimeError as error:  # Dask starts workers anew, but not one that is killed while it first starts
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

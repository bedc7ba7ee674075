"""Labelling on a Dask cluster that tolerates lost workers.

The maps of a shard are labelled in parts. A part stays on its worker until a worker writes the shard to its place. Dask
repeats the work of a lost worker. If a part keeps losing its workers, its maps are labelled one by one; this finds the
map that ends the workers, if one map is the cause.
"""

import secrets
import time
from collections.abc import Hashable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from hdsp.base.errors import InputError
from hdsp.base.storage import open_folder
from hdsp.base.workers import dead_workers, replace_workers
from hdsp.labels.counts import LabelCounts
from hdsp.labels.run.jobs import LabelMap, count_labels, label_maps, store_shard
from hdsp.labels.run.progress import TaskProgress
from hdsp.labels.run.splits import LabelRun, labels_code
from hdsp.labels.shard_index import ShardPlan

if TYPE_CHECKING:
    from distributed import Client, Future

#: Maps in a part: a few seconds of work, so that all workers are busy to the end and a lost worker costs little.
MAPS_PER_PART = 10

#: Attempts to write a shard; an attempt fails after it has lost as many workers as Dask allows.
STORE_ATTEMPTS = 3

#: Seconds without any worker. Then a run on its own processes gives up; any other run reports that it waits.
NO_WORKER_SECONDS = 120.0

SCHEDULER_GONE = "the Dask scheduler is gone; finished shards stay, run again for the others"

_POLL_SECONDS = 0.02


@dataclass
class _Job:
    """A shard in progress.

    Attributes:
        parts: labels for its maps, in order.
        counts: counts for the parts.
        store: the write to storage.
        stores: number of attempts to write.
    """

    shard: ShardPlan
    parts: list["Future"] = field(default_factory=list)
    maps: list[Sequence[int]] = field(default_factory=list)
    counts: list["Future"] = field(default_factory=list)
    store: "Future | None" = None
    stores: int = 0


class ClusterLabelling:
    """A label run on a cluster.

    Args:
        client: Dask client of the cluster.
        run: the split, with everything on which its labels depend.
        label: function that labels one map; None = `hdsp.labels.rules.label_map`. Pickled by name.
        place: shard folder or URL, visible to all workers.
        progress: progress bar to update after each part.
        own_workers: whether this run alone starts workers; if none is left, the run does not wait for others.
    """

    def __init__(
        self,
        client: "Client",
        run: LabelRun,
        label: LabelMap | None,
        place: str,
        progress: TaskProgress,
        own_workers: bool = False,
    ) -> None:
        from distributed import as_completed

        self._client, self._run, self._label, self._place, self._progress = client, run, label, place, progress
        self._code, self._token, self._submitted = labels_code(), secrets.token_hex(4), 0
        self._jobs: dict[Hashable, _Job] = {}  # by the keys of the awaited futures
        self._done = as_completed(loop=client.loop)
        self._own_workers, self._workers, self._looked, self._last_seen = own_workers, 0, -1.0, time.monotonic()
        self._said_waiting = False
        self._dead: set[Any] = set()  # names of workers

    def shards(self, shards: Sequence[ShardPlan]) -> Iterator[tuple[ShardPlan, dict[str, LabelCounts]]]:
        """Labels and writes shards; yields each shard with its counts by category after it is written.

        Raises:
            InputError: if a shard cannot be written, or a map keeps ending its workers. Finished shards stay.
            RuntimeError: if labelling fails; the message names the map.
        """
        try:
            yield from self._shards(shards)
        except (CancelledError, OSError) as error:
            # Dask raises these errors for a lost scheduler; workers convert theirs to `InputError`.
            raise InputError(SCHEDULER_GONE) from error

    def _shards(self, shards: Sequence[ShardPlan]) -> Iterator[tuple[ShardPlan, dict[str, LabelCounts]]]:
        waiting, written = list(reversed(shards)), 0
        if waiting:
            self._begin(waiting.pop(), alone=True)
        while written < len(shards):
            while waiting and len(shards) - len(waiting) - written < self._window():
                self._begin(waiting.pop())
            future = self._next()
            job = self._jobs.pop(future.key, None)
            if job is None:
                continue  # this future belongs to an abandoned attempt
            if future.status != "finished":
                self._mend(job, future)
            elif future is job.store:
                counts = future.result()
                self._check_visible(job.shard)
                written += 1
                yield job.shard, counts
            else:
                self._progress.count(future.result())

    def _window(self) -> int:
        """Number of shards in progress: enough for all workers, but not the whole split in memory."""
        return 2 + 2 * self._workers

    def _next(self) -> "Future":
        """Waits for a future and meanwhile monitors the workers."""
        while not self._done.has_ready():
            self._look_at_workers()
            time.sleep(_POLL_SECONDS)
        self._look_at_workers()
        return next(self._done)

    def _wait_for(self, future: "Future") -> None:
        while not future.done():
            self._look_at_workers()
            time.sleep(_POLL_SECONDS)

    def _look_at_workers(self) -> None:
        now = time.monotonic()
        if now < self._looked + 1.0:
            return
        self._looked = now
        try:
            self._workers = len(self._client.scheduler_info(n_workers=-1)["workers"])
        except (OSError, KeyError, TypeError) as error:
            raise InputError(SCHEDULER_GONE) from error
        if self._own_workers:
            dead = dead_workers(self._client.cluster)
            replace_workers(self._client.cluster, dead & self._dead)  # Dask had one second to replace them
            self._dead = dead - self._dead
        if self._workers:
            self._last_seen, self._said_waiting = now, False
        elif now > self._last_seen + NO_WORKER_SECONDS:
            if self._own_workers:
                raise InputError(
                    "all worker processes have ended, and none could be started anew; finished shards stay"
                )
            if not self._said_waiting:
                self._progress.say("no worker is there; waiting for one")
                self._said_waiting = True

    def _begin(self, shard: ShardPlan, alone: bool = False) -> None:
        """Submits a shard.

        ``alone`` waits for its first part, so that one process fills the cache of compiled kernels before others read
        it.
        """
        job = _Job(shard)
        for first in range(0, len(shard.maps), MAPS_PER_PART):
            maps = shard.maps[first : first + MAPS_PER_PART]
            job.parts.append(self._submit(label_maps, self._run, self._label, self._code, maps))
            job.maps.append(maps)
            if alone and first == 0:
                self._wait_for(job.parts[0])
        self._count(job, job.parts)
        self._store(job)

    def _count(self, job: _Job, parts: Sequence["Future"]) -> None:
        futures = [self._submit(count_labels, part) for part in parts]
        job.counts += futures
        self._await(job, futures)

    def _store(self, job: _Job) -> None:
        job.stores += 1
        job.store = self._submit(store_shard, self._run, self._place, job.shard, list(job.parts))
        self._await(job, [job.store])

    def _await(self, job: _Job, futures: Sequence["Future"]) -> None:
        for future in futures:
            self._jobs[future.key] = job
            self._done.add(future)

    def _submit(self, function, *arguments) -> "Future":
        self._submitted += 1
        key = f"{function.__name__}-{self._token}-{self._submitted}"
        return self._client.submit(function, *arguments, key=key)

    def _mend(self, job: _Job, future: "Future") -> None:
        """Repeats work that failed because workers were lost; raises all other errors."""
        from distributed import KilledWorker

        if future.status == "cancelled":
            raise InputError(SCHEDULER_GONE)
        error = future.exception()
        if not isinstance(error, KilledWorker):
            raise error
        assert job.store is not None  # every job in progress has one
        lost = [k for k, part in enumerate(job.parts) if part.status == "error"]
        for other in [*job.counts, job.store]:
            if other.status == "error":
                self._jobs.pop(other.key, None)
        for k in reversed(lost):  # reversed order keeps the earlier indices valid
            mended = self._one_by_one(job.maps[k])
            job.parts[k : k + 1] = mended
            job.maps[k : k + 1] = [[number] for number in job.maps[k]]
            self._count(job, mended)
        if job.stores >= STORE_ATTEMPTS + len(job.shard.maps):
            raise InputError(f"workers are lost again and again while they write {job.shard.name}: {error}")
        if job.store.status in ("error", "cancelled"):
            self._store(job)

    def _one_by_one(self, maps: Sequence[int]) -> list["Future"]:
        from distributed import KilledWorker

        self._progress.say(f"maps {maps[0]} to {maps[-1]} have lost several workers; labelling them one by one")
        futures = []
        for number in maps:
            futures.append(self._submit(label_maps, self._run, self._label, self._code, [number]))
            self._wait_for(futures[-1])
            if futures[-1].status == "error" and isinstance(futures[-1].exception(), KilledWorker):
                raise InputError(
                    f"worker processes end whenever they label {self._run.describe(number)}; "
                    "out of memory? Try again with fewer workers"
                )
        return futures

    def _check_visible(self, shard: ShardPlan) -> None:
        if not open_folder(self._place).has(shard.name):
            raise InputError(
                f"a worker has written {shard.name} to {self._place}, but it is not there as this machine sees it: "
                "need a folder that all machines share, or the URL of an object store"
            )

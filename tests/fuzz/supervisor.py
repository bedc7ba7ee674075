"""Workers of the fuzz suite and their supervision: deadlines for each case, replacement of workers, counts."""

import json
import os
import selectors
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Any

from tests import ROOT
from tests.fuzz.groups import FINE

#: CPU seconds of one case, and seconds of waiting for it, as other processes may hold the cores.
CASE = {"files": 10.0, "plans": 120.0, "updates": 120.0}
PATIENCE = 6
#: Seconds of waiting for a worker to start or to write its first whole file.
START = 300.0
#: Cases that a worker gets at once.
BATCH = {"files": 200, "plans": 2, "updates": 1}


class _Worker:
    """A process, and the case that it works on."""

    def __init__(self) -> None:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.fuzz_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            cwd=ROOT,
        )
        self.kind, self.next, self.end, self.busy = "", 0, 0, False
        self.heard, self.computed, self.fresh = time.monotonic(), 0.0, True
        self.buffer = b""

    def give(self, group: str, kind: str, seed: int, count: int, fresh: bool) -> None:
        self.kind, self.next, self.end, self.busy, self.fresh = kind, seed, seed + count, True, fresh
        self.heard, self.computed = time.monotonic(), self.cpu()
        assert self.process.stdin is not None
        self.process.stdin.write(f"{group} {kind.replace(' ', '_')} {seed} {count}\n".encode())
        self.process.stdin.flush()

    def cpu(self) -> float:
        """CPU seconds of the process so far; 0 where the system does not tell."""
        try:
            with open(f"/proc/{self.process.pid}/stat") as file:
                fields = file.read().rpartition(")")[2].split()
            return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        except (OSError, ValueError):
            return 0.0

    def hangs(self, limit: float) -> bool:
        waited = time.monotonic() - self.heard
        if self.fresh:
            return waited > START
        return (waited > limit and self.cpu() - self.computed > limit) or waited > PATIENCE * limit

    def end_now(self) -> None:
        self.process.kill()
        self.process.wait()


class Supervisor:
    """Runs the cases of a group and counts their outcomes."""

    def __init__(self, group: str, kinds: Mapping[str, float], seed: int, processes: int):
        self.group, self.kinds, self.processes = group, dict(kinds), processes
        self.given = dict.fromkeys(kinds, 0)
        self.seed = seed
        self.counts: dict[str, Counter] = defaultdict(Counter)
        self.faults: list[dict[str, Any]] = []
        self.slowest = self.computed = 0.0

    def run(self, seconds: float) -> dict[str, Any]:
        """Runs for some seconds, started work included; returns counts by kind and outcome, and all faults."""
        began = time.monotonic()
        end = began + seconds
        selector = selectors.DefaultSelector()
        workers = [self._started(selector) for _ in range(self.processes)]
        known: dict[_Worker, set[str]] = {worker: set() for worker in workers}
        while any(worker.busy for worker in workers) or time.monotonic() < end:
            for k, worker in enumerate(workers):
                if worker.process.poll() is not None or (worker.busy and worker.hangs(CASE[self.group])):
                    self._lost(worker, selector)
                    workers[k] = worker = self._started(selector)
                    known[worker] = set()
                if not worker.busy and time.monotonic() < end:
                    kind = self._least_served()
                    first = self.seed + self.given[kind]
                    fresh = kind not in known[worker]
                    known[worker].add(kind)
                    count = max(1, int(BATCH[self.group] * self.kinds[kind]))
                    worker.give(self.group, kind, first, count, fresh)
                    self.given[kind] += count
            for key, _ in selector.select(timeout=0.5):
                self._hear(key.data)
            if time.monotonic() > end + CASE[self.group] * PATIENCE:
                break
        for worker in workers:
            worker.end_now()
        selector.close()
        return self._result(time.monotonic() - began)

    def _least_served(self) -> str:
        return min(self.kinds, key=lambda kind: self.given[kind] / self.kinds[kind])

    def _started(self, selector: selectors.BaseSelector) -> _Worker:
        worker = _Worker()
        assert worker.process.stdout is not None
        os.set_blocking(worker.process.stdout.fileno(), False)
        selector.register(worker.process.stdout, selectors.EVENT_READ, worker)
        return worker

    def _lost(self, worker: _Worker, selector: selectors.BaseSelector) -> None:
        """Counts the case at which a worker died or hung."""
        code = worker.process.poll()
        selector.unregister(worker.process.stdout)
        worker.end_now()
        if worker.busy:
            self._count(worker.kind, worker.next, "hang" if code is None else f"crash status {code}", 0.0)

    def _hear(self, worker: _Worker) -> None:
        assert worker.process.stdout is not None
        worker.buffer += worker.process.stdout.read() or b""
        *lines, worker.buffer = worker.buffer.split(b"\n")
        for line in lines:
            said = json.loads(line)
            worker.heard, worker.computed = time.monotonic(), worker.cpu()
            if "outcome" in said:
                worker.fresh, worker.next = False, said["seed"] + 1
                self._count(worker.kind, said["seed"], said["outcome"], said["seconds"])
            elif "done" in said:
                worker.busy = False

    def _count(self, kind: str, seed: int, outcome: str, seconds: float) -> None:
        word = outcome if outcome in FINE else outcome.split()[0]
        if self.group == "files" and seconds > CASE["files"]:
            word, outcome = "hang", f"hang {seconds:.0f} s"
        self.counts[kind][word] += 1
        self.slowest = max(self.slowest, seconds)
        self.computed += seconds
        if word not in FINE:
            self.faults.append({"kind": kind, "seed": seed, "outcome": outcome})

    def _result(self, seconds: float) -> dict[str, Any]:
        cases = sum(sum(count.values()) for count in self.counts.values())
        return {
            "cases": cases,
            "seconds": round(seconds, 1),
            "cpu_s": round(self.computed, 1),
            "slowest_s": round(self.slowest, 2),
            "kinds": {kind: dict(sorted(count.items())) for kind, count in sorted(self.counts.items())},
            "faults": self.faults,
        }

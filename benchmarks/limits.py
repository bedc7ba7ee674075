"""Limits of queries: by how much they exceed their time and their memory.

    python -m benchmarks.limits [--queries 200] [--seed 0] [--memory-queries 60]

**Time.** Each query has a random heuristic, map, pair of poses and limit of 0.1 - 5 s; some planners are fresh, some
have answered before, and some pairs have no plan. A second thread wakes at the limit and notes the CPU time of the
process. The overrun is the CPU time from then to the answer, so other work on the machine does not count; overruns by
the clock are printed as well. Compilation comes before the clock.

**Memory.** Each query runs in a new process on a planner whose own arrays are in memory already. The growth of the
resident memory at its peak is compared with the limit. 8 MB of it may be the allocator's and the libraries' own. Each
array is mapped by itself, so that holes between arrays in the allocator's heap, which no query holds, do not count.

The last line is JSON: `time_over`, the largest overrun as a share of the limit, and `time_over_ms`, the largest in
milliseconds among limits below 0.5 s, both in CPU time; `not_in_statistics_ms`, the longest part of a query that its
statistics leave out; `memory_over`, the largest share by which memory exceeds its limit.
"""

import argparse
import ctypes
import gc
import json
import multiprocessing
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np

from hdsp import HeightMap, InputError, Planner
from hdsp.planning.answers.plans import Plan
from hdsp.planning.compiled import warm_up
from hdsp.terrain.random_arenas import random_arena

LIMITS = 0.1, 0.2, 0.5, 1.0, 2.0, 5.0
HEURISTICS = "geometric", "grid", "manual", "learned"
#: Growth of a process that is none of its arrays, bytes.
OVERHEAD = 8 << 20
#: Option of ``mallopt``, and the size in bytes from which an array is mapped by itself.
_MMAP_THRESHOLD, _MAPPED = -3, 128 << 10
#: Below this limit, the bar is in milliseconds.
SHORT = 0.5


@dataclass(frozen=True)
class Kind:
    """Kind of a query: the planner's heuristic, and the way to ask."""

    name: str
    heuristic: str
    ask: Callable[[Planner, tuple, tuple, dict], Plan]


def planned(**options) -> Callable:
    return lambda planner, start, goal, limits: planner.plan(start, goal, **options, **limits)


def improved(planner: Planner, start: tuple, goal: tuple, limits: dict) -> Plan:
    *_, last = planner.improve(start, goal, **limits)
    return last


KINDS = (
    Kind("geometric", "geometric", planned(weight=1.25)),
    Kind("grid", "grid", planned(weight=1.25)),
    Kind("manual", "manual", planned()),
    Kind("learned", "learned", planned()),
    Kind("learned, refinable", "learned", planned(refinable=True)),
    Kind("learned, anchored", "learned", planned(weight=1.25, anchor_weight=1.1)),
    Kind("learned, improving", "learned", improved),
    Kind("geometric, improving", "geometric", improved),
    Kind("any feet at the goal", "manual", planned(tolerance=(0.3, 3.2))),
)


def walled(size: int) -> HeightMap:
    """Flat ground with a wall across."""
    heights = np.zeros((size, size), np.float32)
    heights[size // 2 : size // 2 + 4] = 1.0
    return HeightMap(heights)


MAPS: dict[str, Callable[[], HeightMap]] = {
    "5 m": lambda: random_arena(0, 5.0),
    "other 5 m": lambda: random_arena(3, 5.0),
    "10 m": lambda: random_arena(1, 10.0),
    "wall, 5 m": lambda: walled(200),
    "wall, 10 m": lambda: walled(400),
    "14 m": lambda: random_arena(2, 14.0),
}


def poses(planner: Planner, rng: np.random.Generator) -> list[tuple]:
    """A start and a goal that the robot can leave, on both halves of the map."""
    size = 0.025 * np.array(planner.grid.shape)
    found: list[tuple] = []
    while len(found) < 2:
        at = rng.uniform(0.1, 0.9, 2) * size
        at[0] = (at[0] + size[0] * len(found)) / 2
        pose = *at.tolist(), float(rng.uniform(-3, 3))
        if planner.can_leave(pose):
            found.append(pose)
    return found


@dataclass(frozen=True)
class Timed:
    """A query with a limit of time: its time by the clock, its CPU time beyond the limit, the time that it states."""

    kind: str
    map: str
    fresh: bool
    limit: float
    status: str
    wall: float
    late: float
    stated: float


def timed(planner: Planner, kind: Kind, name: str, ends: list[tuple], limit: float, fresh: bool) -> Timed:
    """Asks a query with a limit of time."""
    at_limit: list[float] = []
    watch = threading.Timer(limit, lambda: at_limit.append(time.process_time()))
    watch.start()
    began = time.perf_counter()
    plan = kind.ask(planner, *ends, {"time": limit})
    wall, cpu = time.perf_counter() - began, time.process_time()
    watch.cancel()
    late = cpu - at_limit[0] if at_limit else 0.0
    ended = plan.stats.ended or str(plan.status)
    return Timed(kind.name, name, fresh, limit, ended, wall, late, plan.stats.seconds)


def time_queries(count: int, rng: np.random.Generator) -> list[Timed]:
    """Asks queries of all kinds with random maps, poses and limits of time."""
    maps: dict[str, HeightMap] = {}
    planners: dict[tuple[str, str], Planner] = {}
    found = []
    for number in range(count):
        kind, name = KINDS[number % len(KINDS)], str(rng.choice(list(MAPS)))
        if name not in maps:
            maps[name] = MAPS[name]()
        place = name, kind.heuristic
        fresh = place not in planners or bool(rng.random() < 0.5)
        if fresh:
            planners[place] = Planner(maps[name], heuristic=kind.heuristic)
        planner = planners[place]
        warm_up(planner.robot, planner.heuristic)
        each = timed(planner, kind, name, poses(planner, rng), float(rng.choice(LIMITS)), fresh)
        print(
            f"{each.kind}, {each.map}, {'fresh' if fresh else 'warm'}: limit {each.limit} s, {each.status} after "
            f"{each.wall:.2f} s, {1e3 * each.late:.0f} ms of CPU time beyond",
            flush=True,
        )
        found.append(each)
    return found


def resident(peak: bool = False) -> int:
    """Resident memory of this process in bytes, now or at its peak."""
    name = "VmHWM:" if peak else "VmRSS:"
    with open("/proc/self/status") as lines:
        return next(int(line.split()[1]) << 10 for line in lines if line.startswith(name))


def query_growth(send: Connection, planner: Planner, ends: list[tuple], limit: int) -> None:
    """Asks a query in this new process; sends the growth of its memory at the peak, and the status."""
    # Code becomes resident where a process uses it first: the same query of another planner comes first.
    Planner(planner.terrain, heuristic=planner.heuristic.name).plan(*ends, weight=1.25, time=10.0, memory=limit)
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    with open("/proc/self/clear_refs", "w") as peak:
        peak.write("5")
    before = resident()
    plan = planner.plan(*ends, weight=1.25, time=10.0, memory=limit)
    send.send((resident(peak=True) - before, str(plan.status), plan.stats.total_memory))


def least_of(planner: Planner, ends: list[tuple]) -> int:
    """The least memory of a query, from the message of a smaller limit."""
    limit = 0
    while True:
        try:
            planner.plan(*ends, memory=limit, time=0.0)
        except InputError as error:
            *left, needed = (int(number) for number in re.findall(r"\d+", str(error)))
            limit = needed if "at least" in str(error) and "left" not in str(error) else limit + left[-1] - needed
        else:
            return limit


def memory_over(count: int, rng: np.random.Generator) -> float:
    """The largest share by which a query exceeds its limit of memory; 0 if none does."""
    ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _MAPPED)
    worst, processes = 0.0, multiprocessing.get_context("fork")
    for number in range(count):
        heuristic, name = HEURISTICS[number % len(HEURISTICS)], str(rng.choice(list(MAPS)))
        planner = Planner(MAPS[name](), heuristic=heuristic)
        warm_up(planner.robot, planner.heuristic)
        ends = poses(planner, rng)
        for array in planner.world:
            if isinstance(array, np.ndarray):
                array += array.dtype.type(0)  # writes each page
        limit = int(least_of(planner, ends) * rng.choice((1.0, 1.5, 3.0)))
        ctypes.CDLL(None).malloc_trim(0)  # freed memory of this process would serve the query
        receive, send = processes.Pipe(duplex=False)
        child = processes.Process(target=query_growth, args=(send, planner, ends, limit))
        child.start()
        growth, status, stated = receive.recv()
        child.join()
        worst = max(worst, (growth - OVERHEAD) / limit - 1)
        mb = 1 << 20
        print(
            f"{heuristic}, {name}: limit {limit / mb:.1f} MB, grew by {growth / mb:.1f} MB, stated "
            f"{stated / mb:.1f} MB, {status}",
            flush=True,
        )
    return worst


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--queries", type=int, default=200, help="with limits of time")
    parser.add_argument("--memory-queries", type=int, default=60, help="with limits of memory")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    # Memory first: its processes are copies of this one, before other threads and freed memory.
    memory = memory_over(arguments.memory_queries, np.random.default_rng(arguments.seed))
    times = time_queries(arguments.queries, np.random.default_rng(arguments.seed))
    long = [each.late / each.limit for each in times if each.limit >= SHORT]
    result = {
        "queries": len(times),
        "time_over": round(max(long, default=0.0), 3),
        "time_over_ms": round(max((1e3 * each.late for each in times if each.limit < SHORT), default=0.0), 1),
        "time_over_by_the_clock": round(max((each.wall / each.limit - 1 for each in times), default=0.0), 3),
        "not_in_statistics_ms": round(max((1e3 * (each.wall - each.stated) for each in times), default=0.0), 1),
        "memory_queries": arguments.memory_queries,
        "memory_over": round(memory, 3),
    }
    print(json.dumps(result))
    return result


if __name__ == "__main__":
    main()

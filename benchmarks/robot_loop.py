"""A planner in a robot's loop: gaps of another thread during a search, time to cancel it, frequency of the loop.

    python -m benchmarks.robot_loop [--seconds 3]

Another thread sleeps 5 ms at a time while a search runs. The last line is JSON: `gap_99_ms`, `gap_largest_ms`: time
between two wakes; `cancel_ms`: from `cancel` to the end of the query, the largest of ten; `loop_hz`: turns of
`examples.planning_loop` per second.
"""

import argparse
import json
import threading
import time

import numpy as np

from examples import planning_loop
from hdsp import HeightMap, Planner


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3.0)
    seconds = parser.parse_args(argv).seconds
    heights = np.zeros((400, 400), np.float32)
    heights[200:216, 8:] = 0.6  # a way round at the border alone, too narrow
    planner = Planner(HeightMap(heights), conditioning=None)
    gaps: list[float] = []
    delays: list[float] = []
    for _ in range(10):
        query = threading.Thread(target=planner.plan, args=((2.0, 5.0, 0.0), (8.0, 5.0, 0.0)))
        query.start()
        ends, before = time.perf_counter() + seconds / 10, time.perf_counter()
        while query.is_alive() and time.perf_counter() < ends:
            time.sleep(0.005)
            gaps.append(time.perf_counter() - before)
            before = time.perf_counter()
        began = time.perf_counter()
        planner.cancel()
        query.join()
        delays.append(time.perf_counter() - began)
    result = {
        "gap_99_ms": round(1e3 * float(np.quantile(gaps, 0.99)), 1),
        "gap_largest_ms": round(1e3 * max(gaps), 1),
        "cancel_ms": round(1e3 * max(delays), 1),
        "loop_hz": planning_loop.main()["hz"],
    }
    print(json.dumps(result))
    return result


if __name__ == "__main__":
    main()

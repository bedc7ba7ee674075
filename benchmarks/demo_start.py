"""CPU time of `hdsp demo` until the robot moves, with an empty cache of kernels and with a full one.

    python -m benchmarks.demo_start [--robot momaro]

The demo's viewer runs in a process of its own, without a browser. The last line is JSON: `demo_cpu_s` is the time of
the first process, from its start on, `demo_again_cpu_s` the time of a second one, which loads the kernels.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile

SCRIPT = """
import sys, time
from hdsp.planning.commands.view_command import demo_viewer
viewer = demo_viewer(sys.argv[1], 0)
viewer.answered.wait()
assert viewer.answer and viewer.answer.plan.solved, viewer.error
while viewer.playback.time == 0:
    time.sleep(0.01)
spent = time.process_time()
viewer.session.wait(600.0)  # kernels that a process compiles on its way out are not kept
viewer.close()
print(spent)
"""


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default="momaro")
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as kernels:
        first, again = (_cpu_seconds(kernels, arguments.robot) for _ in range(2))
    result = {"demo_cpu_s": round(first, 1), "demo_again_cpu_s": round(again, 1)}
    print(json.dumps(result))
    return result


def _cpu_seconds(kernels: str, robot: str) -> float:
    """CPU seconds of a process until the robot of its demo moves."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": kernels}
    command = [sys.executable, "-c", SCRIPT, robot]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return float(done.stdout.split()[-1])


if __name__ == "__main__":
    main()

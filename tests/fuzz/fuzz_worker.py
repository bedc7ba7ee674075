"""Worker of the fuzz suite: reads lines ``GROUP KIND SEED COUNT`` (_ for spaces), prints a JSON line for each case.

The address space of the process is limited, and a case that needs much more memory than those before it is a fault.
"""

import json
import resource
import sys
import time

#: Bytes that one case may add to the peak of the process.
MEMORY = 600 << 20
#: Bytes of address space beyond those at the start.
SPACE = 6 << 30


def _space() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[0]) * resource.getpagesize()


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def main() -> None:
    from tests.fuzz.groups import cases_of

    made = {}
    print(json.dumps({"ready": True}), flush=True)
    resource.setrlimit(resource.RLIMIT_AS, (_space() + SPACE, _space() + SPACE))
    for line in sys.stdin:
        group, kind, seed, count = line.split()
        cases = made.get((group, kind)) or made.setdefault((group, kind), cases_of(group, kind.replace("_", " ")))
        for number in range(int(seed), int(seed) + int(count)):
            before, began = _peak(), time.process_time()
            outcome = cases.outcome(number)
            if number > int(seed) and group == "files" and _peak() > before + MEMORY:
                outcome = f"memory {(_peak() - before) >> 20} MiB more"
            seconds = round(time.process_time() - began, 3)
            print(json.dumps({"seed": number, "outcome": outcome, "seconds": seconds}), flush=True)
        print(json.dumps({"done": True}), flush=True)


if __name__ == "__main__":
    main()

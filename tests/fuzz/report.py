"""Counts of a fuzz run on a page."""

from collections import Counter
from pathlib import Path

from benchmarks.page import table, write_block
from tests.fuzz.groups import FINE

_NAMES = {"files": "damaged files", "plans": "plans and labels", "updates": "sequences of map updates"}


def write_page(page: Path, result: dict) -> None:
    """Writes the counts of a run between their markers."""
    parts = [f"One run with seed {result['seed']} on {result['processes']} processes:"]
    rows = []
    for name, group in result["groups"].items():
        faults = len(group["faults"])
        times = f"{group['seconds']:,.0f} s", f"{group['cpu_s']:,.0f} s", f"{group['slowest_s']:.1f} s"
        rows.append([_NAMES[name], f"{group['cases']:,}", *times, faults])
    parts.append(table(["cases", "number", "time", "CPU time", "slowest (CPU)", "faults"], rows))
    for name, group in result["groups"].items():
        total: Counter = Counter()
        for counts in group["kinds"].values():
            total.update(counts)
        words = [word for word in (*FINE, *sorted(set(total) - set(FINE))) if total[word]]
        lines = [[kind, *(counts.get(word, 0) for word in words)] for kind, counts in group["kinds"].items()]
        parts.append(table([_NAMES[name], *words], lines))
    write_block(page, "tests.fuzz", "\n\n".join(parts))

"""`python -m pipeline.seconds`: how long each stage took when it last ran.

The times lie in data/seconds/, outside of everything that stages depend on.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hdsp.base.files import replacing

from .tables import markdown

PLACE = Path("data", "seconds")


@contextmanager
def timed(name: str, arguments: Sequence[str], folder: Path = PLACE) -> Iterator[None]:
    """Stores the duration of a stage that ends without an error."""
    begun = time.time()
    started = time.perf_counter()
    yield
    seconds = time.perf_counter() - started
    with replacing(folder / f"{'@'.join([name, *arguments])}.json") as path:
        path.write_text(json.dumps({"begun": begun, "seconds": round(seconds, 1)}) + "\n", encoding="utf-8")


def table(folder: Path = PLACE) -> str:
    """Returns a table of all stored durations, in the order in which the stages ran, and their sum."""
    rows = []
    for path in folder.glob("*.json"):
        stored = json.loads(path.read_text(encoding="utf-8"))
        rows.append((stored["begun"], path.stem, stored["seconds"]))
    shown = [(name, f"{seconds:.0f}") for _, name, seconds in sorted(rows)]
    return markdown(("stage", "seconds"), [*shown, ("all", f"{sum(seconds for *_, seconds in rows):.0f}")])


if __name__ == "__main__":
    print(table())

"""Results of trials: in a file, one line each, so that a later run goes on; and as a table on a page."""

import json
from collections import Counter
from pathlib import Path

import yaml

from benchmarks.page import table, write_block
from tests.mutants.changes import Mutant
from tests.mutants.trials import HANGS, KILLED, SURVIVED, Trial

#: Survivors that no test can kill, judged one by one: mutant and reason.
JUDGED = Path(__file__).with_name("equivalent.yaml")
EQUIVALENT = "equivalent"


class Results:
    """Trials so far, by mutant.

    Args:
        path: file; it need not exist.
    """

    def __init__(self, path: Path):
        self._path, self._trials = path, dict[tuple[str, str], Trial]()
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        for line in map(json.loads, lines):
            self._trials[line["mutant"], line["digest"]] = Trial(line["result"], line["seconds"])

    def of(self, mutant: Mutant) -> Trial | None:
        """The last trial of a mutant; None without one since its function was edited."""
        return self._trials.get((mutant.name, mutant.digest))

    def add(self, mutant: Mutant, trial: Trial) -> None:
        self._trials[mutant.name, mutant.digest] = trial
        self._path.parent.mkdir(parents=True, exist_ok=True)
        line = {"mutant": mutant.name, "digest": mutant.digest, "line": mutant.line, **trial._asdict()}
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def equivalent() -> dict[str, str]:
    """Reasons by mutant, for mutants that no test can kill."""
    return {name: why for why, names in yaml.safe_load(JUDGED.read_text(encoding="utf-8")).items() for name in names}


def summary(found: dict[str, tuple[int, list[tuple[Mutant, Trial]]]], seed: int) -> dict:
    """Counts and survivors by target.

    Args:
        found: by target, the number of all its mutants and the tried ones.
        seed: seed of the samples.
    """
    judged, targets = equivalent(), {}
    for target, (total, trials) in found.items():
        survivors = [mutant for mutant, trial in trials if trial.result == SURVIVED]
        counts = Counter(trial.result for _, trial in trials)
        alike = [mutant for mutant in survivors if mutant.name in judged]
        targets[target] = {
            "mutants": total, "tried": len(trials), "killed": counts[KILLED] + counts[HANGS], "hangs": counts[HANGS],
            EQUIVALENT: len(alike), "survivors": [mutant.name for mutant in survivors if mutant not in alike],
        }  # fmt: skip
    return {"seed": seed, "targets": targets}


def write_page(page: Path, result: dict) -> None:
    """Writes counts, survivors and judgements between their markers."""
    rows, survivors = [], []
    for target, counts in result["targets"].items():
        different = counts["tried"] - counts[EQUIVALENT]
        share = f"{counts['killed'] / different:.0%}" if different else None
        rows.append([
            f"`{target}`", counts["mutants"], counts["tried"], counts["killed"], counts[EQUIVALENT],
            len(counts["survivors"]), share,
        ])  # fmt: skip
        survivors += counts["survivors"]
    head = ["code", "mutants", "tried", "killed", "equivalent", "survived", "killed among those not equivalent"]
    parts = [f"A random sample with seed {result['seed']}:", table(head, rows)]
    if survivors:
        parts.append("Survivors:\n\n" + "\n".join(f"- `{name}`" for name in survivors))
    write_block(page, "tests.mutants", "\n\n".join(parts))

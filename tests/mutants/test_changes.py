"""Mutants of a small module, and what becomes of them."""

import sys
from types import ModuleType

import pytest

from tests.mutants import changes, results
from tests.mutants.changes import mutants_of
from tests.mutants.results import Results, summary, write_page
from tests.mutants.trials import KILLED, SURVIVED, Trial, exchange

SOURCE = '''
"""A module."""
LIMIT = 3

def first(values: list[int], least: int = 1) -> int:
    """Index of the first value above a limit."""
    for i in range(len(values)):
        if values[i] <= least and not values[i] > LIMIT:
            continue
        values[i] += 1
        return i
    raise ValueError(f"no value above {least + 1}")

class Counter:
    total = 0

    @property
    def twice(self):
        self.total = self.total * 2
        return self.total
'''
#: Changed lines.
EXPECTED = [
    "break", "if values[i] < least and (not values[i] > LIMIT):", "if values[i] <= least or not values[i] > LIMIT:",
    "if values[i] <= least and values[i] > LIMIT:", "if values[i] <= least and (not values[i] >= LIMIT):",
    "if not (values[i] <= least and (not values[i] > LIMIT)):", "pass", "values[i] -= 1", "values[i] += 2",
    "values[i] += 0", "return 0", "pass", "self.total = self.total + 2", "self.total = self.total * 3",
    "self.total = self.total * 1", "return 0",
]  # fmt: skip


@pytest.fixture
def sample(tmp_path, monkeypatch):
    """A module on its own, and all of its mutants."""
    (tmp_path / "mutated_sample.py").write_text(SOURCE)
    module = ModuleType("mutated_sample")
    exec(compile(SOURCE, "mutated_sample.py", "exec"), module.__dict__)
    monkeypatch.setitem(sys.modules, "mutated_sample", module)
    monkeypatch.setattr(changes, "ROOT", tmp_path)
    return module, mutants_of("mutated_sample.py")


def test_each_change_is_made_once_and_signatures_and_messages_stay(sample):
    _, found = sample
    assert len(found) == len(EXPECTED) == len({mutant.name for mutant in found})
    assert sorted(mutant.change.partition(" -> ")[2] for mutant in found) == sorted(EXPECTED)
    assert {mutant.function for mutant in found} == {"first", "Counter.twice"}
    for mutant in found:
        assert mutant.source() != SOURCE and "no value above" in mutant.source()


def test_a_mutant_takes_the_place_of_a_function_for_all_who_know_it(sample):
    module, found = sample
    known, counter = module.first, module.Counter()
    assert known([1, 2, 5]) == 1
    exchange(next(mutant for mutant in found if mutant.change.endswith("return 0") and mutant.function == "first"))
    assert known([1, 2, 5]) == 0
    counter.total = 5
    exchange(next(mutant for mutant in found if mutant.change.endswith("self.total * 3")))
    assert counter.twice == 15


def test_results_are_kept_counted_and_shown(sample, tmp_path, monkeypatch):
    _, found = sample
    kept = Results(tmp_path / "some" / "results.jsonl")
    for mutant, result in zip(found, [KILLED, SURVIVED, SURVIVED, *[KILLED] * 20], strict=False):
        kept.add(mutant, Trial(result, 0.5))
    again = Results(tmp_path / "some" / "results.jsonl")
    assert [again.of(mutant) for mutant in found] == [kept.of(mutant) for mutant in found]
    assert again.of(found[0]._replace(digest="of another text")) is None
    monkeypatch.setattr(results, "equivalent", lambda: {found[1].name: "why not"})
    result = summary({"sample": (40, [(mutant, kept.of(mutant)) for mutant in found])}, 7)
    counts = result["targets"]["sample"]
    assert (counts["tried"], counts["killed"], counts["equivalent"]) == (16, 14, 1)
    assert counts["survivors"] == [found[2].name]
    page = tmp_path / "page.md"
    page.write_text("<!-- written by tests.mutants: begin -->\n<!-- written by tests.mutants: end -->\n")
    write_page(page, result)
    assert "| `sample` | 40 | 16 | 14 | 1 | 1 | 93% |" in page.read_text() and found[2].name in page.read_text()


def test_judged_mutants_exist():
    files = {name.split()[0] for name in results.equivalent()}
    names = {mutant.name for file in files for mutant in mutants_of(file)}
    assert set(results.equivalent()) <= names

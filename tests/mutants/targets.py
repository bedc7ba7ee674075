"""Code under mutation, and the tests that should notice a change in it."""

from typing import NamedTuple

from tests import ROOT
from tests.mutants.changes import Mutant, mutants_of


class Target(NamedTuple):
    """A package or module.

    Attributes:
        path: from the root of the checkout.
        tests: tests on small maps, quick ones first.
        own: tests of single files, which take their place.
    """

    path: str
    tests: list[str]
    own: tuple[tuple[str, list[str]], ...] = ()

    def tests_of(self, file: str) -> list[str]:
        """Tests that should notice a change in a file."""
        return dict(self.own).get(file.rpartition("/")[2], self.tests)

    def files(self) -> list[str]:
        place = ROOT / self.path
        files = [place] if place.suffix else sorted(place.glob("*.py"))
        return [str(file.relative_to(ROOT)) for file in files]

    def sample(self, count: int, seed: int, only: str = "") -> tuple[list[Mutant], int]:
        """Some mutants in random order, or all with a text in their names; and the number of all."""
        found = [mutant for file in self.files() for mutant in mutants_of(file)]
        if only:
            return [mutant for mutant in found if only in mutant.name], len(found)
        return sorted(found, key=lambda mutant: mutant.rank(seed))[:count], len(found)


TARGETS = {
    target.path: target
    for target in (
        Target(
            "hdsp/detailed/search",
            ["tests/detailed/test_small_searches.py", "tests/detailed/test_store.py"],
            own=(
                ("free_space.py", ["tests/detailed/test_free_space.py"]),
                ("interpolation.py", ["tests/detailed/test_interpolation.py::test_the_kernel_equals_its_twin"]),
            ),
        ),
        Target("hdsp/detailed/actions", ["tests/detailed/test_small_actions.py"]),
        Target("hdsp/abstract/dijkstra.py", ["tests/abstract/test_bucket_ring.py"]),
    )
}

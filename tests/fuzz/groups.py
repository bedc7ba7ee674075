"""Groups of cases: for each its kinds with their shares, and the class that runs them."""

from collections.abc import Mapping
from typing import Protocol


class Cases(Protocol):
    """Cases of one kind, by seed."""

    def outcome(self, seed: int) -> str:
        """One word that says how the case ended, and further words for a fault."""


def kinds_of(group: str) -> Mapping[str, float]:
    """Kinds of a group with their shares."""
    if group == "files":
        from tests.fuzz.file_kinds import KINDS

        return {name: kind.share for name, kind in KINDS.items()}
    if group == "plans":
        from tests.fuzz.plan_cases import PLANS

        return PLANS
    from tests.fuzz.update_cases import HEURISTICS

    return HEURISTICS


def cases_of(group: str, kind: str) -> Cases:
    """Cases of a kind."""
    if group == "files":
        from tests.fuzz.file_cases import FileCases

        return FileCases(kind)
    if group == "plans":
        from tests.fuzz.plan_cases import PlanCases

        return PlanCases(kind)
    from tests.fuzz.update_cases import UpdateCases

    return UpdateCases(kind)


#: Outcomes that are as they should be; all others are faults.
FINE = ("read", "refused", "said", "equal", "solved", "no way", "compared", "limit")
GROUPS = ("files", "plans", "updates")

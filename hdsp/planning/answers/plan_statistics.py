"""Statistics of a planning query."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

from hdsp.base.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class PlanStatistics(Mapping[str, Any]):
    """Effort and proofs behind a plan.

    Attributes are the normal access, ``stats.expansions``. A mapping offers the same values, ``stats["expansions"]``.

    Attributes:
        heuristic: heuristic's name.
        weight: W in weighted A*.
        expansions: expanded states.
        seen: generated states.
        memory: bytes for states and open lists at the end.
        total_memory: bytes of everything that the query holds at the end of its search, its heuristic included.
        search_seconds: time in the search.
        proof_seconds: time in attempts to prove that no plan exists.
        lower_bound: no plan costs less; 0 without a proof.
        heuristic_seconds: time to prepare the heuristic for the goal.
        seconds: time for the whole query.
        anchor_weight: W2 in multi-heuristic A*; None without an anchor.
        expansions_by: expansions in the last search for the anchor and for the guide; None without an anchor.
        polish_seconds: time in the polish, see `hdsp.planning.polish`.
        polish_expansions: expanded states of the polish; not part of ``expansions``.
        unpolished_cost: cost of the plan before the polish; None without a polish.
        ended: final ``Status`` of an anytime search in words. None while it goes on, and for ``Planner.plan``.
    """

    heuristic: str
    weight: float
    expansions: int = 0
    seen: int = 0
    memory: int = 0
    total_memory: int = 0
    search_seconds: float = 0.0
    proof_seconds: float = 0.0
    lower_bound: float = 0.0
    heuristic_seconds: float = 0.0
    seconds: float = 0.0
    anchor_weight: float | None = None
    expansions_by: Mapping[str, int] | None = None
    polish_seconds: float = 0.0
    polish_expansions: int = 0
    unpolished_cost: float | None = None
    ended: str | None = None

    def __repr__(self) -> str:
        return short_repr(self)

    def __getitem__(self, name: str) -> Any:
        if name not in _NAMES:
            raise KeyError(name)
        return getattr(self, name)

    def __iter__(self) -> Iterator[str]:
        return iter(_NAMES)

    def __len__(self) -> int:
        return len(_NAMES)

    def known(self) -> dict[str, Any]:
        """Returns all values except None, for files."""
        return {name: value for name, value in self.items() if value is not None}

    def end(self, status: str, seconds: float | None = None) -> None:
        """Enters the end of an anytime search, and its time, known only after its last plan was yielded."""
        object.__setattr__(self, "ended", status)
        if seconds is not None:
            object.__setattr__(self, "seconds", seconds)


_NAMES = tuple(field.name for field in fields(PlanStatistics))

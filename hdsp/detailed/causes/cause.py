"""A cause of a failure: a kind, a place on the map, an amount, and its words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from hdsp.robot.robot import FEET

Place = tuple[float, float]


class Kind(StrEnum):
    """Kind of a cause; the amount of each kind is in brackets.

    - ``unknown``: the ground is unknown
    - ``border``: the place is off the map
    - ``edge``: no wheel passes an edge (largest height difference to a neighbouring cell, m)
    - ``slope``: the ground is too steep (inclination, rad)
    - ``body``: the body hits the ground (ground height, m)
    - ``reach``: a foot is out of its reach (offset from the neutral position, m)
    - ``separation``: two feet of one side are too close (distance, m)
    - ``heading``: the robot can be at the place, but cannot turn to a heading there (heading, rad)
    """

    UNKNOWN = "unknown"
    BORDER = "border"
    EDGE = "edge"
    SLOPE = "slope"
    BODY = "body"
    REACH = "reach"
    SEPARATION = "separation"
    HEADING = "heading"


@dataclass(frozen=True)
class Cause:
    """A cause of a failure. Convention: m, rad, world coordinates.

    Attributes:
        kind: the kind.
        place: (x, y), the centre of the cell that is unknown, an edge, too steep or hit by the body; for the kind
            ``border`` a point off the map; for the other kinds the base.
        amount: the amount, see ``Kind``; None for ``unknown`` and ``border``.
        limit: the robot's limit for the amount; None without one.
        foot: foot's name; None for the base and the body.
        foot_place: (x, y), the centre of the cell in which this foot cannot stand.
        pose: the state (x, y, theta, four foot offsets) that the cause makes invalid; None for a foot on its way.
    """

    kind: Kind
    place: Place
    amount: float | None = None
    limit: float | None = None
    foot: str | None = None
    foot_place: Place | None = None
    pose: tuple[float, ...] | None = None

    def __repr__(self) -> str:
        return f"Cause({self.kind}: {self})"

    def __str__(self) -> str:
        ground = self.label
        if self.kind in (Kind.BODY, Kind.REACH, Kind.SEPARATION, Kind.HEADING):
            return self._whole()
        if self.foot is None:
            return f"the base is at ({self.place[0]:.2f}, {self.place[1]:.2f}) m: {ground}"
        if self.foot_place is None:
            stops = "is too steep for" if self.kind == Kind.SLOPE else "stops"
            return f"{ground} at {_point(self.place)} {stops} the {self.foot} foot"
        words = f"the {self.foot} foot cannot stand at {_point(self.foot_place)}: "
        if self.kind == Kind.BORDER:
            return f"{words}{ground}"
        if self.kind == Kind.SLOPE:
            return f"{words}the ground is too steep there, {ground.removeprefix('a slope of ')}"
        return f"{words}{ground} " + ("there" if self.place == self.foot_place else f"at {_point(self.place)}")

    @property
    def label(self) -> str:
        """The cause in a few words, without its place."""
        amount, limit = self.amount or 0.0, self.limit or 0.0
        words = {
            Kind.UNKNOWN: "unknown ground",
            Kind.BORDER: "off the map",
            Kind.EDGE: f"an edge of {_centimetres(amount)}",
            Kind.SLOPE: f"a slope of {math.degrees(amount):.1f} degrees",
            Kind.BODY: f"ground at {amount:.2f} m hits the body",
            Kind.REACH: f"{self.foot} foot out of reach",
            Kind.SEPARATION: "feet too close",
            Kind.HEADING: f"no turn to {math.degrees(amount):.0f} degrees",
        }[self.kind]
        if self.kind == Kind.EDGE and limit:
            words += f" (wheels pass {_centimetres(limit)})"
        if self.kind == Kind.SLOPE and limit:
            words += f" (the robot takes {math.degrees(limit):.1f})"
        return words

    def _whole(self) -> str:
        amount, limit = self.amount or 0.0, self.limit or 0.0
        if self.kind == Kind.BODY:
            return f"the body would hit the ground that rises to {amount:.2f} m at {_point(self.place)}"
        if self.kind == Kind.REACH:
            return f"the {self.foot} foot is out of its reach: {amount:g} m from neutral, and {limit:g} m is the limit"
        if self.kind == Kind.SEPARATION:
            side = (self.foot or FEET[0]).rpartition("_")[2]
            return f"the {side} feet are too close to each other: {amount:.3f} m, and {limit:g} m are needed"
        degrees = math.degrees(amount)
        return f"the robot can be at {_point(self.place)}, but cannot turn to {degrees:.0f} degrees there"


def _point(place: Place) -> str:
    return f"({place[0]:.2f}, {place[1]:.2f}) m"


def _centimetres(length: float) -> str:
    return f"{100 * length:.3g} cm" if length < 1 else f"{100 * length:.0f} cm"

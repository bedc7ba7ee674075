"""Speed, picture rate and size of animations, as users give them."""

from __future__ import annotations

from typing import Any, NamedTuple

from hdsp.base.errors import InputError
from hdsp.base.messages import shown
from hdsp.base.scalars import integer, real

_SHOWN = 12.0  # s; an animation without a given speed lasts no longer
_FASTEST = 1000.0
_RATES = 0.1, 100.0
_LEAST_SIDE = 64  # pixels
_MOST_PICTURES = 10_000


class FilmSettings(NamedTuple):
    """Settings of an animation.

    Attributes:
        speed: motion seconds per animation second.
        fps: pictures per second.
    """

    speed: float
    fps: float

    @classmethod
    def of(cls, duration: float, speed: Any, fps: Any) -> FilmSettings:
        """Returns checked settings.

        Args:
            duration: duration of the motion, s.
            speed: as a user gives it; None: at least 1, for at most 12 s in all.
            fps: as a user gives it.

        Raises:
            InputError: a value out of range, or too many pictures.
        """
        rate = real(fps)
        if not _RATES[0] <= rate <= _RATES[1]:
            raise InputError(f"fps {shown(fps)}; need {_RATES[0]:g} to {_RATES[1]:g} pictures per second")
        if speed is None:
            return cls(max(1.0, duration / _SHOWN), rate)
        factor = real(speed)
        if not 0 < factor <= _FASTEST:
            raise InputError(f"speed {shown(speed)}; need a positive number, at most {_FASTEST:g}")
        count = duration / factor * rate
        if count > _MOST_PICTURES:
            words = f"need at most {_MOST_PICTURES:,}, by a higher speed or a lower fps"
            raise InputError(f"speed {factor:g}, fps {rate:g}: {count:,.0f} pictures; {words}")
        return cls(factor, rate)


def side(name: str, value: Any, most: int) -> int:
    """Returns the length of a picture's side, pixels.

    Raises:
        InputError: no whole number from 64 to ``most``.
    """
    found = integer(value)
    if found is None or not _LEAST_SIDE <= found <= most:
        raise InputError(f"{name} {shown(value)}; need a whole number of pixels, {_LEAST_SIDE} to {most}")
    return found

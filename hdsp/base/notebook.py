"""Pages and pictures of values in notebooks. Higher packages, which can draw, register the makers of pages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple


class NotebookView(NamedTuple):
    """Makers of a value's page and picture; each returns None where the package for pictures is missing.

    Attributes:
        html: page with a picture and a table.
        png: picture.
    """

    html: Callable[[Any], str | None]
    png: Callable[[Any], bytes | None]


_VIEWS: dict[type, NotebookView] = {}


def register_view(kind: type, view: NotebookView) -> None:
    """Registers the view of a class."""
    _VIEWS[kind] = view


def html_of(value: Any) -> str | None:
    """Returns the page of a value; None: the notebook shows the representation."""
    view = _VIEWS.get(type(value))
    return None if view is None else view.html(value)


def png_of(value: Any) -> bytes | None:
    """Returns the picture of a value as PNG; None: the notebook shows the representation."""
    view = _VIEWS.get(type(value))
    return None if view is None else view.png(value)

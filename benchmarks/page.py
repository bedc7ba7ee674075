"""Benchmark figures on pages in docs/: each benchmark writes the block between its own markers."""

from pathlib import Path

from hdsp.base.errors import InputError


def write_block(page: Path, author: str, text: str) -> None:
    """Writes ``text`` between the markers of ``author`` on a page.

    Raises:
        InputError: the page does not have exactly one pair of these markers.
    """
    begin, end = f"<!-- written by {author}: begin -->\n", f"<!-- written by {author}: end -->"
    shown = page.read_text()
    if shown.count(begin) != 1 or shown.count(end) != 1:
        raise InputError(f"{page}: need the marks {begin.strip()!r} and {end!r}, once each")
    before, rest = shown.split(begin)
    page.write_text(f"{before}{begin}{text.strip()}\n{end}{rest.split(end)[1]}")


def shown(heuristic: str | None) -> str | None:
    """Returns a heuristic's name in tables: the planner's `learned` is the shipped abstraction."""
    return "shipped" if heuristic == "learned" else heuristic


def table(head: list[str], rows: list[list]) -> str:
    """Formats a Markdown table; None becomes an empty field."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join("" if cell is None else str(cell) for cell in line) + " |" for line in lines)

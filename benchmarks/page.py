"""Numbers in pages of docs/: what stands between two marks was written by the benchmark that the marks name."""

from pathlib import Path

from hdsp.base.errors import InputError


def write_block(page: Path, author: str, text: str) -> None:
    """Put ``text`` between the marks of ``author`` in a page.

    Raises:
        InputError: the page does not have these marks once.
    """
    begin, end = f"<!-- written by {author}: begin -->\n", f"<!-- written by {author}: end -->"
    shown = page.read_text()
    if shown.count(begin) != 1 or shown.count(end) != 1:
        raise InputError(f"{page}: need the marks {begin.strip()!r} and {end!r}, once each")
    before, rest = shown.split(begin)
    page.write_text(f"{before}{begin}{text.strip()}\n{end}{rest.split(end)[1]}")


def table(head: list[str], rows: list[list]) -> str:
    """A table of a page; None becomes an empty field."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join("" if cell is None else str(cell) for cell in line) + " |" for line in lines)

"""Writes the tables of `reports/` into README.md and docs/results.md: `make publish`.

It is no stage, so that neither `dvc repro` nor an experiment changes a page.
"""

from __future__ import annotations

import sys
from pathlib import Path

from hdsp.base.errors import InputError
from hdsp.base.files import replacing

from .folders import project_root, read_json
from .headline import headline_table

TABLES = "<!-- tables: written by `make publish` -->", "<!-- end of tables -->"
HEADLINE = "<!-- headline: written by `make publish` -->", "<!-- end of headline -->"


def publish_pages(project: Path) -> None:
    """Writes both pages of a project.

    Raises:
        InputError: a report or a page's marker is missing.
    """
    reports = project / "reports"
    if not (reports / "tables.md").is_file():
        raise InputError(f"{reports / 'tables.md'} is missing; `make repro` makes it")
    quality, planning = (read_json(reports / f"{name}.json") for name in ("abstraction_quality", "planning"))
    put_between_markers(project / "docs/results.md", (reports / "tables.md").read_text(encoding="utf-8"), *TABLES)
    put_between_markers(project / "README.md", headline_table(quality, planning) + "\n", *HEADLINE)


def put_between_markers(page: Path, tables: str, begin: str, end: str) -> None:
    """Replaces the text between two markers on a page.

    Raises:
        InputError: the page lacks a marker.
    """
    text = page.read_text(encoding="utf-8")
    if begin not in text or end not in text:
        raise InputError(f"{page} lacks the markers {begin} and {end}, between which the tables go")
    before, rest = text.split(begin, 1)
    new = f"{before}{begin}\n\n{tables}\n{end}{rest.split(end, 1)[1]}"
    if new != text:
        with replacing(page) as path:
            path.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    try:
        publish_pages(project_root())
    except InputError as error:
        sys.exit(f"error: {error}")

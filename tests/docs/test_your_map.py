"""All blocks of docs/your-map.md run on small files of other libraries, and print the text that the page shows."""

import os
import re
import shlex
import warnings
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import NamedTuple

import numpy as np
import pytest

from hdsp import HeightMap
from hdsp.planning.cli import main
from hdsp.terrain.scans import find_files, load_scan
from tests import ROOT
from tests.docs.sample_maps import write_all

PAGE = ROOT / "docs/your-map.md"
_FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
REAL = "Real scans, one command each"


class Block(NamedTuple):
    """A block: its language, its lines, and the output that the page shows."""

    language: str
    code: str
    output: str


def blocks_of(page):
    """Blocks by section, in the order of a page; a text block is the output of the block before it."""
    found = {}
    for part in re.split(r"^## ", page, flags=re.MULTILINE):
        blocks = []
        for language, body in _FENCE.findall(part):
            if language == "text":
                blocks[-1] = blocks[-1]._replace(output=body)
            else:
                blocks.append(Block(language, body, ""))
        found[part.partition("\n")[0]] = blocks
    return found


SECTIONS = {title: blocks for title, blocks in blocks_of(PAGE.read_text()).items() if blocks}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    write_all(folder)
    (folder / "conf").symlink_to(ROOT / "conf")
    before = os.getcwd()
    os.chdir(folder)
    yield folder
    os.chdir(before)


def run_shell(code):
    """Output of the commands of a block, and their exit statuses."""
    said, statuses = StringIO(), []
    for line in code.splitlines():
        words = shlex.split(line, comments=True)
        if words[:2] == ["pip", "install"]:
            continue
        assert words[0] == "hdsp", line
        with redirect_stdout(said), redirect_stderr(said):
            statuses.append(main(words[1:]))
    return said.getvalue(), statuses


def run_python(code, names):
    said = StringIO()
    with redirect_stdout(said), warnings.catch_warnings():
        warnings.simplefilter("error")
        exec(compile(code, "block", "exec"), names)
    return said.getvalue()


def check_block(block, names, status=0):
    """Runs a block; its commands end with a status, and it prints the text that the page shows."""
    if block.language == "sh":
        printed, statuses = run_shell(block.code)
        assert statuses == [status] * len(statuses), printed
    else:
        printed = run_python(block.code, names)
    if expected := shown(block):
        assert matches(expected, printed), f"page:\n{expected}\nprinted:\n{printed}"
    else:
        assert block.language == "sh", f"prints without an output on the page: {printed}"


def shown(block):
    """Output that the page shows: its text block, or the comments behind its prints."""
    return block.output or "\n".join(re.findall(r"^print\(.*\)  # (.*)$", block.code, re.MULTILINE))


def matches(expected, printed):
    """Whether printed words are those on the page, where ... stands for any words."""
    pattern = r".*?".join(re.escape(" ".join(part.split())) for part in expected.split("..."))
    return re.fullmatch(pattern.replace(r"\ .*?", ".*?"), " ".join(printed.split())) is not None


def test_all_blocks_are_of_a_kind_that_runs():
    text = PAGE.read_text()
    assert text.count("```") == 2 * len(_FENCE.findall(text))
    assert {block.language for blocks in SECTIONS.values() for block in blocks} == {"sh", "python"}
    assert len(SECTIONS) >= 12 and "```text" in text


@pytest.mark.parametrize("title", [title for title in SECTIONS if title != REAL])
def test_blocks_run_and_print_what_the_page_shows(title, folder):
    names = {}
    for block in SECTIONS[title]:
        check_block(block, names, status=1 if title.startswith("Refused") else 0)


def test_each_real_scan_becomes_the_map_on_the_page(folder):
    text = PAGE.read_text()
    (block,) = SECTIONS[REAL]
    (pattern,) = re.findall(r"conf/scans/(\w+)\.yaml", block.code)
    assert pattern in scans()
    for name in scans():
        scan = load_scan(ROOT / f"conf/scans/{name}.yaml")
        if not os.environ.get("HDSP_DATA_DIR") or not find_files(scan)[0]:
            pytest.skip(f"no files of {name} in HDSP_DATA_DIR")
        printed, statuses = run_shell(block.code.replace(pattern, name))
        assert statuses == [0], printed
        assert row(scan) in text, row(scan)


def scans():
    return [path.stem for path in (ROOT / "conf/scans").glob("*.yaml") if path.stem != "default"]


def row(scan):
    """Row of the table for a scan."""
    terrain = HeightMap.load(f"{scan.name}.npz")
    known = terrain.heights[np.isfinite(terrain.heights)]
    length, width = terrain.size
    return (
        f"| `{scan.name}` | {scan.place} | {length:.1f} x {width:.1f} | {known.size / terrain.heights.size:.0%} | "
        f"{known.min():z.1f} to {known.max():z.1f} |"
    )

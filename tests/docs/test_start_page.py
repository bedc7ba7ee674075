"""The blocks of docs/start.md run on the sample files of docs/your-map.md, and print the text that the page shows."""

import re
import tomllib

import pytest

from tests import ROOT
from tests.docs.sample_maps import write_all
from tests.docs.test_your_map import blocks_of, check_block


@pytest.fixture(scope="module")
def sample_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("start")
    write_all(folder)
    return folder


PAGE = (ROOT / "docs/start.md").read_text()


@pytest.mark.parametrize("title", ["Ten lines on your map", "From the command line", "Your robot"])
def test_blocks_print_the_text_on_the_page(title, sample_folder, monkeypatch):
    monkeypatch.chdir(sample_folder)
    for block in blocks_of(PAGE)[title]:
        check_block(block, {})
    assert title != "Ten lines on your map" or (sample_folder / "path.png").is_file()


def test_every_extra_has_a_line():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = set(project["optional-dependencies"]) - {"all", "dev"}
    lines = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|", PAGE, re.MULTILINE)
    assert extras <= {name.strip("` ") for line in lines for name in line.split(",")}

"""CONTRIBUTING.md answers where things are; `test_paths` holds the paths of all pages."""

import re

from tests import ROOT


def test_each_question_is_answered_by_one_path_that_holds_the_name():
    rows = re.findall(
        r"^\| ([^|]+\?) \| `([^`|]+)` \| ([^|]+) \|$", (ROOT / "CONTRIBUTING.md").read_text(), re.MULTILINE
    )
    assert len(rows) == 10
    for question, path, answer in rows:
        assert (ROOT / path).exists(), question
        names = [name.split(".")[-1] for name in re.findall(r"`(\w[\w.]*)`", answer)]
        files = [path, *re.findall(r"`([\w/]+/\w+\.\w+)`", answer)]
        texts = [(ROOT / file).read_text() for file in files if "." in file]
        assert all(any(name in text for text in texts) for name in names), question

"""Pins, their hashes, and the verdict of an audit."""

import re

import pytest

from tests import ROOT
from tools.audit import verdict
from tools.hashes import lines_of, pins


def test_hashes_are_those_of_the_pins():
    hashed, wanted = (pins((ROOT / f"constraints{part}.txt").read_text()) for part in ("-hashes", ""))
    assert hashed.keys() == wanted.keys(), "run `make hashes`"
    lines = [line for line in (ROOT / "constraints-hashes.txt").read_text().splitlines() if not line.startswith("#")]
    assert all(re.search(r" --hash=sha256:[0-9a-f]{64}(  #|$)", line) for line in lines)


def installed(name, **hashes):
    return {"metadata": {"name": name, "version": "1"}, "download_info": {"archive_info": {"hashes": hashes}}}


def test_lines_have_hashes_or_none_is_written():
    lines = lines_of({"install": [installed("a", sha256="1" * 64)]})
    assert lines == [f"a==1 --hash=sha256:{'1' * 64}"]
    with pytest.raises(SystemExit, match="no hash for b"):
        lines_of({"install": [installed("b")]})


def test_an_audit_without_advisories_says_so():
    good, skipped = {"name": "a", "version": "1", "vulns": []}, {"name": "b", "skip_reason": "not found"}
    bad = {"name": "c", "version": "1", "vulns": [{"id": "X-1", "fix_versions": ["2"]}]}
    assert verdict({"dependencies": [good]}) == (0, ["no known vulnerability in 1 packages"])
    status, (line,) = verdict({"dependencies": [good, skipped]})
    assert status == 2 and line.startswith("not audited: no advisories were reached for 1 of 2 packages")
    assert verdict({"dependencies": [bad, skipped]})[0] == 1
    assert "c 1: X-1, mended in 2" in verdict({"dependencies": [bad]})[1]

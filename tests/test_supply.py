"""Pins, their hashes, and the verdict of an audit."""

import re

import pytest

from tests import ROOT
from tools.audit import verdict
from tools.hashes import lock


def pins(name):
    lines = (ROOT / name).read_text().splitlines()
    found = [re.match(r"([\w.-]+)==(\S+)", line) for line in lines if line and not line.startswith("#")]
    return {re.sub(r"[-_.]+", "-", pin[1]).lower(): pin[2].partition("+")[0] for pin in found}


def test_hashes_are_those_of_the_pins():
    assert pins("constraints-hashes.txt") == pins("constraints.txt"), "run `make hashes`"
    lines = [line for line in (ROOT / "constraints-hashes.txt").read_text().splitlines() if not line.startswith("#")]
    assert all(re.search(r" --hash=sha256:[0-9a-f]{64}(  #|$)", line) for line in lines)


def installed(name, **hashes):
    return {"metadata": {"name": name, "version": "1"}, "download_info": {"archive_info": {"hashes": hashes}}}


def test_a_lock_names_all_hashes_or_is_not_written():
    text = lock({"install": [installed("b", sha256="2" * 64), installed("A", sha256="1" * 64)]})
    assert text.splitlines()[2:] == [f"A==1 --hash=sha256:{'1' * 64}", f"b==1 --hash=sha256:{'2' * 64}"]
    with pytest.raises(SystemExit, match="no hash for b"):
        lock({"install": [installed("b")]})


def test_an_audit_without_advisories_says_so():
    good, skipped = {"name": "a", "version": "1", "vulns": []}, {"name": "b", "skip_reason": "not found"}
    bad = {"name": "c", "version": "1", "vulns": [{"id": "X-1", "fix_versions": ["2"]}]}
    assert verdict({"dependencies": [good]}) == (0, ["no known vulnerability in 1 packages"])
    status, (line,) = verdict({"dependencies": [good, skipped]})
    assert status == 2 and line.startswith("not audited: no advisories were reached for 1 of 2 packages")
    assert verdict({"dependencies": [bad, skipped]})[0] == 1
    assert "c 1: X-1, mended in 2" in verdict({"dependencies": [bad]})[1]

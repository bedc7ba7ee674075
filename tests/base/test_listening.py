"""Nothing listens on other addresses than 127.0.0.1 unless asked, and an open scheduler is said."""

import os
import re
import warnings
from pathlib import Path

import pytest

from hdsp.base.workers import ClusterSettings, _warn_of_open, connected
from tests import ROOT


def tree(process: int) -> list[int]:
    """A process and all below it."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
    found = [process]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found


def listening(process: int) -> set[str]:
    """Addresses, in hexadecimal digits, on which a process and all below it listen for TCP."""
    sockets = set()
    for one in tree(process):
        try:
            for link in Path(f"/proc/{one}/fd").iterdir():
                found = re.fullmatch(r"socket:\[(\d+)\]", os.readlink(link))
                sockets |= {found[1]} if found else set()
        except OSError:
            continue
    addresses = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in sockets:
                addresses.add(fields[1].partition(":")[0])
    return addresses


LOCAL = {"0100007F"}


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs /proc")
def test_local_workers_their_dashboard_and_the_viewer_listen_on_this_machine_alone():
    from hdsp.viz.viewer import open_server

    with connected(ClusterSettings(1, dashboard="127.0.0.1:0"), jobs=1):
        assert listening(os.getpid()) == LOCAL
        server = open_server()
        try:
            assert listening(os.getpid()) == LOCAL
        finally:
            server.stop()


@pytest.mark.parametrize(
    ("scheduler", "is_open"),
    [
        (None, False), ("tcp://127.0.0.1:8786", False), ("tcp://localhost:8786", False), ("tcp://[::1]:8786", False),
        ("tls://node7:8786", False), ("tcp://node7:8786", True), ("ws://10.0.0.7:8786", True), ("slurm", True),
    ],
)  # fmt: skip
def test_a_scheduler_open_to_a_network_is_said(scheduler, is_open):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        _warn_of_open(scheduler)
    assert [str(warning.message).startswith("the Dask scheduler ") for warning in said] == [True] * is_open


def test_no_code_asks_for_all_addresses():
    for path in (*ROOT.glob("hdsp/**/*.py"), *ROOT.glob("pipeline/**/*.py"), *ROOT.glob("conf/**/*.yaml")):
        assert "0.0.0.0" not in path.read_text(encoding="utf-8"), path

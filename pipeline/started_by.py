"""Processes by a name that stays unique on a machine, so that work of a killed process is recognised."""

from __future__ import annotations

import os
import socket
from pathlib import Path


def this_process() -> str:
    """Returns the machine's name, the process number, and the time at which the process began (ticks since boot)."""
    return f"{socket.gethostname()}:{os.getpid()}:{_began(os.getpid())}"


def has_ended(process: str) -> bool:
    """Whether a process of this machine, named by `this_process`, has ended; False for those of other machines."""
    host, _, rest = process.partition(":")
    number, _, began = rest.partition(":")
    return host == socket.gethostname() and number.isdigit() and _began(int(number)) != began


def _began(number: int) -> str:
    try:
        stat = Path(f"/proc/{number}/stat").read_text(encoding="utf-8")
    except OSError:
        return ""
    return stat.rpartition(")")[2].split()[19]  # the name before may hold blanks

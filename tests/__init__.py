"""Tests, in folders named like the packages under test."""

import signal
from pathlib import Path

#: Root folder of the checkout.
ROOT = Path(__file__).resolve().parents[1]


def heed_interrupts() -> None:
    """Lets a new process end at Ctrl-C, also where the tests run in the background, which ignores it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)

"""Tests, in folders named like the packages under test."""

from pathlib import Path

#: Root folder of the checkout.
ROOT = Path(__file__).resolve().parents[1]

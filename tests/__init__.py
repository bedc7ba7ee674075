"""Tests, in the folders of the packages that they test."""

from pathlib import Path

#: The checkout.
ROOT = Path(__file__).resolve().parents[1]

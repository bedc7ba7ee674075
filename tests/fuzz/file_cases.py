"""Cases of damaged files: a kind and a seed give one file and one outcome."""

import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from tests.fuzz.file_kinds import KINDS, FileKind
from tests.fuzz.mutations import damaged


class FileCases:
    """All cases of one kind of file; the whole file is written once."""

    def __init__(self, name: str):
        self.kind: FileKind = KINDS[name]
        self.number = sorted(KINDS).index(name)
        self.folder = tempfile.TemporaryDirectory(prefix="hdsp-fuzz-")
        self.path = self.kind.write(Path(self.folder.name))
        self.whole = self.path.read_bytes()
        self.contents = self.kind.read(self.path)

    def content(self, seed: int) -> bytes:
        """The damaged file of a seed."""
        random = np.random.default_rng([self.number, seed])
        if self.kind.inside is not None and random.random() < 0.5:
            with np.errstate(all="ignore"):
                return self.kind.inside(self.whole, random)
        return damaged(self.whole, random)

    def outcome(self, seed: int) -> str:
        """``read``, ``refused``, ``said`` (a note on a change), or a fault.

        Faults are ``wrong``, ``lines``, ``memory`` and ``traceback``, with words behind them.
        """
        self.path.write_bytes(self.content(seed))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                return self._judged(self.kind.read(self.path))
            except InputError as error:
                return _of_refusal(str(error))
            except Exception as error:
                return f"traceback {type(error).__name__}: {' '.join(str(error).split())[:150]}"

    def _judged(self, contents: Any) -> str:
        if self.kind.exact and contents != self.contents:
            if "differs from its checksum" in repr(contents):
                return "said"
            return "wrong: other contents than the whole file's, and no word"
        return "read"


def _of_refusal(words: str) -> str:
    if "\n" in words or not words:
        return f"lines {words[:200]!r}"
    return f"memory {words[:200]}" if "more memory than there is" in words else "refused"

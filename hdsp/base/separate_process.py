"""A library in a separate process with limits for memory and time: it may abort or hang on damaged input.

The process gets bytes or a path, and hands back one array of numbers in a private temporary folder; nothing is
unpickled.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

#: Seconds of waiting per CPU second, because other processes may hold the cores.
_PATIENCE = 10
#: Threads of numerical libraries, each of which takes address space.
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")


def array_from_process(program: Path, content: bytes, memory: int, seconds: int, options: Sequence[str] = ()):
    """Runs a program as ``python PROGRAM RESULT.npy MEMORY SECONDS OPTIONS...`` with ``content`` as standard input.

    Args:
        program: Python file, which imports no module of this package, limits itself first, and saves an array.
        content: standard input.
        memory: limit in bytes for the address space of the process.
        seconds: limit of CPU time.
        options: further arguments.

    Returns:
        The array.

    Raises:
        ValueError: the program ended otherwise; with its last line, its signal, or the limit of time.
    """
    environment = {**os.environ, **dict.fromkeys(_ONE_THREAD, "1"), "PYTHONPATH": os.pathsep.join(sys.path)}
    with TemporaryDirectory(prefix="hdsp-") as folder:
        result = Path(folder) / "result.npy"
        environment["TMPDIR"] = folder  # a process that is ended leaves its temporary files
        # -P: names beside the program, such as text.py, do not hide modules of libraries.
        command = [sys.executable, "-P", str(program), str(result), str(memory), str(seconds), *options]
        try:
            done = subprocess.run(
                command, input=content, capture_output=True, timeout=_PATIENCE * seconds, env=environment, check=False
            )
        except subprocess.TimeoutExpired:
            raise ValueError(f"damaged: not read within {_PATIENCE * seconds} s") from None
        if done.returncode == 0:
            return np.load(result, allow_pickle=False)
    raise ValueError(_reason(done.returncode, done.stderr.decode("utf-8", "replace"), seconds))


def _reason(code: int, words: str, seconds: int) -> str:
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        return f"damaged: not read within {seconds} s of computing"
    if code < 0:
        return f"damaged: its reader ended with {signal.Signals(-code).name}"
    return " ".join((words.strip().splitlines() or ["its reader failed"])[-1].split())

"""Silence belongs to one thread, and leaves no trace in the process."""

import sys
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import pytest
import rasterio

from hdsp.base.quiet import quiet_thread
from hdsp.terrain.height_map import HeightMap


@contextmanager
def process_state_kept():
    """Filters and hooks are the same after a block."""
    before = sys.excepthook, sys.unraisablehook, warnings.showwarning, list(warnings.filters)
    yield
    assert (sys.excepthook, sys.unraisablehook, warnings.showwarning, list(warnings.filters)) == before


@pytest.fixture
def heard(monkeypatch):
    """Everything that the process shows: names of hooks and texts of warnings."""
    found = []
    monkeypatch.setattr(sys, "excepthook", lambda kind, *_: found.append(f"error {kind.__name__}"))
    monkeypatch.setattr(sys, "unraisablehook", lambda details: found.append(f"unraisable {details.exc_type.__name__}"))
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *_, **__: found.append(f"warning {message}")
        yield found


class FailsAtItsEnd:
    def __del__(self):
        raise ValueError


def speak(words):
    warnings.warn(words, stacklevel=1)
    FailsAtItsEnd()
    sys.excepthook(RuntimeError, RuntimeError(), None)


def elsewhere(work, *arguments):
    thread = threading.Thread(target=work, args=arguments)
    thread.start()
    thread.join()


def test_a_quiet_thread_is_silent_and_others_speak(heard):
    with process_state_kept():
        with quiet_thread():
            speak("hidden")
            with quiet_thread():
                speak("hidden, too")
            speak("still hidden")
            elsewhere(speak, "shown")
        assert heard == ["warning shown", "unraisable ValueError", "error RuntimeError"]
        speak("again")
    assert heard[3:] == ["warning again", "unraisable ValueError", "error RuntimeError"]


def test_a_quiet_thread_raises_no_warning_as_an_error():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with quiet_thread():
            warnings.warn("hidden", stacklevel=1)
        with pytest.raises(UserWarning, match="shown"):
            warnings.warn("shown", stacklevel=1)


@pytest.mark.parametrize("first", [0, 1])
def test_threads_whose_quiet_blocks_overlap_leave_the_process_as_it_was(heard, first):
    blocks = quiet_thread(), quiet_thread()
    with process_state_kept():
        for block in blocks:
            elsewhere(block.__enter__)
        speak("of a third thread")
        for block in (blocks[first], blocks[1 - first]):
            elsewhere(block.__exit__, None, None, None)
    assert len(heard) == 3


def test_code_that_restores_filters_and_hooks_amid_a_quiet_block_silences_nobody(heard):
    block, filters = quiet_thread(), warnings.catch_warnings()
    elsewhere(block.__enter__)
    filters.__enter__()
    hooks = sys.excepthook, sys.unraisablehook
    elsewhere(block.__exit__, None, None, None)
    filters.__exit__(None, None, None)
    sys.excepthook, sys.unraisablehook = hooks
    speak("shown")
    assert heard == ["warning shown", "unraisable ValueError", "error RuntimeError"]
    with quiet_thread():
        speak("hidden")
    assert len(heard) == 3


def test_threads_that_load_maps_leave_hooks_and_filters_as_they_were(tmp_path, heard):
    heights = np.arange(12, dtype=np.float32).reshape(3, 4)
    HeightMap(heights).save(tmp_path / "own.tif")
    with rasterio.open(tmp_path / "bare.tif", "w", driver="GTiff", width=3, height=4, count=1, dtype="float32") as file:
        file.write(heights.T[::-1], 1)
    rows = "\n".join(" ".join(map(str, row)) for row in heights.T[::-1])
    (tmp_path / "grid.asc").write_text(f"ncols 3\nnrows 4\nxllcorner 0\nyllcorner 0\ncellsize 1\n{rows}\n")
    heard.clear()  # rasterio warns of the bare file
    interval = sys.getswitchinterval()

    def load(name):
        options = {"resolution": 1.0} if name == "bare.tif" else {}
        return HeightMap.load(tmp_path / name, **options).heights

    try:
        sys.setswitchinterval(1e-5)
        with process_state_kept(), ThreadPoolExecutor(4) as pool:
            found = list(pool.map(load, ["own.tif", "bare.tif", "grid.asc"] * 20))
    finally:
        sys.setswitchinterval(interval)
    assert all(np.array_equal(each, heights) for each in found)
    assert heard == []
    speak("shown")
    assert len(heard) == 3

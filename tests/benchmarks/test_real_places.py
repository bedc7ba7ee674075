"""On scans of real places, every answer is a motion, or names causes that the map bears out."""

import pytest

from benchmarks import real_places
from hdsp.terrain.scans import find_files, load_scan

NAMES = sorted(path.stem for path in real_places.SCANS.glob("*.yaml") if path.stem != "default")


@pytest.mark.pipeline
@pytest.mark.parametrize("name", NAMES)
def test_answers_on_a_real_place(name):
    paths, reason = find_files(load_scan(real_places.SCANS / f"{name}.yaml"))
    if not paths:
        pytest.skip(reason)
    place = real_places.main(["--pairs", "6", "--seed", "1", "--time", "10", "--only", name])["places"][name]
    assert place["wrong"] == 0
    # Ten seconds are few on a busy machine; the benchmark gives thirty.
    assert place["moved"] + place["caused"] >= 4

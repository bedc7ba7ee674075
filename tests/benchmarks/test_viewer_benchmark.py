"""The benchmark of the viewer: from its command line to the figures."""

import json

from benchmarks.viewer import main
from hdsp import HeightMap


def test_drags_on_a_small_map_are_timed(capsys, monkeypatch):
    monkeypatch.setattr("hdsp.terrain.random_arena", lambda seed, size: HeightMap.flat((120, 120)))
    result = main(["--drags", "2", "--size", "3", "--heuristics", "manual"])
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == result
    assert result["drags"] == 2 and result["size_m"] == 3
    assert 0 < result["drag_to_path_ms"] <= result["longest_ms"]
    assert "learned_drag_to_path_ms" not in result

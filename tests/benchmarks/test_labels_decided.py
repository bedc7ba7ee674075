"""No cap of the search decides a label, on level ground and on slopes."""

from benchmarks import labels_decided
from hdsp.abstract import oracle


def test_no_cap_decides_a_label(monkeypatch):
    monkeypatch.setattr(oracle, "solve", oracle.solve)  # restored afterwards; the benchmark counts its expansions
    result = labels_decided.main(["--maps", "34"])
    assert result["categories"] == 17 and result["maps_kept"] > 15
    assert result["tasks"] == 22 * result["maps_kept"] and result["share_per_reason"]["solved"] > 0.2
    assert result["capped_share"] == 0 and result["most_expansions"] > 0

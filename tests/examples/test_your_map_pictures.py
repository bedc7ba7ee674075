"""The pictures of docs/your-map.md: conditioning comes close to the true ground, and the cause lies at its place."""

from examples import your_map


def test_both_pictures_show_their_result(tmp_path):
    found = your_map.run(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["conditioned_map.png", "no_plan.png"]
    assert found["median_error_cm"] < 100 * your_map.NOISE / 4
    assert found["status"] == "infeasible"
    (cause,) = found["causes"]
    assert cause["kind"] == "unknown"
    x, y = cause["place"]
    assert abs(x - 3.0875) < 0.02 and 1.4 < y < 2.6  # the first unseen cells behind the door
    report = your_map.measured_map().conditioned().report
    assert report.spikes and report.filled and report.unknown == 0

"""The benchmark of a million maps: its extrapolation and its table."""

from benchmarks import million_maps


def test_needs_grow_along_the_line_through_both_runs_and_never_shrink():
    assert million_maps.along_a_line((100_000, 1_000_000), (3.0, 4.0)) == 14.0
    assert million_maps.along_a_line((100_000, 1_000_000), (4.0, 3.0)) == 4.0


def test_the_page_has_a_row_for_each_need_and_names_the_load():
    names = ("restart_s", "restart_cpu_s", "load", "resume_s", "disk_gb", "shards_of_stand_in_maps_per_s")
    far = dict.fromkeys(("memory_gb", "restart_cpu_s", "epoch_hours", "true_core_hours", "disk_gb"), 7)
    result = dict.fromkeys(names, 3.0) | {"maps": 1_000_000, "maps_per_s": 1000.0, "ten_million": far}
    result["memory_by_process_gb"] = {"label": 0.2, "train": 0.7}
    result["memory_growth_in_the_epoch_gb"] = 0.01
    text = million_maps.text(result | {"true_labels_maps_per_s_and_core": 20.0})
    lines = text.splitlines()
    assert lines[0] == "|  | 1,000,000 maps | ten million, extrapolated |"
    assert "| restart of the labels, s at a load of 3.0 | 3.0 |  |" in lines
    assert "| an epoch of the small network, hours | 0.28 | 7 |" in lines and "1,000 maps per second" in lines[-1]

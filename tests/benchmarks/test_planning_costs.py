from benchmarks import planning_costs


def test_labels_cost_more_than_plans_and_the_factor_brings_them_near(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "<!-- written by benchmarks.planning_costs: begin -->\n<!-- written by benchmarks.planning_costs: end -->\n"
    )
    arguments = ["--seeds", "1000", "1001", "--size", "5", "--states", "12", "--page", str(page)]
    result = planning_costs.main(arguments)
    assert result["states"] == 24 and result["actions"] > 100
    assert 1.02 < result["label_over_planning_mean"] < result["label_over_planning_max"] < 2
    # Two dozen states; with many, two thirds of the error vanish.
    assert result["corrected_error"] < 0.7 * result["label_over_planning_error"]
    assert page.read_text().count("\n| ") == 7 and "| oblique |" in page.read_text()

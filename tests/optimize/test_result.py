import json
from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf


@pytest.fixture(scope="module")
def result():
    data = {"x": [0.0, 1.0, 2.0], "y": [1.0, 3.0, 5.0]}
    return kf.calibrate(
        "scalar c\nm = a + b * x", data, {"a": 0.0, "b": 0.0, "c": 9.0}, target="y", test={"x": [1.0], "y": [3.0]}
    )


def test_json_has_the_documented_keys(result):
    contents = result.as_json()
    assert list(contents) == [
        *("status", "message", "iterations", "evaluations", "cost", "seconds", "values", "certificate", "quality"),
        *("recordings", "starts", "resumed", "trust", "smoothness", "shifts", "warnings"),
    ]
    assert list(contents["cost"]) == ["before", "after"]
    assert list(contents["seconds"]) == ["total", "read", "compile", "optimize"]
    assert contents["values"] == {"free": 2, "fixed": 1}
    assert [list(row) for row in contents["quality"]] == 2 * [
        ["criterion", "dataset", "use", "samples", "rmse_before", "rmse_after", "r2_after", "max_abs_after"]
    ]


def test_json_is_strict(result):
    text = json.dumps(result.as_json(), allow_nan=False)
    assert json.loads(text)["status"] == "converged"


def test_numbers_that_are_not_finite_become_null(result):
    assert np.isnan(result.quality[1].r2_after)
    assert result.as_json()["quality"][1]["r2_after"] is None


def test_the_text_has_the_message_and_a_line_for_each_dataset(result):
    head, titles, training, test, *values = str(result).splitlines()
    assert head.startswith("converged: ")
    assert titles.split()[:4] == ["criterion", "dataset", "use", "samples"]
    assert "training" in training
    assert "test" in test
    assert [line.split()[:2] for line in values] == [["parameter", "value"], ["a", "1"], ["b", "2"]]


def test_the_repr_of_a_result_and_of_its_residuals_is_short(result):
    assert repr(result).startswith("Result('converged', ParameterSet(")
    assert f"RMSE of m on training {result.quality[0].rmse_after:.4g}" in repr(result)
    assert len(repr(result.residuals())) < 1000


def test_a_notebook_shows_a_table(result):
    shown = result._repr_html_()
    assert shown.count("<tr>") == 3
    assert "<b>converged</b>" in shown


def test_names_are_escaped_in_a_notebook():
    data = kf.Dataset.of("<b>bench</b>", {"x": [1.0], "y": [2.0]})
    assert "<b>bench" not in kf.calibrate("m = a * x", data, {"a": 0.0}, target="y")._repr_html_()


def test_costs_include_roughness_and_before_is_at_the_start_as_given():
    start = kf.ParameterSet([kf.Curve("C", [0, 1, 2], [0.0, 5.0, 0.0], upper=1.0)])
    data = {"x": [0.0, 1.0, 2.0], "y": [0.0, 0.0, 0.0]}
    fit = kf.calibrate("m = C(x)", data, start, target="y", smoothness=3.0)
    assert fit.cost_before == pytest.approx(25 + 3 * (10**2) / 3)
    assert fit.start == start


def test_seconds_are_parts_of_the_whole(result):
    seconds = result.seconds
    assert 0 <= seconds.compile <= seconds.total
    assert 0 <= seconds.optimize <= seconds.total


def test_a_converged_result_has_the_cost_of_its_last_iteration(result):
    assert result.converged
    assert result.trace[-1].cost == result.cost_after


def test_a_result_simulates_the_data_of_the_fit_and_others(result):
    training, test = result.simulate()
    assert (training.name, test.name) == ("training", "test")
    np.testing.assert_allclose(training["m"].values, [1.0, 3.0, 5.0])
    np.testing.assert_allclose(result.simulate({"x": [10.0]})["m"].values, [21.0])


def test_a_result_has_its_residuals(result):
    (rows,) = result.residuals(worst=2)
    assert rows.criterion == "m"
    assert len(rows.worst) == 2


def test_a_frame_has_a_row_for_each_value_with_its_deviation(result):
    pytest.importorskip("pandas")
    frame = result.to_frame().set_index("parameter")
    assert frame.loc["a", "value"] == pytest.approx(1)
    assert frame.loc["a", "start"] == 0
    assert frame.loc["a", "samples"] == result.trust.samples["a"] == 3
    assert np.isnan(frame.loc["c", "deviation"])


def test_a_result_without_its_data_asks_for_the_problem(result):
    stripped = replace(result, inspection=None)
    with pytest.raises(kf.ArgumentError, match=r"Pass problem=project.problem\(\)"):
        stripped.residuals()
    assert stripped.residuals(problem=result.inspection.problem)[0].criterion == "m"

"""Truth tables, as functions of a chart in both languages and as a block."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from tests.importers.simulink.chart_runs import IO, U, V, drawn_chart
from tests.importers.simulink.simulink_files import Chart
from tests.importers.simulink.simulink_runs import imported, run

# the first decision that agrees counts: u > 0 and v > 0; u > 0; v > 0; any
RULES = [
    ["positive", "WARM:\nu > 0", "T", "T", "-", "-"],
    ["", "v > 0", "T", "F", "T", "-"],
    ["", "Actions", "2", "3,RAISE", "1", "1;1"],
]
ACTIONS = {
    "C": [["", "y = 1;"], ["", "y = 2;\nn = n + 1;"], ["", "y = u * v;"], ["", "RAISE:\ny += 5;"]],
    "MATLAB": [["", "y = 1;"], ["", "y = 2;\nn = n + 1;"], ["", "% both\ny = u * v;"], ["", "RAISE:\ny = y + 5;"]],
}
SHARED = [("u", "INPUT_DATA"), ("v", "INPUT_DATA"), ("y", "OUTPUT_DATA"), ("n", "OUTPUT_DATA")]


def expected(u, v):
    """Values of y and n over the samples, by the rules in plain Python."""
    y = [2.0 if a > 0 and b > 0 else a * b + 5 if a > 0 else 1.0 for a, b in zip(u, v, strict=True)]
    return y, np.cumsum((u > 0) & (v > 0))


def chart_with_table(rows, actions, language="C", is_matlab=False):
    """A chart that calls the truth table "pick" in each step."""
    return Chart(
        {"A": "A\ndu: pick();", "pick": "pick()"},
        [("", "A", "")],
        SHARED,
        functions={"pick": ""},
        language=language,
        tables={"pick": (rows, actions, is_matlab)},
    )


@pytest.mark.parametrize("layout", ["slx parts", "mdl"])
@pytest.mark.parametrize(("language", "code"), [("C", "C"), ("C", "MATLAB"), ("MATLAB", "MATLAB")])
def test_a_truth_table_runs_the_actions_of_the_first_decision_that_agrees(language, code, layout, tmp_path):
    chart = chart_with_table(RULES, ACTIONS[code], language, code == "MATLAB")
    outputs = run(imported(drawn_chart(chart, "uv", "yn"), tmp_path, layout), {"u": U, "v": V})
    # the state is entered in the first step, and its action runs from the second one on
    y, n = expected(U[1:], V[1:])
    np.testing.assert_allclose(outputs["y_out"][1:], y)
    np.testing.assert_array_equal(outputs["n_out"][1:], n)


def test_conditions_are_evaluated_before_the_actions_and_special_actions_around_them(tmp_path):
    rows = [["", "y > 0", "T", "F"], ["", "y > 1", "-", "F"], ["", "Actions", "1", "2"]]
    actions = [["", "y = -1;"], ["", "y = 10;"], ["", "INIT: y = u;"], ["", "FINAL: y = y + v;"]]
    outputs = run(imported(drawn_chart(chart_with_table(rows, actions), "uv", "yn"), tmp_path), {"u": U, "v": V})
    np.testing.assert_allclose(outputs["y_out"][1:], (np.where(U > 0, -1.0, 10.0) + V)[1:])


def test_a_table_without_a_decision_that_agrees_changes_nothing(tmp_path):
    rows = [["", "u > 0", "T"], ["", "Actions", "1"]]
    outputs = run(
        imported(drawn_chart(chart_with_table(rows, [["", "y = u;"]]), "uv", "yn"), tmp_path), {"u": U, "v": V}
    )
    last = 0.0
    for u, y in zip(U[1:], outputs["y_out"][1:], strict=True):
        last = u if u > 0 else last
        assert y == last


def test_the_flow_chart_that_is_stored_beside_a_table_is_not_used(tmp_path):
    rows = [["", "u > 0", "T", "-"], ["", "Actions", "1", "2"]]
    chart = chart_with_table(rows, [["", "y = 1;"], ["", "y = 2;"]])
    chart.junctions, chart.parents = ("J",), {"J": "pick"}
    chart.transitions += [("", "J", "{y = 99;}")]
    chart.data = [*SHARED, ("aVarTruthTableCondition_1", "TEMPORARY_DATA", "", "", "pick")]
    outputs = run(imported(drawn_chart(chart, "uv", "yn"), tmp_path), {"u": U, "v": V})
    np.testing.assert_array_equal(outputs["y_out"][1:], np.where(U > 0, 1, 2)[1:])


@pytest.mark.parametrize("kind", ["TRUTH_TABLE_CHART", "TRUTHTABLE_CHART"])
def test_a_truth_table_block_reads_and_sets_its_ports(kind, tmp_path):
    # newer files store the call, and the texts as cells
    is_stored = kind == "TRUTHTABLE_CHART"
    chart = Chart(
        {"t": "tt_blk_kernel" if is_stored else "tt_blk_kernel()"},
        [("", "J", "{tt_blk_kernel();}")] if is_stored else [],
        SHARED,
        functions={"t": ""},
        settings={"type": kind},
        tables={"t": (RULES, ACTIONS["MATLAB"], True)},
    )
    chart.junctions = ("J",) if is_stored else ()
    outputs = run(imported(drawn_chart(chart, "uv", "yn"), tmp_path), {"u": U, "v": V})
    y, n = expected(U, V)
    np.testing.assert_allclose(outputs["y_out"], y)
    np.testing.assert_array_equal(outputs["n_out"], n)


@pytest.mark.parametrize(("entry", "action"), [("X", "1"), ("T", "2"), ("T", "LATER")])
def test_a_table_with_an_unknown_entry_or_action_is_refused(entry, action, tmp_path):
    chart = chart_with_table([["", "u > 0", entry], ["", "Actions", action]], [["", "y = 1;"]])
    with pytest.raises(InputError, match="pick is a truth table whose entries or actions cannot be read"):
        imported(drawn_chart(chart, "uv", "yn"), tmp_path)


def test_a_table_calls_functions_with_arguments_and_results(tmp_path):
    chart = chart_with_table(
        [["", "x > 0", "T", "F"], ["", "Actions", "1", "2"]], [["", "z = x;"], ["", "z = -2 * x;"]]
    )
    chart.states |= {"A": "A\ndu: y = pick(u);", "pick": "z = pick(x)"}
    chart.data = [*IO, ("v", "INPUT_DATA"), ("n", "OUTPUT_DATA")]
    chart.data += [("x", "FUNCTION_INPUT_DATA", "", "", "pick"), ("z", "FUNCTION_OUTPUT_DATA", "", "", "pick")]
    outputs = run(imported(drawn_chart(chart, "uv", "yn"), tmp_path), {"u": U, "v": V})
    np.testing.assert_allclose(outputs["y_out"][1:], np.where(U > 0, U, -2 * U)[1:])

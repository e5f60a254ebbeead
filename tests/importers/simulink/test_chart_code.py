"""Code in charts: functions, the statements of MATLAB, elements of arrays; against the same written in Python."""

import re
from dataclasses import replace

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from tests.draws import mostly_slow
from tests.importers.simulink.chart_runs import IO, U, V, drawn_chart, lone, muxed, pair
from tests.importers.simulink.simulink_files import LAYOUTS, Chart, Model
from tests.importers.simulink.simulink_runs import imported, run, slopes

FUNCTIONS = Chart(
    {
        "A": "A\nen: y = half(u) + scaled(2, u);\ndu: [y, n] = pair(u, y);",
        "half": "r = half(x)",
        "scaled": "z = scaled(k, x)",
        "pair": "[a, b] = pair(p, q)",
    },
    [
        ("", "A", ""),
        ("", "h", "{r = x/2;}"),
        ("h", "h2", "[x > 0]{r = r + 1;}"),
        ("h", "h2", ""),
        ("", "p", "{a = p; b = p;}"),
        ("p", "p2", "[q > p]{a = q - 0.5; c = c + 1; b = c;}"),
    ],
    [
        *IO,
        ("n", "OUTPUT_DATA"),
        ("x", "FUNCTION_INPUT_DATA", "", "", "half"),
        ("r", "FUNCTION_OUTPUT_DATA", "", "", "half"),
        ("p", "FUNCTION_INPUT_DATA", "", "", "pair"),
        ("q", "FUNCTION_INPUT_DATA", "", "", "pair"),
        ("a", "FUNCTION_OUTPUT_DATA", "", "", "pair"),
        ("b", "FUNCTION_OUTPUT_DATA", "", "", "pair"),
        ("c", "LOCAL_DATA", "5", "", "pair"),
    ],
    parents={"h": "half", "h2": "half", "p": "pair", "p2": "pair"},
    junctions=("h", "h2", "p", "p2"),
    functions={
        "half": "",
        "pair": "",
        "scaled": "function z = scaled(k, x)\nz = 0;\nfor i = 1:k\n  if x > 0\n    z = z + i*x;\n  else\n"
        "    break\n  end\nend\nend\n",
    },
)


def test_functions_of_a_chart_are_drawn_or_written(tmp_path):
    recorded = run(imported(drawn_chart(FUNCTIONS, outputs=("y", "n")), tmp_path), {"u": [2.0, 1.0, 4.0, 0.0]})
    np.testing.assert_allclose(recorded["y_out"], [2 + 6, 7.5, 7.0, 6.5])
    np.testing.assert_allclose(recorded["n_out"], [0, 6, 7, 8])


def test_actions_in_matlab_decide_and_repeat(tmp_path):
    code = (
        "entry:\nx = zeros(1, 3);\nduring:\nfor i = 1:3\n  x(i) = u*i;\nend\nif u > 1\n  y = sum(x);\n"
        "elseif u < -1\n  y = -1;\nelse\n  y = x(2); % the middle one\nend\nk = 0;\nwhile k < 4\n  k = k + 1;\n"
        "  if k == 3, continue; end\n  y = y + 0.1*k;\nend\nswitch round(u)\n"
        "  case {0, 5}\n    y = y + 100;\n  otherwise\n    y++;\nend"
    )
    data = [*IO, ("x", "LOCAL_DATA", "", "[1 3]"), ("i", "LOCAL_DATA"), ("k", "LOCAL_DATA")]
    chart = lone(code, data, language="MATLAB")
    output = run(imported(drawn_chart(chart), tmp_path), {"u": U[:30]})["y_out"]
    expected = np.where(U > 1, 6 * U, np.where(U < -1, -1, 2 * U)) + 0.7
    expected += np.where(np.isin(np.sign(U) * np.floor(np.abs(U) + 0.5), (0, 5)), 100, 1)
    np.testing.assert_allclose(output[1:], expected[1:30], atol=1e-12)


def test_elements_of_arrays_may_be_chosen_while_the_chart_runs(tmp_path):
    chart = Chart(
        {"A": "A\ndu: m[i][1] = u; y = m[j][1] + v[1]; i = fmod(i + 1, 3); j = u > 0;"},
        [("", "A", "")],
        [*IO, ("v", "INPUT_DATA"), ("m", "LOCAL_DATA", "", "[3 2]"), ("i", "LOCAL_DATA"), ("j", "LOCAL_DATA")],
    )
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.chart("C", chart, ("u", "v"), ("y",))
    drawn.inport("u")
    drawn.outport("out")
    drawn.chain("u", "C", "out")
    muxed(drawn, ("a", "b"), "C:2")
    output = run(imported(drawn, tmp_path), {"u": U, "a": V, "b": 2 * V})["out"]
    m, j, expected = [0.0, 0.0, 0.0], 0, [0.0]
    for k in range(1, U.size):
        m[(k - 1) % 3] = U[k]
        expected.append(m[j] + 2 * V[k])
        j = int(U[k] > 0)
    np.testing.assert_allclose(output, expected, atol=1e-12)


def calling(code, drawn, data=(), **options):
    """A chart in MATLAB of one state whose during actions may call the function r = f(x), drawn as one arrow."""
    of_f = [("x", "FUNCTION_INPUT_DATA", "", "", "f"), ("r", "FUNCTION_OUTPUT_DATA", "", "", "f")]
    return Chart(
        {"A": f"A\nduring:\n{code}", "B": "B", "f": "r = f(x)"},
        [("", "A", ""), ("A", "B", "[u > 99]"), ("", "J", drawn)],
        [*IO, *of_f, *data],
        parents={"J": "f"},
        junctions=("J",),
        functions={"f": ""},
        language="MATLAB",
        **options,
    )


def test_switch_evaluates_its_subject_once(tmp_path):
    code = "switch f(u)\n case 7\n  y = 1;\n case {5, 1}\n  y = 2;\n case 2\n  y = 3;\n otherwise\n  y = 9;\nend"
    chart = calling(code, "{n = n + 1; r = n;}", [("n", "OUTPUT_DATA")])
    recorded = run(imported(drawn_chart(chart, outputs=("y", "n")), tmp_path), {"u": np.zeros(9)})
    np.testing.assert_array_equal(recorded["n_out"], range(9))
    np.testing.assert_array_equal(recorded["y_out"], [0, 2, 3, 9, 9, 2, 9, 1, 9])


def test_actions_end_if_a_function_in_an_expression_has_left_their_state(tmp_path):
    chart = calling("y = f(u);\nz = z + 1;", "{E; r = x;}", [("z", "OUTPUT_DATA")], events=[("E", "LOCAL_EVENT", "")])
    chart.transitions[1] = ("A", "B", "E")
    chart.states["B"] = "B\nentry: y = -1;"
    recorded = run(imported(drawn_chart(chart, outputs=("y", "z")), tmp_path), {"u": [5.0, 6.0, 7.0]})
    np.testing.assert_array_equal(recorded["y_out"], [0, 6, 6])
    np.testing.assert_array_equal(recorded["z_out"], [0, 0, 0])


def test_unassigned_outputs_of_matlab_functions_are_nan(tmp_path):
    script = "function r = f(x)\nif x > 0\n  a = x;\nelse\n  a = -1;\nend\nif x < 1\n  r = a;\nend\nend\n"
    chart = replace(calling("y = f(u);", ""), functions={"f": script}, junctions=(), parents={})
    chart.transitions.pop()
    output = run(imported(drawn_chart(chart), tmp_path), {"u": [0, -2, 0.5, 3, 0.25]})["y_out"]
    np.testing.assert_array_equal(output, [0, -1, 0.5, np.nan, 0.25])


def test_end_may_stand_deep_within_an_index(tmp_path):
    code = "x(end) = u;\ny = x(min(end, 7)) + 10*x(-1 + abs(-end)) + 100*x(x(end - 2)/5);"
    chart = lone(f"during:\n{code}", [*IO, ("x", "LOCAL_DATA", "[5 2 0]", "[1 3]")],
                  language="MATLAB")  # fmt: skip
    output = run(imported(drawn_chart(chart), tmp_path), {"u": U[:5]})["y_out"]
    np.testing.assert_allclose(output[1:], U[1:5] + 20 + 500)


@pytest.mark.parametrize(
    ("language", "code", "whole"),
    [
        ("C", "x[i] = u; y = x[i]; z = x[0] + x[1] + x[2];", np.floor),
        ("MATLAB", "x(i + 1) = u; y = x(i + 1); z = x(1) + x(2) + x(3);", lambda i: np.floor(i + 0.5)),
    ],
)
def test_reading_beyond_an_array_gives_nan_and_writing_has_no_effect(language, code, whole, tmp_path):
    data = [*IO, ("x", "LOCAL_DATA", "7", "3"), ("i", "LOCAL_DATA", "-2"), ("z", "OUTPUT_DATA")]
    chart = lone(f"during: {code} i = i + 0.75;", data, language=language)
    recorded = run(imported(drawn_chart(chart, outputs=("y", "z")), tmp_path), {"u": U[:9]})
    x, i, y, z = np.full(3, 7.0), -2.0, [0.0], [0.0]
    for u in U[1:9]:
        at = int(whole(i))
        there = 0 <= at < 3
        if there:
            x[at] = u
        y.append(u if there else np.nan)
        z.append(x.sum())
        i += 0.75
    np.testing.assert_allclose(recorded["y_out"], y)
    np.testing.assert_allclose(recorded["z_out"], z, atol=1e-12)
    assert np.isnan(y).any()


def test_derivatives_ignore_reads_beyond_an_array(tmp_path):
    data = [*IO, ("K", "PARAMETER_DATA"), ("x", "LOCAL_DATA", "[1 a 3]", "3"), ("i", "LOCAL_DATA")]
    chart = Chart({}, [("", "J", "[i < 3]{y = y + K*x[i]*u;}"), ("", "J", "{y = 2*K*y;}"), ("J", "L", "{i = i + 1;}")],
                  data, junctions=("J", "L"))  # fmt: skip
    model = imported(drawn_chart(chart), tmp_path, parameters=[{"K": 0.7, "a": 2.0}])
    for name in ("K", "a"):
        exact, near = slopes(model, {"u": U[:6]}, name, "y_out")
        np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-8)
        assert np.all(exact[2:] != 0)


@pytest.mark.parametrize(
    ("code", "wanted"),
    [
        ("y = any(x > 1) + 2*all(x > -2);", lambda x: float((x > 1).any()) + 2 * float((x > -2).all())),
        ("y = mean(x) + 10*median(x);", lambda x: x.mean() + 10 * np.median(x)),
        ("[m, i] = max(x); y = m + 10*i;", lambda x: x.max() + 10 * (x.argmax() + 1)),
        ("[m, ~] = min(x); y = m;", np.min),
        ("s = sort(x); y = s(2) + size(x, 2) + 5*isempty(x);", lambda x: np.sort(x)[1] + 3),
        ("y = xor(x(1) > 0, x(2) > 0) + sum(x, 2);", lambda x: float((x[0] > 0) != (x[1] > 0)) + x.sum()),
        ("y = interp1([0 1 2], [5 6 9], min(x(3), 2));", lambda x: np.interp(x[2], [0, 1, 2], [5, 6, 9])),
        ("y = norm(x) + dot(x, [1 2 3]);", lambda x: np.linalg.norm(x) + x @ [1, 2, 3]),
    ],
)
def test_a_chart_in_matlab_knows_the_functions_of_matlab(code, wanted, tmp_path):
    data = [*IO, ("x", "LOCAL_DATA", "[0 0 0]", "[1 3]"), ("s", "LOCAL_DATA", "[0 0 0]", "[1 3]")]
    data += [("m", "LOCAL_DATA"), ("i", "LOCAL_DATA")]
    chart = lone(f"during:\nx = [u, 1 - u*u, abs(u)];\n{code}", data, language="MATLAB")
    output = run(imported(drawn_chart(chart), tmp_path), {"u": U})["y_out"]
    np.testing.assert_allclose(output[1:], [wanted(np.array([u, 1 - u * u, abs(u)])) for u in U[1:]], atol=1e-12)


@pytest.mark.parametrize(
    ("language", "code", "message"),
    [
        ("MATLAB", "y = fft(u);", "the function fft is not supported for signals"),
        ("MATLAB", "y = mean(u, 1, 2, 3);", "mean: one dimension is expected, got 3"),
        ("MATLAB", "[y, z] = fft(u);", "unknown function fft with several results"),
        ("C", "y = mean(u);", "the function mean is not supported for signals"),
        ("C", f"y = 0x{'F' * 400};", "has more digits than an integer of C"),
    ],
)
def test_unknown_functions_in_charts_are_reported(language, code, message, tmp_path):
    chart = lone(f"during:\n{code}", [*IO, ("z", "LOCAL_DATA")], language=language)
    with pytest.raises(InputError, match=re.escape(message)):
        imported(drawn_chart(chart), tmp_path)


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx inline"]))
def test_bits_in_a_chart_are_those_of_the_types_of_its_data(layout, tmp_path):
    code = "during:\ny = bitshift(k, 1);\nz = bitshift(uint8(u), 1);\nw = bitshift(k + 1, 1);\nk = u;"
    data = [*IO, ("z", "OUTPUT_DATA"), ("w", "OUTPUT_DATA"), ("k", "LOCAL_DATA", "100")]
    chart = lone(code, data, language="MATLAB", types={"k": "int8"})
    report = import_simulink(drawn_chart(chart, outputs=("y", "z", "w")).write(tmp_path, layout))
    recorded = run(report.model, {"u": [0.0, 3.0, 127.0, 200.0]})
    assert recorded["y_out"][1:].tolist() == [-56.0, 6.0, -2.0]  # of 100, 3, 127 in int8
    assert recorded["z_out"][1:].tolist() == [6.0, 254.0, 144.0]  # of 3, 127, 200 in uint8
    assert recorded["w_out"][1:].tolist() == [-54.0, 8.0, -2.0]  # of 101, 4, 127: int8 ends there
    assert any(str(one).startswith("integer types are ignored in C") for one in report.report.notes)


def test_bits_in_charts_with_c_are_those_of_the_declared_types(tmp_path):
    code = "du: y = k & 12 | k << 1; z = ~k; w = k ^ (k >> 3); k &= 6; k |= u;"
    data = [*IO, ("z", "OUTPUT_DATA"), ("w", "OUTPUT_DATA"), ("k", "LOCAL_DATA")]
    chart = lone(code, data, types={"k": "uint8"}, settings={"actionLanguage": "1"})
    recorded = run(imported(drawn_chart(chart, outputs=("y", "z", "w")), tmp_path), {"u": [9.0, 200.0, 255.0, 0.0]})
    k = np.array([0, 200, 200 & 6 | 255], dtype=np.uint8)
    np.testing.assert_array_equal(recorded["y_out"][1:], (k & 12) | (k << 1))
    np.testing.assert_array_equal(recorded["z_out"][1:], ~k)
    np.testing.assert_array_equal(recorded["w_out"][1:], k ^ (k >> 3))


def test_truth_values_are_combined_bit_by_bit(tmp_path):
    # Stateflow enables C-bit operations by default, and & then joins conditions
    chart = pair("en: y = 0;", "en: y = 1;", "[u == 2 & after(0.3, sec)]", "[u < 1 | u > 5 ^ u > 8]",
                 settings={"actionLanguage": "1"})  # fmt: skip
    output = run(imported(drawn_chart(chart), tmp_path), {"u": [2, 2, 2, 2, 2, 2, 6, 2, 2, 2, 2, 9, 3, 0]})["y_out"]
    assert output.tolist() == [0, 0, 0, 1, 1, 1, 0, 0, 0, 1, 1, 1, 1, 0]

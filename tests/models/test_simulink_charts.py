"""Stateflow charts against an interpreter of its own and against numbers by hand."""

from dataclasses import replace

import numpy as np
import pytest
from chart_runs import IO, U, V, both, drawn_chart, lone, muxed, pair
from simulink_files import LAYOUTS, Chart, Model
from simulink_runs import imported, run, slopes

from kennfeld.errors import InputError
from kennfeld.models.simulink.importing import import_simulink, simulink

UV = [("u", "INPUT_DATA"), ("v", "INPUT_DATA"), ("y", "OUTPUT_DATA"), ("z", "OUTPUT_DATA")]

SWITCH = Chart(
    {"Off": "Off\nentry: y = 0;", "On": "On\nentry: y = 1;"},
    [("", "Off", ""), ("Off", "On", "[u > 0.5]"), ("On", "Off", "[u < -0.5]")],
    IO,
)
DEBOUNCE = Chart(
    {"Low": "Low\nen: y = 0;", "Maybe": "Maybe\ndu: z += 1;", "High": "High\nentry, during: y = 1;\nexit: z = 0;"},
    [
        ("", "Low", ""),
        ("Low", "Maybe", "[u > 0]"),
        ("Maybe", "High", "after(3, tick)"),
        ("Maybe", "Low", "[u <= -0.9]"),
        ("High", "Low", "after(0.4, sec)[u < 0]/z = -1;"),
    ],
    UV,
)
NESTED = Chart(
    {
        "A": "A\nen: z += 1;\ndu: z += 10;\nex: z += 100;",
        "A1": "A1\nen: y = 1;\nex: y = -1;",
        "A2": "A2\nen: y = 2;\ndu: y += 0.5;",
        "B": "B\nen: y = 7;",
        "B1": "B1\nen: y += 0.25;\nex: z -= 3;",
    },
    [
        ("", "A", ""),
        ("", "A1", ""),
        ("A1", "A2", "[u > 0]{z = z + 1000;}"),
        ("A2", "A1", "[u < -1]"),
        ("", "B1", ""),
        ("A", "B", "[v > 1]"),
        ("A", "A2", "[v < -1.2]", "A"),
        ("A2", "B1", "[u > 1]/z = 5;"),
        ("B", "A", "[u < 0]"),
        ("B1", "A2", "[v < 0]"),
        ("A", "A", "[u > 1.5]"),
    ],
    UV,
    parents={"A1": "A", "A2": "A", "B1": "B"},
)
PARALLEL = Chart(
    {
        "P": "P\nen: y = 0;",
        "P1": "P1\nen: y = 1;",
        "P2": "P2\nen: y = 2;\non E: z += 1;",
        "Q": "Q\ndu: z += 0.5;",
        "Q1": "Q1",
        "Q2": "Q2\nen: z = z + y;",
    },
    [
        ("", "P1", ""),
        ("P1", "P2", "E"),
        ("P2", "P1", "F"),
        ("", "Q1", ""),
        ("Q1", "Q2", "[u > 0]/E;"),
        ("Q2", "Q1", "[v > 0]/send(F, P);"),
        ("Q2", "Q1", "after(2, E)"),
    ],
    UV,
    events=[("E", "LOCAL_EVENT", "FUNCTION_CALL_EVENT"), ("F", "LOCAL_EVENT", "FUNCTION_CALL_EVENT", "P")],
    parents={"P1": "P", "P2": "P", "Q1": "Q", "Q2": "Q"},
    parallel=("",),
)
HISTORY = Chart(
    {"Run": "Run", "Slow": "Slow\nen: y = 1;", "Fast": "Fast\nen: y = 2;", "Stop": "Stop\nen: y = 0;\ndu: z += u;"},
    [
        ("", "Run", ""),
        ("", "Slow", ""),
        ("Slow", "Fast", "[u > 0.7]"),
        ("Fast", "Slow", "[u < -0.7]"),
        ("Run", "Stop", "[v > 0.5]"),
        ("Stop", "Run", "[v < 0]"),
    ],
    UV,
    parents={"Slow": "Run", "Fast": "Run", "H": "Run"},
    histories=("H",),
)
FLOW = Chart(
    {},
    [
        ("", "J0", "{y = 0;}"),
        ("J0", "J1", "[u > 0]{y = 1;}"),
        ("J1", "J3", "[v > 0]{z = z + 1;}"),
        ("J1", "J3", "[v < -1]{z = -9;}"),
        ("J0", "J2", "{y = y + 10;}"),
        ("J2", "J3", "{z = z + 0.5;}"),
        ("J3", "J4", "[u > v]{z = z * 0.5;}"),
        ("J3", "J4", ""),
    ],
    UV,
    junctions=("J0", "J1", "J2", "J3", "J4"),
)
LOOP = Chart(
    {},
    [
        ("", "J0", "{y = 0; i = 0;}"),
        ("J0", "J1", "[i < 5]{y = y + i*u; i += 1;}"),
        ("J1", "J0", ""),
        ("J0", "J2", "{y = y + 100;}"),
    ],
    [*IO, ("i", "LOCAL_DATA")],
    junctions=("J0", "J1", "J2"),
)
INNER = Chart(
    {"S": "S\ndu: z += 1;", "A": "A\nen: y = 1;\nex: z = 0;", "B": "B\nen: y = 2;", "C": "C\nen: y = 3;\ndu: y = 4;"},
    [
        ("", "S", ""),
        ("", "A", ""),
        ("S", "J", "", "S"),
        ("J", "A", "[u < -0.8]"),
        ("J", "B", "[u > 0.8]{z += 7;}"),
        ("J", "K", "[v > 0]"),
        ("K", "C", "[u > 0.2]/z -= 1;"),
        ("B", "C", "[v > 1]"),
    ],
    UV,
    parents={"A": "S", "B": "S", "C": "S", "J": "S", "K": "S"},
    junctions=("J", "K"),
)
TEMPORAL = Chart(
    {
        "A": "A\nen: y = 0;\non every(3, tick): y += 1;\non at(2, tick): z = u;",
        "B": "B\ndu: y = temporalCount(tick);\non before(3, tick): z = -1;",
    },
    [
        ("", "A", ""),
        ("A", "B", "after(700, msec)[u > 0]"),
        ("B", "A", "[hasChanged(v) && after(4, tick)]"),
        ("B", "B", "[in(B) && u > 1.2]"),
    ],
    UV,
)
DEEP = Chart(
    {
        "M": "M\nen: z = 1;\nex: z = 9;",
        "L": "L\nen: y += 1;\nex: y += 100;",
        "L1": "L1\nen: y += 2;",
        "L2": "L2\nen: y += 3;\nex: z += 0.1;",
        "R": "R\nen: y *= 0.5;\nex: z += 50;",
        "R1": "R1",
        "R2": "R2\nen: z += 4;",
        "N": "N\ndu: y = 0;",
    },
    [
        ("", "M", ""),
        ("", "L1", ""),
        ("L1", "L2", "[u > 0]"),
        ("L2", "L1", "[u < 0]"),
        ("", "R1", ""),
        ("R1", "R2", "[v > 0 && in(L2)]"),
        ("R2", "R1", "[v < 0]"),
        ("M", "N", "[u > 1.3]"),
        ("N", "R2", "[u < 0]"),
        ("R2", "N", "[v > 1.4]", ""),
    ],
    UV,
    parents={"L": "M", "R": "M", "L1": "L", "L2": "L", "R1": "R", "R2": "R"},
    parallel=("M",),
)


CHARTS = {
    "switch": SWITCH,
    "debounce": DEBOUNCE,
    "nested": NESTED,
    "parallel": PARALLEL,
    "history": HISTORY,
    "flow": FLOW,
    "loop": LOOP,
    "inner": INNER,
    "temporal": TEMPORAL,
    "deep": DEEP,
}


@pytest.mark.parametrize("name", CHARTS)
def test_charts_run_as_an_interpreter_does(name, tmp_path):
    chart = CHARTS[name]
    columns = {"u": U, "v": V} if len(chart.data) > 3 else {"u": U}
    outputs = ("y", "z") if len(chart.data) > 3 else ("y",)
    for found, expected in both(chart, tmp_path, columns, outputs):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
        assert np.unique(expected).size > 1


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", ["parallel", "history", "inner"])
def test_charts_are_the_same_in_every_layout(name, layout, tmp_path):
    for found, expected in both(CHARTS[name], tmp_path, {"u": U, "v": V}, ("y", "z"), layout=layout):
        np.testing.assert_allclose(found, expected, atol=1e-12)


# parameters

GAINED = pair(
    "entry: y = K*u;\nduring: y = y + K^2;",
    "during: y = x[1]*u;\nexit: y = y*K;",
    "[u > limit]{x[1] = K + u;}",
    "after(2, tick)[u < 0]",
    [*IO, ("K", "PARAMETER_DATA"), ("limit", "PARAMETER_DATA"), ("x", "LOCAL_DATA", "[0 a]", "2")],
)


def test_parameters_of_a_chart_stay_live_with_exact_derivatives(tmp_path):
    given = {"K": 1.5, "limit": 0.2, "a": 3.0}
    model = imported(drawn_chart(GAINED), tmp_path, parameters=[given])
    assert {"K", "limit"} <= set(model.graph.parameters)
    for name in ("K", "limit"):
        exact, near = slopes(model, {"u": U[:40]}, name, "y_out")
        np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-6)
    assert np.abs(slopes(model, {"u": U[:40]}, "K", "y_out")[0]).max() > 1


def test_a_chart_may_begin_with_a_parameter(tmp_path):
    data = [*IO, ("s", "LOCAL_DATA", "2*a")]
    drawn = lone("during: s = 0.5*s; y = s + u;", data)
    model = imported(drawn_chart(drawn), tmp_path, parameters=[{"a": 3.0}])
    found = run(model, {"u": np.zeros(4)})["y_out"]
    np.testing.assert_allclose(found, [0, 3, 1.5, 0.75])
    exact, near = slopes(model, {"u": np.zeros(4)}, "a", "y_out")
    np.testing.assert_allclose(exact, near, atol=1e-8)


# how it begins, and when it runs


def test_a_chart_that_is_entered_before_the_first_step_runs_in_it(tmp_path):
    drawn = Chart(
        {"A": "A\nentry: y = 1;\nduring: y += 1;"}, [("", "A", "")], IO, settings={"executeAtInitialization": "1"}
    )
    found = run(imported(drawn_chart(drawn), tmp_path), {"u": np.zeros(3)})["y_out"]
    np.testing.assert_array_equal(found, [2, 3, 4])


def test_a_chart_with_a_sample_time_of_its_own_holds_between_its_hits(tmp_path):
    settings = {"updateMethod": "DISCRETE", "sampleTime": "0.3"}
    drawn = lone("entry: y = u;\nduring: y = u;", settings=settings)
    found = run(imported(drawn_chart(drawn), tmp_path), {"u": np.arange(8.0)})["y_out"]
    np.testing.assert_array_equal(found, [0, 0, 0, 3, 3, 3, 6, 6])


def test_a_chart_in_an_enabled_subsystem_stands_still_with_it(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    inner = drawn.subsystem("S")
    inner.block("EnablePort", "Enable", StatesWhenEnabling="held")
    inner.chart("C", lone("du: y += u;"))
    inner.inport("a")
    inner.outport("b")
    inner.chain("a", "C", "b")
    for name in ("u", "e"):
        drawn.inport(name)
    drawn.outport("y")
    drawn.line("u", "S")
    drawn.line("e", "S#enable")
    drawn.line("S", "y")
    enabled = np.array([0, 1, 1, 0, 0, 1, 1])
    found = run(imported(drawn, tmp_path), {"u": np.arange(7.0), "e": enabled})["y"]
    np.testing.assert_array_equal(found, [0, 0, 2, 2, 2, 7, 13])


# events from outside and to the outside


@pytest.mark.parametrize(
    ("trigger", "at"),
    [("RISING_EDGE_EVENT", [3, 7]), ("FALLING_EDGE_EVENT", [5]), ("EITHER_EDGE_EVENT", [3, 5, 7])],
)
def test_an_event_from_outside_wakes_a_chart_up_at_an_edge(trigger, at, tmp_path):
    chart = Chart(
        {"A": "A\nen: y = 1;", "B": "B\nen: y = y + u;"},
        [("", "A", ""), ("A", "B", "E"), ("B", "B", "after(1, E)")],
        IO,
        events=[("E", "INPUT_EVENT", trigger)],
    )
    drawn = drawn_chart(chart)
    drawn.inport("e")
    drawn.line("e", "C#trigger")
    signal = np.array([-1, -1, -1, 1, 1, -1, -1, 1, 1], dtype=float)
    found = run(imported(drawn, tmp_path), {"u": np.full(9, 10.0), "e": signal})["y_out"]
    woken = np.searchsorted(at, np.arange(9), side="right")
    np.testing.assert_array_equal(found, np.where(woken == 0, 0, 1 + 10 * (woken - 1)))


def test_two_events_from_outside_come_one_after_the_other(tmp_path):
    chart = Chart(
        {"A": "A\non E: y = 2*y;\non F: y = y + 1;"},
        [("", "A", "")],
        IO,
        events=[("E", "INPUT_EVENT", "FUNCTION_CALL_EVENT"), ("F", "INPUT_EVENT", "FUNCTION_CALL_EVENT")],
        settings={"executeAtInitialization": "1"},
    )
    drawn = drawn_chart(chart)
    muxed(drawn, ("e", "f"), "C#trigger")
    e, f = np.array([[1, 0, 1, 1, 0, 1], [1, 1, 0, 1, 0, 1]], dtype=float)
    found = run(imported(drawn, tmp_path), {"u": np.zeros(6), "e": e, "f": f})["y_out"]
    np.testing.assert_array_equal(found, [1, 2, 4, 9, 9, 19])


def caller(chart, inputs=("u", "th"), gain="2"):
    """A chart C of the input u, whose event f calls a subsystem S that gives gain*a; they are not wired otherwise."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.chart("C", chart, inputs, ("y", "f()"))
    inner = drawn.subsystem("S")
    inner.block("TriggerPort", "call", TriggerType="function-call")
    inner.inport("a")
    inner.block("Gain", "G", Gain=gain)
    inner.outport("b", InitialOutput="0")
    inner.chain("a", "G", "b")
    drawn.inport("u")
    drawn.line("u", "C")
    drawn.line("C:2", "S#trigger")
    return drawn


def fed_back(chart, gain="2"):
    """A caller that calls with its output y and gets the result as its input th."""
    drawn = caller(chart, gain=gain)
    drawn.outport("y_out")
    drawn.outport("th_out")
    drawn.line("C", "S", "y_out")
    drawn.line("S", "C:2", "th_out")
    return drawn


CALLER = [("u", "INPUT_DATA"), ("th", "INPUT_DATA"), ("y", "OUTPUT_DATA")]
CALL = [("f", "OUTPUT_EVENT", "FUNCTION_CALL_EVENT")]


def test_a_chart_reads_what_it_calls_within_its_step(tmp_path):
    chart = lone("en: y = 1;\ndu: y = u; f; y = y + th;", CALLER, events=CALL)
    model = imported(fed_back(chart, "K"), tmp_path, parameters=[{"K": 3.0}])
    found = run(model, {"u": U[:20]})
    np.testing.assert_allclose(found["y_out"], np.r_[1, 4 * U[1:20]], atol=1e-12)
    np.testing.assert_allclose(found["th_out"], np.r_[0, 3 * U[1:20]], atol=1e-12)
    exact, near = slopes(model, {"u": U[:20]}, "K", "y_out")
    np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-8)


def test_a_chart_reads_what_an_earlier_call_has_left(tmp_path):
    chart = pair("en: y = 1;\ndu: y = y + th;", "du: y = u; f;", "[u > 0]", "[u < 0]", CALLER, events=CALL)
    found = run(imported(fed_back(chart), tmp_path), {"u": [0, 1, 2, 3, -1, 0, 0]})
    np.testing.assert_array_equal(found["y_out"], [1, 1, 2, 3, 1, 7, 13])
    np.testing.assert_array_equal(found["th_out"], [0, 0, 4, 6, 6, 6, 6])


@pytest.mark.parametrize(
    ("state", "told"),
    [
        ("en: y = 1;\ndu: f; f;", "it may call f twice in a step"),
        ("en: f;\ndu: y = u; f; y = th;", "in several places"),
    ],
)
def test_calls_that_cannot_be_placed_are_refused(state, told, tmp_path):
    chart = lone(state, CALLER, events=CALL)
    with pytest.raises(InputError) as caught:
        imported(fed_back(chart), tmp_path)
    assert told in str(caught.value)


@pytest.mark.parametrize("first", ["N", "S"])
def test_a_block_between_a_chart_and_what_it_calls_is_told_wherever_the_import_begins(first, tmp_path):
    chart = lone("du: y = u; f; y = y + th;", CALLER, events=CALL)
    drawn = caller(chart)
    drawn.block("Gain", "N", Gain="2")
    for name in sorted(("N", "S"), key=lambda one: one != first):
        drawn.outport(f"{name}_out")
    drawn.chain("C", "N")
    drawn.line("N", "S", "N_out")
    drawn.line("S", "C:2", "S_out")
    with pytest.raises(InputError) as caught:
        imported(drawn, tmp_path)
    told = str(caught.value)
    assert "N" in told
    assert "its settings do not fit" not in told


def test_an_output_that_changes_after_a_call_is_refused_where_the_called_subsystem_reads_it(tmp_path):
    chart = lone("du: f; y = u;", [CALLER[0], CALLER[2]], events=CALL)
    drawn = caller(chart, ("u",))
    drawn.outport("out")
    drawn.chain("C", "S", "out")
    with pytest.raises(InputError) as caught:
        imported(drawn, tmp_path)
    assert "it changes y, which S/G reads, after it has called f" in str(caught.value)


def test_a_called_subsystem_that_needs_what_waits_for_the_chart_is_a_loop(tmp_path):
    chart = lone("du: y = u; f; y = y + th;", CALLER, events=CALL)
    drawn = caller(chart)
    drawn.block("Bias", "R", Bias="1")
    drawn.outport("y_out")
    drawn.chain("C", "R", "S", "C:2")
    drawn.line("R", "y_out")
    report = import_simulink(drawn.write(tmp_path)).report
    assert any("C: what it calls by f needs R, which needs the chart" in str(one) for one in report.findings)


def test_an_event_to_the_outside_changes_its_output_at_an_edge(tmp_path):
    sent = [("e", "OUTPUT_EVENT", "EITHER_EDGE_EVENT")]
    chart = pair("du: y = u;", "", "[u > 0]{e;}", "[u < 0]/e;", events=sent)
    found = run(imported(drawn_chart(chart, outputs=("y", "e")), tmp_path), {"u": [0, 1, 1, -1, 0, 2.0]})["e_out"]
    np.testing.assert_array_equal(found, [0, 1, 1, 0, 0, 1])


# functions and languages

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
    found = run(imported(drawn_chart(FUNCTIONS, outputs=("y", "n")), tmp_path), {"u": [2.0, 1.0, 4.0, 0.0]})
    np.testing.assert_allclose(found["y_out"], [2 + 6, 7.5, 7.0, 6.5])
    np.testing.assert_allclose(found["n_out"], [0, 6, 7, 8])


def test_actions_in_matlab_decide_and_repeat(tmp_path):
    code = (
        "entry:\nx = zeros(1, 3);\nduring:\nfor i = 1:3\n  x(i) = u*i;\nend\nif u > 1\n  y = sum(x);\n"
        "elseif u < -1\n  y = -1;\nelse\n  y = x(2); % the middle one\nend\nk = 0;\nwhile k < 4\n  k = k + 1;\n"
        "  if k == 3, continue; end\n  y = y + 0.1*k;\nend\nswitch round(u)\n"
        "  case {0, 5}\n    y = y + 100;\n  otherwise\n    y++;\nend"
    )
    data = [*IO, ("x", "LOCAL_DATA", "", "[1 3]"), ("i", "LOCAL_DATA"), ("k", "LOCAL_DATA")]
    chart = lone(code, data, language="MATLAB")
    found = run(imported(drawn_chart(chart), tmp_path), {"u": U[:30]})["y_out"]
    expected = np.where(U > 1, 6 * U, np.where(U < -1, -1, 2 * U)) + 0.7
    expected += np.where(np.isin(np.sign(U) * np.floor(np.abs(U) + 0.5), (0, 5)), 100, 1)
    np.testing.assert_allclose(found[1:], expected[1:30], atol=1e-12)


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
    found = run(imported(drawn, tmp_path), {"u": U, "a": V, "b": 2 * V})["out"]
    m, j, expected = [0.0, 0.0, 0.0], 0, [0.0]
    for k in range(1, U.size):
        m[(k - 1) % 3] = U[k]
        expected.append(m[j] + 2 * V[k])
        j = int(U[k] > 0)
    np.testing.assert_allclose(found, expected, atol=1e-12)


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


def test_switch_asks_once_what_it_decides_on(tmp_path):
    code = "switch f(u)\n case 7\n  y = 1;\n case {5, 1}\n  y = 2;\n case 2\n  y = 3;\n otherwise\n  y = 9;\nend"
    chart = calling(code, "{n = n + 1; r = n;}", [("n", "OUTPUT_DATA")])
    found = run(imported(drawn_chart(chart, outputs=("y", "n")), tmp_path), {"u": np.zeros(9)})
    np.testing.assert_array_equal(found["n_out"], range(9))
    np.testing.assert_array_equal(found["y_out"], [0, 2, 3, 9, 9, 2, 9, 1, 9])


def test_actions_end_where_a_function_in_an_expression_has_left_their_state(tmp_path):
    chart = calling("y = f(u);\nz = z + 1;", "{E; r = x;}", [("z", "OUTPUT_DATA")], events=[("E", "LOCAL_EVENT", "")])
    chart.transitions[1] = ("A", "B", "E")
    chart.states["B"] = "B\nentry: y = -1;"
    found = run(imported(drawn_chart(chart, outputs=("y", "z")), tmp_path), {"u": [5.0, 6.0, 7.0]})
    np.testing.assert_array_equal(found["y_out"], [0, 6, 6])
    np.testing.assert_array_equal(found["z_out"], [0, 0, 0])


def test_what_a_function_in_matlab_gives_no_value_is_no_number(tmp_path):
    script = "function r = f(x)\nif x > 0\n  a = x;\nelse\n  a = -1;\nend\nif x < 1\n  r = a;\nend\nend\n"
    chart = replace(calling("y = f(u);", ""), functions={"f": script}, junctions=(), parents={})
    chart.transitions.pop()
    found = run(imported(drawn_chart(chart), tmp_path), {"u": [0, -2, 0.5, 3, 0.25]})["y_out"]
    np.testing.assert_array_equal(found, [0, -1, 0.5, np.nan, 0.25])


def test_end_may_stand_deep_within_an_index(tmp_path):
    code = "x(end) = u;\ny = x(min(end, 7)) + 10*x(-1 + abs(-end)) + 100*x(x(end - 2)/5);"
    chart = lone(f"during:\n{code}", [*IO, ("x", "LOCAL_DATA", "[5 2 0]", "[1 3]")],
                  language="MATLAB")  # fmt: skip
    found = run(imported(drawn_chart(chart), tmp_path), {"u": U[:5]})["y_out"]
    np.testing.assert_allclose(found[1:], U[1:5] + 20 + 500)


@pytest.mark.parametrize(
    ("language", "code", "whole"),
    [
        ("C", "x[i] = u; y = x[i]; z = x[0] + x[1] + x[2];", np.floor),
        ("MATLAB", "x(i + 1) = u; y = x(i + 1); z = x(1) + x(2) + x(3);", lambda i: np.floor(i + 0.5)),
    ],
)
def test_beyond_an_array_there_is_no_number_and_nothing_is_written(language, code, whole, tmp_path):
    data = [*IO, ("x", "LOCAL_DATA", "7", "3"), ("i", "LOCAL_DATA", "-2"), ("z", "OUTPUT_DATA")]
    chart = lone(f"during: {code} i = i + 0.75;", data, language=language)
    found = run(imported(drawn_chart(chart, outputs=("y", "z")), tmp_path), {"u": U[:9]})
    x, i, y, z = np.full(3, 7.0), -2.0, [0.0], [0.0]
    for u in U[1:9]:
        at = int(whole(i))
        there = 0 <= at < 3
        if there:
            x[at] = u
        y.append(u if there else np.nan)
        z.append(x.sum())
        i += 0.75
    np.testing.assert_allclose(found["y_out"], y)
    np.testing.assert_allclose(found["z_out"], z, atol=1e-12)
    assert np.isnan(y).any()


def test_derivatives_pass_by_what_lies_beyond_an_array(tmp_path):
    data = [*IO, ("K", "PARAMETER_DATA"), ("x", "LOCAL_DATA", "[1 a 3]", "3"), ("i", "LOCAL_DATA")]
    chart = Chart({}, [("", "J", "[i < 3]{y = y + K*x[i]*u;}"), ("", "J", "{y = 2*K*y;}"), ("J", "L", "{i = i + 1;}")],
                  data, junctions=("J", "L"))  # fmt: skip
    model = imported(drawn_chart(chart), tmp_path, parameters=[{"K": 0.7, "a": 2.0}])
    for name in ("K", "a"):
        exact, near = slopes(model, {"u": U[:6]}, name, "y_out")
        np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-8)
        assert np.all(exact[2:] != 0)


# implicit events and time


def test_implicit_events_come_when_states_are_entered_and_variables_change(tmp_path):
    chart = Chart(
        {
            "P": "P",
            "P1": "P1",
            "P2": "P2",
            "Q": "Q\non en(P2): y += 1;\non ex(P2): y += 10;\non change(s): y += 100;",
            "R": "R\ndu: s = v;",
        },
        [("", "P1", ""), ("P1", "P2", "[u > 0]"), ("P2", "P1", "[u < 0]")],
        [*UV[:3], ("s", "LOCAL_DATA")],
        parents={"P1": "P", "P2": "P"},
        parallel=("",),
    )
    u, v = np.array([0, 1, 1, -1, 1, 0.0]), np.array([0, 0, 5, 5, 4, 4.0])
    found = run(imported(drawn_chart(chart, ("u", "v")), tmp_path), {"u": u, "v": v})["y_out"]
    np.testing.assert_array_equal(found, [0, 1, 101, 111, 212, 212])


def test_duration_is_how_long_a_condition_holds(tmp_path):
    chart = pair("du: y = duration(u > 0);", "en: y = -1;", "[duration(u > 0) >= 0.3]", "[u < 0]")
    found = run(imported(drawn_chart(chart), tmp_path), {"u": [1, 1, 1, -1, 1, 1, 1, 1, 1, -1, 1, 1.0]})["y_out"]
    np.testing.assert_allclose(found, [0, 0, 0.1, 0, 0, 0.1, 0.2, -1, -1, -1, 0, 0.1], atol=1e-12)


def test_change_is_told_of_inputs_outputs_and_elements(tmp_path):
    code = "du: y = hasChanged(u) + 10*hasChangedTo(u, 2) + 100*hasChangedFrom(u, 2) + 1000*hasChanged(s); s = u > 2;"
    chart = lone(code, [*IO, ("s", "LOCAL_DATA")])
    found = run(imported(drawn_chart(chart), tmp_path), {"u": [1, 2, 2, 3, 3, 3, 2, 2.0]})["y_out"]
    np.testing.assert_array_equal(found, [0, 11, 0, 101, 1000, 0, 11, 1000])


# size and refusals


def test_a_chain_of_decisions_grows_with_its_length(tmp_path):
    count = 40
    arrows = [("", "J0", "{y = 0;}")]
    for at in range(count):
        arrows += [
            (f"J{at}", f"K{at}", f"[u > {at}]{{y = y + {at};}}"),
            (f"J{at}", f"K{at}", "{y = y - 1;}"),
            (f"K{at}", f"J{at + 1}", ""),
        ]
    knots = [f"J{at}" for at in range(count + 1)] + [f"K{at}" for at in range(count)]
    model = imported(drawn_chart(Chart({}, arrows, IO, junctions=tuple(knots))), tmp_path)
    assert len(model.graph.nodes) < 12 * count
    u = np.array([-1.0, 5.5, 100.0])
    expected = [sum(at if one > at else -1 for at in range(count)) for one in u]
    np.testing.assert_array_equal(run(model, {"u": u})["y_out"], expected)


def test_a_loop_may_end_by_a_signal_within_its_bound(tmp_path):
    chart = Chart(
        {},
        [
            ("", "J", "{y = 0; i = 0;}"),
            ("J", "K", "[i < 20]{i = i + 1;}"),
            ("K", "L", "[y > u]"),
            ("K", "J", "{y = y + i;}"),
            ("J", "L", ""),
        ],
        [*IO, ("i", "LOCAL_DATA")],
        junctions=("J", "K", "L"),
    )
    found = run(imported(drawn_chart(chart), tmp_path), {"u": [-1.0, 0.0, 5.0, 1e9]})["y_out"]
    np.testing.assert_array_equal(found, [0, 1, 6, 210])


REFUSED = [
    (lone("", settings={"stateMachineType": "MOORE_MACHINE"}), "it is a Moore chart"),
    (lone("", settings={"enableNonTerminalStates": "1"}), "it runs in super steps"),
    (lone("", settings={"initializeOutput": "1"}), "begins with new outputs"),
    (lone("du: y = u", settings={"updateMethod": "CONTINUOUS"}), "in continuous time"),
    (lone("y = u;"), "actions without a keyword"),
    (lone("du: y = ml.sin(u);"), "it calls ml"),
    (lone("du: y = u << 2;"), "the operation << on bits"),
    (
        lone("du: y = u & 3;", settings={"actionLanguage": "1"}),
        "the operation & on bits",
    ),
    (lone("du: q = u;"), "what is no variable of the chart"),
    (lone("du: y = q;"), "variable q: has no value; C needs it"),
    (lone("du: u = y;"), "u, which it may only read"),
    (
        pair("", "", "X"),
        "its transition X: it waits for what is no event",
    ),
    (
        pair("", "", "[u > 0"),
        "its transition [u > 0: [ is never closed",
    ),
    (lone("du: y = (u;"), ") is missing"),
    (lone("du: E;", events=[("E", "LOCAL_EVENT", "")]), "sends events to itself"),
    (
        lone("", [*IO, ("m", "DATA_STORE_MEMORY_DATA")]),
        "data m is of a kind that is not supported",
    ),
    (lone("bind: y;"), "binds variables"),
    (
        Chart({}, [("", "J", "{y = u;}"), ("J", "J", "[y > 0]{y = y - 1;}")], IO, junctions=("J",)),
        "its junctions make a loop",
    ),
    (
        Chart(
            {"A": "A\ndu: y = f(u);", "f": "z = f(x)"},
            [("", "A", ""), ("", "J", "{z = f(x);}")],
            [*IO, ("x", "FUNCTION_INPUT_DATA", "", "", "f"), ("z", "FUNCTION_OUTPUT_DATA", "", "", "f")],
            parents={"J": "f"},
            junctions=("J",),
            functions={"f": ""},
        ),
        "it calls f without an end",
    ),
    (lone("du: while 1, y = u; end", language="MATLAB"), "unfolds to more than"),
]


@pytest.mark.parametrize(("chart", "told"), REFUSED)
def test_what_charts_may_not_do_is_told(chart, told, tmp_path):
    with pytest.raises(InputError) as caught:
        imported(drawn_chart(chart), tmp_path)
    assert told in str(caught.value)
    assert str(caught.value).startswith(("model.slx C: ", "model.slx variable q: "))


def test_a_chart_may_be_imported_by_itself(tmp_path):
    path = drawn_chart(SWITCH).write(tmp_path)
    model = simulink(path, "C")
    assert (model.graph.inputs, model.graph.outputs) == (("u",), ("y",))
    np.testing.assert_array_equal(run(model, {"u": [0, 1, 0, -1.0]})["y"], [0, 1, 1, 0])

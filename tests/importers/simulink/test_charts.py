"""Stateflow charts against an interpreter of its own and against numbers by hand."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import simulink
from kennfeld.importers.simulink.stateflow import chart_machine
from tests.draws import mostly_slow
from tests.importers.simulink.chart_runs import IO, U, V, both, drawn_chart, lone, muxed, pair
from tests.importers.simulink.simulink_files import LAYOUTS, Chart, Model
from tests.importers.simulink.simulink_runs import imported, run, slopes

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


@pytest.mark.parametrize("name", mostly_slow(CHARTS, ["parallel", "history", "loop", "temporal", "deep"]))
def test_charts_run_as_an_interpreter_does(name, tmp_path):
    chart = CHARTS[name]
    columns = {"u": U, "v": V} if len(chart.data) > 3 else {"u": U}
    outputs = ("y", "z") if len(chart.data) > 3 else ("y",)
    for simulated, expected in both(chart, tmp_path, columns, outputs):
        np.testing.assert_allclose(simulated, expected, rtol=1e-12, atol=1e-12)
        assert np.unique(expected).size > 1


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", mostly_slow(["parallel", "history", "inner"], ["history"]))
def test_charts_are_the_same_in_every_layout(name, layout, tmp_path):
    for simulated, expected in both(CHARTS[name], tmp_path, {"u": U[:30], "v": V[:30]}, ("y", "z"), layout=layout):
        np.testing.assert_allclose(simulated, expected, atol=1e-12)
        assert np.unique(expected).size > 1


def test_states_in_a_box_are_those_of_the_chart(tmp_path):
    arrows = [(*arrow, "Box") for arrow in SWITCH.transitions]
    parents = {"Off": "Box", "On": "Box"}
    boxed = Chart({"Box": "Box", **SWITCH.states}, arrows, IO, parents=parents, boxes=("Box",))
    outputs = [run(imported(drawn_chart(chart), tmp_path), {"u": U})["y_out"] for chart in (boxed, SWITCH)]
    np.testing.assert_array_equal(*outputs)
    assert np.unique(outputs).size > 1


# parameters

GAINED = pair(
    "entry: y = K*u;\nduring: y = y + K^2;",
    "during: y = x[1]*u;\nexit: y = y*K;",
    "[u > limit]{x[1] = K + u;}",
    "after(2, tick)[u < 0]",
    [*IO, ("K", "PARAMETER_DATA"), ("limit", "PARAMETER_DATA"), ("x", "LOCAL_DATA", "[0 a]", "2")],
)


def test_parameters_of_a_chart_stay_live_with_exact_derivatives(tmp_path):
    values = {"K": 1.5, "limit": 0.2, "a": 3.0}
    model = imported(drawn_chart(GAINED), tmp_path, parameters=[values])
    assert {"K", "limit"} <= set(model.graph.parameters)
    for name in ("K", "limit"):
        exact, near = slopes(model, {"u": U[:40]}, name, "y_out")
        np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-6)
    assert np.abs(slopes(model, {"u": U[:40]}, "K", "y_out")[0]).max() > 1


def test_a_chart_may_begin_with_a_parameter(tmp_path):
    data = [*IO, ("s", "LOCAL_DATA", "2*a")]
    drawn = lone("during: s = 0.5*s; y = s + u;", data)
    model = imported(drawn_chart(drawn), tmp_path, parameters=[{"a": 3.0}])
    output = run(model, {"u": np.zeros(4)})["y_out"]
    np.testing.assert_allclose(output, [0, 3, 1.5, 0.75])
    exact, near = slopes(model, {"u": np.zeros(4)}, "a", "y_out")
    np.testing.assert_allclose(exact, near, atol=1e-8)


# how it begins, and when it runs


def test_a_chart_that_is_entered_before_the_first_step_runs_in_it(tmp_path):
    drawn = Chart(
        {"A": "A\nentry: y = 1;\nduring: y += 1;"}, [("", "A", "")], IO, settings={"executeAtInitialization": "1"}
    )
    output = run(imported(drawn_chart(drawn), tmp_path), {"u": np.zeros(3)})["y_out"]
    np.testing.assert_array_equal(output, [2, 3, 4])


def test_a_chart_with_a_sample_time_of_its_own_holds_between_its_hits(tmp_path):
    settings = {"updateMethod": "DISCRETE", "sampleTime": "0.3"}
    drawn = lone("entry: y = u;\nduring: y = u;", settings=settings)
    output = run(imported(drawn_chart(drawn), tmp_path), {"u": np.arange(8.0)})["y_out"]
    np.testing.assert_array_equal(output, [0, 0, 0, 3, 3, 3, 6, 6])


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
    output = run(imported(drawn, tmp_path), {"u": np.arange(7.0), "e": enabled})["y"]
    np.testing.assert_array_equal(output, [0, 0, 2, 2, 2, 7, 13])


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
    output = run(imported(drawn, tmp_path), {"u": np.full(9, 10.0), "e": signal})["y_out"]
    woken = np.searchsorted(at, np.arange(9), side="right")
    np.testing.assert_array_equal(output, np.where(woken == 0, 0, 1 + 10 * (woken - 1)))


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
    output = run(imported(drawn, tmp_path), {"u": np.zeros(6), "e": e, "f": f})["y_out"]
    np.testing.assert_array_equal(output, [1, 2, 4, 9, 9, 19])


def test_an_event_to_the_outside_changes_its_output_at_an_edge(tmp_path):
    sent = [("e", "OUTPUT_EVENT", "EITHER_EDGE_EVENT")]
    chart = pair("du: y = u;", "", "[u > 0]{e;}", "[u < 0]/e;", events=sent)
    output = run(imported(drawn_chart(chart, outputs=("y", "e")), tmp_path), {"u": [0, 1, 1, -1, 0, 2.0]})["e_out"]
    np.testing.assert_array_equal(output, [0, 1, 1, 0, 0, 1])


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
    output = run(imported(drawn_chart(chart, ("u", "v")), tmp_path), {"u": u, "v": v})["y_out"]
    np.testing.assert_array_equal(output, [0, 1, 101, 111, 212, 212])


def test_duration_is_how_long_a_condition_holds(tmp_path):
    chart = pair("du: y = duration(u > 0);", "en: y = -1;", "[duration(u > 0) >= 0.3]", "[u < 0]")
    output = run(imported(drawn_chart(chart), tmp_path), {"u": [1, 1, 1, -1, 1, 1, 1, 1, 1, -1, 1, 1.0]})["y_out"]
    np.testing.assert_allclose(output, [0, 0, 0.1, 0, 0, 0.1, 0.2, -1, -1, -1, 0, 0.1], atol=1e-12)


def test_changes_of_inputs_outputs_and_elements_are_detected(tmp_path):
    code = "du: y = hasChanged(u) + 10*hasChangedTo(u, 2) + 100*hasChangedFrom(u, 2) + 1000*hasChanged(s); s = u > 2;"
    chart = lone(code, [*IO, ("s", "LOCAL_DATA")])
    output = run(imported(drawn_chart(chart), tmp_path), {"u": [1, 2, 2, 3, 3, 3, 2, 2.0]})["y_out"]
    np.testing.assert_array_equal(output, [0, 11, 0, 101, 1000, 0, 11, 1000])


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
    output = run(imported(drawn_chart(chart), tmp_path), {"u": [-1.0, 0.0, 5.0, 1e9]})["y_out"]
    np.testing.assert_array_equal(output, [0, 1, 6, 210])


MATRIX = ("m", "LOCAL_DATA", "", "[2 3]")
REFUSED = [
    (lone("", settings={"stateMachineType": "MOORE_MACHINE"}), "Moore charts are not supported"),
    (lone("", settings={"enableNonTerminalStates": "1"}), "super step semantics"),
    (lone("", settings={"initializeOutput": "1"}), "initializing outputs"),
    (lone("du: y = u", settings={"updateMethod": "CONTINUOUS"}), "continuous-time charts"),
    (lone("y = u;"), "actions without a keyword"),
    (lone("du: y = ml.sin(u);"), "ml is not supported"),
    (lone("du: y = ~u;", settings={"actionLanguage": "1"}), "bitcmp: its argument must be of an integer class"),
    (lone("du: q = u;"), "assignment to an unknown variable"),
    (lone("du: y = q;"), "variable q: undefined; used by C"),
    (lone("du: u = y;"), "u is read-only"),
    (
        pair("", "", "X"),
        "transition X: unknown event",
    ),
    (
        pair("", "", "[u > 0"),
        "transition [u > 0: [ is never closed",
    ),
    (lone("du: y = (u;"), ") is missing"),
    (lone("du: E;", events=[("E", "LOCAL_EVENT", "")]), "recursive broadcast of events"),
    (
        lone("", [*IO, ("m", "DATA_STORE_MEMORY_DATA")]),
        "data m has an unsupported scope",
    ),
    (lone("bind: y;"), "bind actions are not supported"),
    (lone("du: y = m[2][u];", [*IO, MATRIX]), "index 3 of m exceeds its size"),
    (lone("du: y = m[2][0];", [*IO, MATRIX]), "index 3 of m exceeds its size"),
    (lone("du: m[u][3] = 1;", [*IO, MATRIX]), "index 4 of the target of an assignment exceeds its size"),
    (lone("du: m[0][-1] = 1;", [*IO, MATRIX]), "assignment to an index below 1"),
    (lone("du: m[0][3] = 1;", [*IO, MATRIX]), "assignment out of range of m"),
    (
        Chart({}, [("", "J", "{y = u;}"), ("J", "J", "[y > 0]{y = y - 1;}")], IO, junctions=("J",)),
        "junctions form a loop",
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
        "recursive call of f, without end",
    ),
    (lone("du: while 1, y = u; end", language="MATLAB"), "expands to more than"),
]


@pytest.mark.parametrize(("chart", "message"), REFUSED)
def test_unsupported_charts_are_rejected(chart, message, tmp_path, monkeypatch):
    monkeypatch.setattr(chart_machine, "_MAX_WORK", 3000)
    with pytest.raises(InputError) as caught:
        imported(drawn_chart(chart), tmp_path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(("model.slx C: ", "model.slx variable q: "))


def test_a_chart_may_be_imported_by_itself(tmp_path):
    path = drawn_chart(SWITCH).write(tmp_path)
    model = simulink(path, "C")
    assert (model.graph.inputs, model.graph.outputs) == (("u",), ("y",))
    np.testing.assert_array_equal(run(model, {"u": [0, 1, 0, -1.0]})["y"], [0, 1, 1, 0])


def test_data_and_states_of_a_chart_without_outputs_are_the_results(tmp_path):
    io = [("u", "INPUT_DATA"), ("n", "LOCAL_DATA")]
    chart = Chart(
        {"Off": "Off", "On": "On\nentry: n = n + 1;"},
        [("", "Off", ""), ("Off", "On", "[u > 0.5]"), ("On", "Off", "[u < -0.5]")],
        io,
    )
    model = imported(drawn_chart(chart, ("u",), ()), tmp_path)
    assert model.graph.outputs == ("C/n", "C/Off", "C/On")
    expected, state, count = [], "Off", 0
    for step, u in enumerate(U):
        # the first step enters the chart by its default transition
        if step and state == "Off" and u > 0.5:
            state, count = "On", count + 1
        elif step and state == "On" and u < -0.5:
            state = "Off"
        expected.append((count, state == "Off", state == "On"))
    values = run(model, {"u": U})
    np.testing.assert_array_equal(np.transpose([values[name] for name in model.graph.outputs]), expected)

"""Stateflow charts against an interpreter of its own and against numbers by hand."""

import numpy as np
import pytest
from chart_runs import both
from simulink_files import Chart

RANDOM = np.random.default_rng(5)
U = np.round(RANDOM.normal(size=120), 2)
V = np.round(RANDOM.normal(size=120), 2)
IO = [("u", "INPUT_DATA"), ("y", "OUTPUT_DATA")]
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
    "switch": SWITCH, "debounce": DEBOUNCE, "nested": NESTED, "parallel": PARALLEL, "history": HISTORY, "flow": FLOW,
    "loop": LOOP, "inner": INNER, "temporal": TEMPORAL, "deep": DEEP,
}  # fmt: skip


@pytest.mark.parametrize("name", CHARTS)
def test_charts_run_as_an_interpreter_does(name, tmp_path):
    chart = CHARTS[name]
    columns = {"u": U, "v": V} if len(chart.data) > 3 else {"u": U}
    outputs = ("y", "z") if len(chart.data) > 3 else ("y",)
    for found, expected in both(chart, tmp_path, columns, outputs):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
        assert np.unique(expected).size > 1

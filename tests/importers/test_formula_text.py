"""Imported functions as formula text: the same outputs and the same parameters, for every kind of importer."""

import json

import numpy as np
import pytest

from kennfeld.graph.interpreter import evaluate
from kennfeld.models.formula import read
from kennfeld.models.importer import ImportOptions, ImportRequest
from kennfeld.models.importer_registry import importer_of
from kennfeld.models.model_export import write_formula
from tests.clocks import even_clock
from tests.importers.ascet.esdl_projects import write_project
from tests.importers.simulink.simulink_files import Chart, Model

STEPS = 60
C = """
const double gain[3] = {0.5, 1.5, -2.0};
double lag(double u, double v, double dt)
{
    static double x;
    static int count;
    count++;
    x += dt / (0.3 + dt) * (fmin(fmax(u, -1.0), 1.0) - x);
    if (count > 5 && v > 0.0)
        x *= 0.9;
    return gain[count % 3] * x + 3.141592653589793 / 30.0;
}
"""
PYTHON = """
import math

def law(u, v):
    if u > v:
        return math.sqrt(abs(u)) / 3 + max(u, v, 0.1)
    return min(max(v, -0.5), 0.5) * (math.pi / 180)
"""
ESDL = """package Own;
class Filter {
    @set characteristic real K = 0.7;
    real x = 1.0;
    integer n;
    @thread
    public real step(real in u, real in v) {
        n = n + 1;
        if (v > 0.0) { x = x + K * (u - x); } else { x = 0.5 * x; }
        return x + 0.001 * n;
    }
}
"""


def states(drawn):
    drawn.block("Integrator", "I", InitialCondition="x0", LimitOutput="on", UpperSaturationLimit="0.4",
                LowerSaturationLimit="-0.2")  # fmt: skip
    drawn.block("Sum", "Sum", ports=(2, 1), Inputs="+-")
    drawn.block("TransferFcn", "Lag", Numerator="[k 1]", Denominator="[0.5 0.3 1]")
    drawn.line("u", "Sum:1")
    drawn.line("v", "Sum:2")
    drawn.chain("Sum", "I", "Lag", "y")


def enabled(drawn):
    inner = drawn.subsystem("Plant")
    inner.block("EnablePort", "E", StatesWhenEnabling="reset")
    inner.inport("a")
    inner.block("UnitDelay", "Delay", InitialCondition="x0")
    inner.block("Sum", "Sum", ports=(2, 1), Inputs="++")
    inner.outport("b", OutputWhenDisabled="held")
    inner.line("a", "Sum:1")
    inner.line("Delay", "Sum:2")
    inner.line("Sum", "Delay", "b")
    drawn.line("v", "Plant#enable")
    drawn.block("Gain", "G", Gain="k")
    drawn.chain("u", "Plant", "G", "y")


def charts(drawn):
    chart = Chart(data=[("u", "INPUT_DATA"), ("v", "INPUT_DATA"), ("y", "OUTPUT_DATA"), ("n", "LOCAL_DATA")])
    chart.states = {"Low": "Low\nen: y=1;\ndu: n=n+1;", "High": "High\nen: y=n*0.1;"}
    chart.transitions = [("", "Low", ""), ("Low", "High", "[u>0.5 && after(3,tick)]"), ("High", "Low", "[v<0]")]
    drawn.chart("Logic", chart, inputs=("u", "v"))
    drawn.line("u", "Logic:1")
    drawn.line("v", "Logic:2")
    drawn.block("Gain", "G", Gain="k*x0")
    drawn.chain("Logic", "G", "y")


def tables(drawn):
    axis = "[-1 0 0.5 2]"
    for count, table in enumerate(("[2 1 -1 -4]", "[1 2 3 4;2 4 1 0;5 5 6 2;0 1 1 3]"), start=1):
        axes = {f"BreakpointsForDimension{at}": axis for at in range(1, count + 1)}
        drawn.block("Lookup_n-D", f"{count}-D, in a long name", ports=(count, 1), NumberOfTableDimensions=str(count),
                    Table=table, **axes)  # fmt: skip
    drawn.block("Lookup_n-D", "3-D", ports=(3, 1), NumberOfTableDimensions="3", Table="reshape(1:8,2,2,2)",
                **{f"BreakpointsForDimension{at}": "[-1 1]" for at in (1, 2, 3)})  # fmt: skip
    drawn.line("u", "1-D, in a long name", "2-D, in a long name:1", "3-D:1")
    drawn.line("v", "2-D, in a long name:2", "3-D:2")
    drawn.line("1-D, in a long name", "3-D:3")
    drawn.block("Sum", "Sum", ports=(3, 1), Inputs="+++")
    drawn.line("1-D, in a long name", "Sum:1")
    drawn.line("2-D, in a long name", "Sum:2")
    drawn.line("3-D", "Sum:3")
    drawn.block("Gain", "G", Gain="k*x0")
    drawn.chain("Sum", "G", "y")


def vectors(drawn):
    drawn.block("Mux", "Mux", ports=(2, 1), Inputs="2")
    drawn.line("u", "Mux:1")
    drawn.line("v", "Mux:2")
    drawn.block("Gain", "Gain", Gain="[k data(2); data(3) x0]", Multiplication="Matrix(K*u)")
    drawn.block("UnitDelay", "Delay", InitialCondition="data(1:2)")
    drawn.chain("Mux", "Gain", "Delay", "y")


DRAWINGS = (states, enabled, charts, tables, vectors)


def simulink_file(folder, draw):
    drawn = Model(solver="ode3" if draw is states else "FixedStepDiscrete", step="0.1")
    drawn.inport("u")
    drawn.inport("v")
    drawn.outport("y")
    draw(drawn)
    script = folder / "values.m"
    script.write_text("k = 0.8;\nx0 = 0.3;\ndata = [2 3 5];\n", encoding="utf-8")
    return ImportRequest(drawn.write(folder, "slx parts"), ImportOptions(parameters=(script,)))


def c_file(folder):
    (folder / "lag.c").write_text(C, encoding="utf-8")
    return ImportRequest(folder / "lag.c", choice="lag")


def python_file(folder):
    (folder / "law.py").write_text(PYTHON, encoding="utf-8")
    return ImportRequest(folder / "law.py", choice="law")


def ascet_file(folder):
    write_project(folder, {"Own/Own/Own.esdl": ESDL})
    return ImportRequest(folder / "Own/Own/Own.esdl", ImportOptions(class_name="Filter", methods=("step",)))


@pytest.mark.parametrize("draw", [*DRAWINGS, c_file, python_file, ascet_file])
def test_the_text_computes_the_same_and_has_the_same_parameters(draw, tmp_path):
    request = simulink_file(tmp_path, draw) if draw in DRAWINGS else draw(tmp_path)
    importer = importer_of(request.path.name)
    model = importer.model(request)
    target, *values = write_formula(importer, request, tmp_path / "text.kf")
    again = read(target, parameters=model.values)
    rng = np.random.default_rng(11)
    columns = {"u": rng.normal(size=STEPS), "v": rng.normal(size=STEPS), **even_clock(0.1, STEPS)}
    expected, outputs = (evaluate(each.graph, columns, model.values) for each in (model, again))
    for name in model.graph.outputs:
        np.testing.assert_allclose(outputs[name], expected[name], rtol=1e-12, atol=1e-12)
        assert np.ptp(expected[name]) > 0.1
    assert set(again.graph.parameters) == set(model.graph.parameters)
    assert [set(json.loads(path.read_text(encoding="utf-8"))) for path in values] == [set(model.values)] * len(values)
    assert max(map(len, target.read_text(encoding="utf-8").splitlines())) <= 120

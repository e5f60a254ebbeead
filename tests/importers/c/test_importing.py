"""C functions as models and in formula text, and the messages about those that cannot be read."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import parameter
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.formula import formula
from kennfeld.models.function_files import read_function_file
from kennfeld.models.model_function import as_model
from kennfeld.project.demo import exhaust

pytest.importorskip("pycparser")

LAG = """\
/* The thermocouple of the exhaust model: a lag of first order. */
double lag(double settled, double constant, double dt)
{
    static int started = 0;
    static double temperature;
    if (!started) {
        temperature = settled;
        started = 1;
    }
    temperature += dt / (constant + dt) * (settled - temperature);
    return temperature;
}
"""

EXHAUST = """\
/* The exhaust model with its tables: interpolation as code of control units writes it. */
const volatile double SETTLED[4][3] = {{230, 230, 230}, {230, 230, 230}, {230, 230, 230}, {230, 230, 230}};
const volatile double CONSTANT[3] = {5, 5, 5};
static const double SPEEDS[4] = {800, 1400, 2200, 4000};
static const double INJECTIONS[3] = {0, 20, 55};
static const double FLOWS[3] = {30, 90, 450};

static int interval(double u, const double *x, int n)
{
    int i = 0;
    while (i < n - 2 && u > x[i + 1]) i++;
    return i;
}

static double share(double u, const double *x, int i)
{
    double part = (u - x[i]) / (x[i + 1] - x[i]);
    return part < 0 ? 0 : part > 1 ? 1 : part;
}

double exhaust(double speed, double injection, double flow, double dt)
{
    static int started = 0;
    static double temperature;
    int i = interval(speed, SPEEDS, 4), j = interval(injection, INJECTIONS, 3), k = interval(flow, FLOWS, 3);
    double a = share(speed, SPEEDS, i), b = share(injection, INJECTIONS, j), c = share(flow, FLOWS, k);
    double low = SETTLED[i][j] + b * (SETTLED[i][j + 1] - SETTLED[i][j]);
    double high = SETTLED[i + 1][j] + b * (SETTLED[i + 1][j + 1] - SETTLED[i + 1][j]);
    double settled = low + a * (high - low);
    double constant = CONSTANT[k] + c * (CONSTANT[k + 1] - CONSTANT[k]);
    if (!started) { temperature = settled; started = 1; }
    temperature += dt / (constant + dt) * (settled - temperature);
    return temperature;
}
"""
GOVERNOR = """\
const volatile struct { float Kp, Ki; } GAINS = { 0.001f, 0.0001f };
static float held = 8.9f;

static float clip(float x, float low, float high) { return x < low ? low : x > high ? high : x; }

float governor(float wanted, float speed)
{
    const float miss = wanted - speed;
    const float angle = clip(GAINS.Kp * miss + held, 7, 15);
    held = clip(held + GAINS.Ki * miss, 7, 15);
    return angle;
}
"""
LOOP = """\
input n_set
output n
n = prev(n + 0.02 * (900 * (throttle - 7) - n), 1980)
miss = n_set - n
"""
GOVERNOR_TEXT = """
scalar Kp
scalar Ki
held = integrator(Ki * miss / dt, 8.9, 7, 15)
throttle = clip(Kp * miss + held, 7, 15)
step 0.02
"""


def _problems(text, tmp_path, name="step"):
    (tmp_path / "f.c").write_text(text)
    with pytest.raises(InputError) as error:
        read_function_file(f"f.c:{name}", tmp_path)
    return str(error.value)


def test_the_exhaust_model_in_c_calibrates_to_the_parameters_of_the_formula(tmp_path):
    (tmp_path / "lag.c").write_text(LAG)
    function = read_function_file("lag.c:lag", tmp_path)
    text = exhaust.FORMULA.replace(
        "PT1(settled, CurveTimeConstant(AirMass))", "lag(settled, CurveTimeConstant(AirMass), dt)"
    )
    start, data = exhaust.start(), exhaust._record("drive", 3000, 0, "training")
    names = list(exhaust.SMOOTHNESS)
    models = [formula(exhaust.FORMULA, parameters=names), formula(text, parameters=names, functions=[function])]
    results = [
        kf.calibrate(model, data, start, "Temperature", node="TemperaturePredict", smoothness=exhaust.SMOOTHNESS)
        for model in models
    ]
    for name in names:
        expected, values = (result.parameters[name].values for result in results)
        np.testing.assert_allclose(values, expected, rtol=1e-6)


def test_tables_in_c_calibrate_to_the_values_of_tables_in_formula_text(tmp_path):
    (tmp_path / "exhaust.c").write_text(EXHAUST)
    function = read_function_file("exhaust.c:exhaust", tmp_path, "e")
    data = exhaust._record("drive", 2000, 0, "training")
    in_c = formula("T = e(Speed, Injection, AirMass, dt)", functions=[function])
    text = formula("T = PT1(Settled(Speed, Injection), Constant(AirMass))", parameters=["Settled", "Constant"])
    axes = [Axis(np.array(x)) for x in ([800, 1400, 2200, 4000], [0, 20, 55], [30, 90, 450])]
    start = ParameterSet(
        [parameter("Settled", np.full((4, 3), 230.0), axes[:2]), parameter("Constant", np.full(3, 5.0), axes[2:])]
    )
    expected = kf.calibrate(text, data, start, "Temperature", node="T").parameters
    values = kf.calibrate(in_c, data, function.values, "Temperature", node="T").parameters
    np.testing.assert_allclose(values["e.SETTLED"].values, expected["Settled"].values, rtol=1e-6)
    np.testing.assert_allclose(values["e.CONSTANT"].values, expected["Constant"].values, rtol=1e-6)


def test_a_governor_in_c_has_the_gains_of_one_in_formula_text_in_a_closed_loop(tmp_path):
    (tmp_path / "governor.c").write_text(GOVERNOR)
    function = read_function_file("governor.c:governor", tmp_path, "governor")
    wanted = np.repeat([1980.0, 2800.0, 2400.0, 3000.0, 2200.0], 150)
    data = kf.Dataset.of("steps", {"n_set": wanted}, time=0.02 * np.arange(wanted.size))
    in_c = formula(f"{LOOP}throttle = governor(n_set, n)\nstep 0.02\n", functions=[function])
    text = formula(LOOP + GOVERNOR_TEXT)
    start = ParameterSet([parameter("Kp", 0.001), parameter("Ki", 0.0001)])
    expected = kf.calibrate(text, data, start, "n_set", node="n").parameters
    values = kf.calibrate(in_c, data, function.values, "n_set", node="n").parameters
    for gain in ("Kp", "Ki"):
        np.testing.assert_allclose(values[f"governor.GAINS.{gain}"].values, expected[gain].values, rtol=1e-6)


def test_each_call_has_states_of_its_own(tmp_path):
    (tmp_path / "count.c").write_text("double count(double x) { static int n; n += 1; return n * x; }")
    function = read_function_file("count.c:count", tmp_path)
    model = formula("y = count(u) + count(2 * u)", functions=[function])
    columns = {"u": np.array([1.0, 2.0, 3.0])}
    np.testing.assert_array_equal(evaluate(model.graph, columns, ParameterSet())["y"], [3.0, 12.0, 27.0])
    assert function.memory


def test_all_problems_are_reported_at_once_with_their_lines(tmp_path):
    text = "double step(double x) {\n  goto end;\n  x = unknown(x);\n  x = y;\n  end: return x;\n}\n"
    message = _problems(text, tmp_path)
    assert "f.c line 2: goto is not supported" in message
    assert "f.c line 3: unknown function unknown" in message
    assert "f.c line 4: unknown name y" in message


def test_a_wrong_name_is_answered_with_the_functions_of_the_file(tmp_path):
    assert "Did you mean step?" in _problems("double step(double x) { return x; }", tmp_path, "stepp")


def test_an_output_that_is_not_assigned_in_every_case_is_an_error(tmp_path):
    message = _problems("void step(double x, double *y) { if (x > 0) *y = x; }", tmp_path)
    assert "not assigned in every case" in message


def test_text_that_is_not_c_is_reported_with_its_line(tmp_path):
    assert "f.c line 2" in _problems("double step(double x) {\n  return x +;\n}", tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "double step(double x) { return " + "(" * 5000 + "x" + ")" * 5000 + "; }",
        "double step(double x) { return " + "-" * 5000 + "x; }",
        "double step(double x) { return x" + " + x" * 5000 + "; }",
        "#define A A A\ndouble step(double x) { return A; }",
        pytest.param("double step(double x) { while (1) x = x + 1; return x; }", marks=pytest.mark.slow),
        "double step(double x) { double a[1000000]; return x; }",
        "double step(double x) { int n = 99999999999999999999999999999999; return x; }",
        "double step(double x) { return step(x); }",
        "#if 1\ndouble step(double x) { return x; }",
        "/* never closed",
        "\x01\x02",
        "",
    ],
)
def test_hostile_text_is_refused(text, tmp_path):
    assert _problems(text, tmp_path)


def test_a_number_that_passes_in_and_out_is_a_state(tmp_path):
    text = (
        "void approach(double *y, double goal) { if (!y) return; if (*y < goal) *y += 1; else if (y != 0) *y = goal; }"
    )
    (tmp_path / "f.c").write_text(text)
    function = read_function_file("f.c:approach", tmp_path)
    assert function.states == ("y",)
    assert "keeps its value between calls" in function.remarks[0].message
    values = evaluate(as_model(function).graph, {"goal": np.array([2.5, 2.5, 2.5, 2.5, 1.0])}, ParameterSet())
    np.testing.assert_array_equal(values["y"], [1.0, 2.0, 3.0, 2.5, 1.0])


def test_what_one_declaration_would_solve_is_reported_once(tmp_path):
    text = "double step(double x) {\n  double y = magic(x);\n  y += magic(y) * LIMIT;\n  return LIMIT + y;\n}\n"
    lines = _problems(text, tmp_path).splitlines()
    assert [line.partition(": ")[2] for line in lines] == ["unknown function magic", "unknown name LIMIT"]


def test_sizes_shifts_and_addresses_that_are_passed_back(tmp_path):
    text = """
        typedef struct { char a; double b; short c[3]; } Mixed;
        static const short TABLE[] = {1, 2, 4};
        static double ring[sizeof(TABLE) / sizeof(TABLE[0]) * 2];
        static double *scaled(double *x, double k) { *x *= k; return x; }
        double step(double x, int n) {
            long long wide = ((long long)n << 20) >> 3;
            scaled(&x, 2);
            ring[5] = x + sizeof(Mixed) + sizeof(ring);
            return ring[5] + wide;
        }
    """
    (tmp_path / "f.c").write_text(text)
    graph = as_model(read_function_file("f.c:step", tmp_path)).graph
    columns = {"x": np.array([1.0, 2.0]), "n": np.array([3.0, -4.0])}
    expected = 2 * columns["x"] + 24 + 48 + columns["n"] * 2**17
    np.testing.assert_array_equal(evaluate(graph, columns, ParameterSet())["step"], expected)


PASSING = """
typedef struct { double a; double b; } Pair;
static double *bounded(double *x) { if (*x > 2) *x = 2; return x; }
static Pair *same(Pair *pair) { return pair; }
static double *whole(double values[3]) { return values; }
"""


def test_objects_behind_an_address_that_is_passed_back_are_read_and_written(tmp_path):
    body = """
double step(double x) {
    Pair pair = {x, 3};
    double y = x, values[3] = {x, 1, 5};
    *same(&pair) = pair;
    same(&pair)->b += bounded(&y)[0];
    *bounded(&y) -= 1;
    return *bounded(&x) + 10 * same(&pair)->b + 100 * y + 1000 * whole(values)[2];
}
"""
    (tmp_path / "f.c").write_text(PASSING + body)
    x = np.array([-1.0, 1.5, 4.0])
    values = evaluate(as_model(read_function_file("f.c:step", tmp_path)).graph, {"x": x}, ParameterSet())
    low = np.minimum(x, 2)
    np.testing.assert_allclose(values["step"], low + 10 * (3 + low) + 100 * (low - 1) + 5000)


def test_a_function_that_only_passes_an_address_back_is_refused_by_that_reason(tmp_path):
    text = f"{PASSING}double *step(double *x) {{ return x; }}\n"
    assert "f.c line 6: step has no number as a result: it returns an address, that of its argument x, and writes " in (
        _problems(text, tmp_path)
    )
    text = f"{PASSING}double step(double x) {{ return bounded(&x) - &x; }}\n"
    assert "line 6: bounded returns an address, that of its argument x, not a number; read the number behind it" in (
        _problems(text, tmp_path)
    )


def test_a_function_that_is_not_c_does_not_cost_the_others(tmp_path):
    source = """\
#include "bus.h"
#include <stdint.h>
bus_error_t read_bus(bus_t *bus, port_t port, uint8_t *raw)
{
    BUS_LOG("reading %" PRIu8, port);
    return BUS_OK;
}
static bus_error_t wait(bus_t *bus)
{
    UNTIL(bus->ready) { }
    return BUS_OK;
}
double degrees(uint16_t raw) { return (UINT32_C(1) << 4) * raw / INT64_C(65536); }
double waiting(double u, bus_t *bus) { wait(bus); return u; }
"""
    (tmp_path / "f.c").write_text(source)
    model = as_model(read_function_file("f.c:degrees", tmp_path))
    values = evaluate(model.graph, {"raw": np.array([4096.0, 8192.0])}, ParameterSet())["degrees"]
    np.testing.assert_array_equal(values, [1, 2])
    assert "line 10, column" in (problem := _problems(source, tmp_path, "wait"))
    assert "not valid C" in problem
    assert "whose members are not known" in _problems(source, tmp_path, "waiting")
    # what else the text may define is not known
    assert "line 1" in _problems("int a[ = {1};\n" + source, tmp_path, "degrees")

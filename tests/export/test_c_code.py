import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings

from kennfeld import RBF, Axis, Cube, Curve, Expansion, Map, ParameterSet, Scalar, formula
from kennfeld.export.c_code import write_c
from kennfeld.export.host_compiler import HostCompiler
from kennfeld.models import Model
from kennfeld.native.elementwise import ELEMENTARY
from tests.export.compiled import STRICT, hostile, in_c, needs_compiler, prepared, simulated
from tests.graph.random_graphs import cases

TEXT = """
input Speed[rpm]
input Load[%]
lagged[Nm] = PT1(MapTorque(Speed, Load), 0.5)
held = delay(Load, 3, 0) + prev(held, 1) * K
y[Nm] = if(lagged > 3 and not (Load < 1), lagged + Curve(Speed) ^ 3, min(held, Speed)) + Curve(t)
z = Cube(Speed, Load, held) + Flat(Speed, Load) + Single(Load) + round(Load) + mod(Speed, Load) + sign(Load) + abs(Load)
output y
output z
"""
NAMES = ["MapTorque", "Curve", "Cube", "Flat", "Single", "K"]


def _values(seed=1):
    random = np.random.default_rng(seed)
    return ParameterSet(
        [
            # 4 x 3, with unequal axes: a transposed table would be another one
            Map("MapTorque", [0, 1, 2, 5], Axis([-1, 2, 3], name="AxisLoad"), random.normal(size=(4, 3)), unit="Nm"),
            Curve("Curve", Axis([0, 0.7, 1.3, 3, 4.5], free=True), random.normal(size=5), extrapolation="linear"),
            Cube("Cube", [[0, 1, 4], Axis([-1, 2, 3], name="AxisLoad"), [0, 0.5, 2, 7]], random.normal(size=(3, 3, 4))),
            Map("Flat", np.arange(-2.0, 5.0), [2], random.normal(size=(7, 1))),
            Curve("Single", [2], [1.5]),
            Scalar("K", 0.1),
        ]
    )


def _model():
    return formula(TEXT, parameters=NAMES)


def _columns(samples=400, seed=2):
    time = np.arange(samples) * 0.1
    return {**hostile(seed, samples, ("Speed", "Load")), "dt": np.full(samples, 0.1), "t": time}


@needs_compiler
def test_every_kind_of_table_axis_and_memory_is_equal_bit_for_bit():
    arguments = _model(), _values(), _columns(), (0, 150, 151)
    np.testing.assert_array_equal(in_c(*arguments), simulated(*arguments))


@needs_compiler
def test_guards_against_what_is_not_finite_survive_the_compiler():
    model = formula("y = if(x == x, 1 / x, -1) + max(x, 0) * 0 + (if(x > 1, M(x, 2), x) != x)", parameters=["M"])
    values = ParameterSet([Map("M", [0, 1, 2], [1, 3], [[1, 2], [3, 4], [np.inf, np.nan]])])
    columns = hostile(3, 40, ["x"])
    np.testing.assert_array_equal(in_c(model, values, columns), simulated(model, values, columns))


@needs_compiler
def test_the_cell_of_an_axis_with_even_breakpoints_is_that_of_a_search():
    random = np.random.default_rng(6)
    # 9 x 7 breakpoints that are even up to 0.4 of their distance, and 8 that overflow when they are subtracted
    x, y = (0.1 * (np.arange(count) + random.uniform(-0.4, 0.4, count)) - 0.3 for count in (9, 7))
    wide = 1.7e308 * np.linspace(-1, 1, 8)
    values = [Map("M", x, y, random.normal(size=(9, 7))), Curve("Wide", wide, random.normal(size=8))]
    model = formula("z = M(u, v) + Wide(u) + Wide(v)", parameters=["M", "Wide"])
    places = np.concatenate([x, y, wide])
    near = [places, np.nextafter(places, -np.inf), np.nextafter(places, np.inf), random.uniform(-0.5, 0.8, 400)]
    special = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e300, -1e300, 5e-324]
    u = np.concatenate([*near, special])
    columns = {"u": u, "v": random.permutation(u)}
    source = write_c(prepared(model, ParameterSet(values)))["f.c"]
    assert len(re.findall(r"= f_find_even\(", source)) == 2
    assert len(re.findall(r"= f_find\(", source)) == 2
    arguments = model, ParameterSet(values), columns
    np.testing.assert_array_equal(in_c(*arguments), simulated(*arguments))


@needs_compiler
def test_expansions_and_layers_are_equal_up_to_rounding():
    random = np.random.default_rng(4)
    bells = {
        kernel: RBF(
            kernel,
            Expansion(
                1.0,
                [0.5, -1],
                random.normal(size=11),
                random.normal(size=(11, 2)),
                random.uniform(0.3, 2, (11, 2)),
                kernel,
            ),
        )
        for kernel in ("gaussian", "matern52")
    }
    model = formula("y = gaussian(u, v) - matern52(v, u) + tanh(u) * exp(v)", parameters=list(bells))
    columns = {"u": random.normal(size=200), "v": random.normal(size=200)}
    got, expected = (run(model, ParameterSet(bells.values()), columns) for run in (in_c, simulated))
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)


@needs_compiler
def test_single_precision_compiles_without_a_warning_and_is_near():
    # numbers that a comparison decides on are apart from it
    random = np.random.default_rng(5)
    columns = {"Speed": random.uniform(0, 5, 300), "Load": random.uniform(-1, 3, 300), "dt": np.full(300, 0.1)}
    model = formula("y = PT1(MapTorque(Speed, Load), 0.5) + Curve(Speed) ^ 3 + exp(Load) * K", parameters=NAMES)
    single = in_c(model, _values(), columns, precision="float")
    expected = simulated(model, _values(), columns)
    assert 0 < np.max(np.abs(single - expected)) < 2e-5


@needs_compiler
@settings(max_examples=3, deadline=None)
@given(cases())
def test_random_functions_are_equal(case):
    model, names = Model(case.graph), list(case.graph.names)
    got = in_c(model, case.parameters, case.columns, case.starts, outputs=names)
    expected = simulated(model, case.parameters, case.columns, case.starts, outputs=names)
    kinds = {case.parameters[name].kind for name in case.graph.parameters}
    if {node.op for node in case.graph.nodes}.isdisjoint(ELEMENTARY | {"dense"}) and "rbf" not in kinds:
        np.testing.assert_array_equal(got, expected)
    else:
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)


@needs_compiler
def test_sanitizers_find_nothing(tmp_path):
    # a program of its own, since a sanitizer must be loaded before all else
    driver = """
        #include <math.h>
        #include "f.h"
        int main(void)
        {
            static const double x[] = {0.0, -1.0, 2.5, 1e300, -1e300, 7.0};
            f_states s; f_inputs u; f_outputs y; int k;
            f_init(&s);
            for (k = 0; k < 64; k++) {
                u.Speed = (k == 9) ? NAN : x[k % 6]; u.Load = (k == 20) ? INFINITY : x[(k / 6) % 6];
                u.dt = 0.1; u.t = 0.1 * k;
                f_step(&f_defaults, &s, &u, &y);
            }
            return 0;
        }
    """
    (tmp_path / "main.c").write_text(driver)
    for name, text in write_c(prepared(_model(), _values())).items():
        (tmp_path / name).write_text(text)
    checks = ["-fsanitize=undefined,address", "-fno-sanitize-recover=all", "-g"]
    command = [*HostCompiler.find().command, "-std=c99", *checks, "main.c", "f.c", "-o", "main", "-lm"]
    built = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    if built.returncode:
        pytest.skip("the compiler has no sanitizers")
    run = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (0, "")


@pytest.mark.parametrize("compiler", ["clang", "tcc"])
def test_other_compilers_take_the_code_without_a_warning(compiler, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    for precision in ("double", "float"):
        for name, text in write_c(prepared(_model(), _values()), precision).items():
            (tmp_path / name).write_text(text)
        command = [compiler, *(STRICT if compiler == "clang" else ("-Wall", "-Werror")), "-c", "f.c", "-o", "f.o"]
        run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (run.returncode, run.stderr) == (0, "")


def test_equal_functions_give_equal_texts():
    assert write_c(prepared(_model(), _values())) == write_c(prepared(_model(), _values()))


def test_comments_state_names_units_and_lines():
    header, source = write_c(prepared(_model(), _values())).values()
    assert "double Speed; /* [rpm] */" in header
    assert "double MapTorque[12]; /* [Nm], 4 x 3 values, row by x, x by AxisLoad */" in header
    assert "double Curve_x[5]; /* Curve.x, breakpoints of Curve */" in header
    assert "/* lagged [Nm], formula line 4 */" in source


def test_only_functions_that_are_called_are_written():
    _, source = write_c(prepared(formula("y = 2 * x"), ParameterSet())).values()
    assert "static" not in source


def test_all_names_begin_with_that_of_the_function():
    _, source = write_c(prepared(_model(), _values(), name="engine")).values()
    defined = re.findall(r"^(?:static |const |void ).*?(\w+)(?=[\[(]| =)", source, re.MULTILINE)
    assert len(defined) > 10
    assert all(name.startswith("engine_") for name in defined)


@pytest.mark.skipif(sys.platform == "win32", reason="no compiler of C++ is sought there")
def test_the_header_is_one_of_c_plus_plus(tmp_path):
    if shutil.which("g++") is None:
        pytest.skip("g++ is not installed")
    (tmp_path / "f.h").write_text(write_c(prepared(_model(), _values()))["f.h"])
    (tmp_path / "f.cpp").write_text('#include "f.h"\nint main() { f_states s; f_init(&s); return 0; }\n')
    run = subprocess.run(["g++", "-Wall", "-Werror", "-c", "f.cpp"], cwd=tmp_path, capture_output=True, check=False)
    assert run.returncode == 0, run.stderr

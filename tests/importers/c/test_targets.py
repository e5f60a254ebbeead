"""C functions as the processor of an ECU computes them: floats of single precision, and `long` of 32 bits."""

import ctypes

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.function_files import read_function_file
from kennfeld.models.importer import ImportOptions
from kennfeld.models.model_function import as_model
from kennfeld.project.schema import read_project
from tests.importers.c.compiled import compiled_step, needs_compiler

pytest.importorskip("pycparser")

FLOATS = """
#include <math.h>
typedef struct { float gain; float table[3]; } Parameters;
static const Parameters parameters = {0.1f, {0.3, 1.7f, 2.9}};
float step(float u, int n, double *y) {
    static float filtered, counter = 16777216.0f;
    filtered += parameters.gain * (u - filtered);
    counter += 1.0f;
    float z = sqrtf(u * u + 1) * parameters.table[n & 1] / 3 + n * 0.1f;
    *y = filtered * 1.1 + (double)counter + sizeof(float);
    return z > 1 ? z : z - filtered;
}
"""
LONGS = "long step(long a, unsigned long b) { return a * 65537L + (long)(b << 3) + sizeof(long) + (2147483648 > a); }"


def _values(file, folder, columns, **options):
    function = read_function_file(f"{file}:step", folder, options=ImportOptions(**options))
    return evaluate(as_model(function).graph, columns, ParameterSet()), function


@needs_compiler
def test_floats_are_rounded_as_the_compiler_rounds_them(tmp_path):
    (tmp_path / "f.c").write_text(FLOATS)
    output, y = ctypes.POINTER(ctypes.c_double), ctypes.c_double()
    step = compiled_step(tmp_path / "f.c", ctypes.c_float, ctypes.c_float, ctypes.c_int, output)
    rng = np.random.default_rng(0)
    u, n = rng.normal(0, 3, 100), rng.integers(-4, 9, 100)
    expected = np.array([(step(a, b, ctypes.byref(y)), y.value) for a, b in zip(u.tolist(), n.tolist(), strict=True)])
    values, function = _values("f.c", tmp_path, {"u": u, "n": n.astype(float)}, float32=True)
    np.testing.assert_array_equal(np.array([values["step"], values["y"]]).T, expected)
    assert not function.remarks
    doubles, function = _values("f.c", tmp_path, {"u": u, "n": n.astype(float)})
    assert not np.array_equal(doubles["step"], expected[:, 0])
    assert "float is computed in double precision" in function.remarks[0].message


@pytest.mark.parametrize(
    ("code", "differs"),
    [("0.1f * u", True), ("u + (float)u", True), ("sqrtf(u)", True), ("2.0f * u", False), ("u / 3.0", False)],
)
def test_a_remark_says_where_numbers_of_single_precision_are_not_rounded(code, differs, tmp_path):
    (tmp_path / "f.c").write_text(f"#include <math.h>\ndouble step(double u) {{\n    return {code};\n}}\n")
    _, function = _values("f.c", tmp_path, {"u": np.ones(1)})
    assert any("float is computed in double" in remark.message for remark in function.remarks) == differs
    (tmp_path / "g.c").write_text("float step(double u) {\n    return u;\n}\n")
    _, function = _values("g.c", tmp_path, {"u": np.ones(1)})
    assert "float is computed in double" in function.remarks[0].message


def test_a_long_of_32_bits_wraps(tmp_path):
    (tmp_path / "f.c").write_text(LONGS)
    rng = np.random.default_rng(1)
    a, b = rng.integers(-(2**31), 2**31, 50), rng.integers(0, 2**32, 50)
    values, _ = _values("f.c", tmp_path, {"a": a.astype(float), "b": b.astype(float)}, target="ilp32")
    expected = (a * 65537 + (b << 3) + 4 + 1 + 2**31) % 2**32 - 2**31
    np.testing.assert_array_equal(values["step"], expected)


@pytest.mark.parametrize(("target", "bytes_"), [("ilp32", 4), ("lp64", 8)])
def test_pointers_have_the_size_of_the_target_in_sizes_of_arrays_as_in_expressions(target, bytes_, tmp_path):
    text = """
        typedef struct { double number; } Part;
        typedef struct { Part *where; short last; } Link;
        static double ring[sizeof(double *)], links[sizeof(Link)];
        double step(double x) { return x + sizeof(ring) + 1000.0 * sizeof(links) + 1e6 * sizeof(Link *); }
    """
    (tmp_path / "f.c").write_text(text)
    values, _ = _values("f.c", tmp_path, {"x": np.zeros(1)}, target=target)
    assert values["step"].tolist() == [8 * bytes_ + 16e3 * bytes_ + 1e6 * bytes_]


def test_a_project_names_the_target(tmp_path):
    rest = """
        [[dataset]]
        files = ["a.csv"]
        [[criterion]]
        node = "step"
        target = "m"
    """
    file = tmp_path / "kennfeld.toml"
    file.write_text(f'[model]\nfile = "f.c:step"\ntarget = "ilp32"\nfloat32 = true\n{rest}')
    options = read_project(file).import_request().options
    assert (options.target, options.float32) == ("ilp32", True)
    file.write_text(f'[model]\nfile = "f.onnx"\ntarget = "ilp32"\n{rest}')
    with pytest.raises(InputError, match=r"target requires a C file, got f\.onnx"):
        read_project(file)

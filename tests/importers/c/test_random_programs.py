"""Random functions in C with floats of single precision, against the same functions compiled, and as formula text."""

import ctypes

import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.formula import formula, to_text
from kennfeld.models.function_files import read_function_file
from kennfeld.models.importer import ImportOptions
from kennfeld.models.model_function import as_model
from tests.draws import mostly_slow
from tests.importers.c.compiled import compiled_step, needs_compiler
from tests.importers.c.random_programs import Program

pytest.importorskip("pycparser")
RNG = np.random.default_rng(0)
U, V, N = RNG.normal(0, 3, 25).astype(np.float32), RNG.normal(0, 3, 25), RNG.integers(-4, 20, 25)
COLUMNS = {"u": U.astype(float), "v": V, "n": N.astype(float)}


def compiled(folder):
    step = compiled_step(folder / "f.c", ctypes.c_double, ctypes.c_float, ctypes.c_double, ctypes.c_int)
    return np.array([step(*sample) for sample in zip(U.tolist(), V.tolist(), N.tolist(), strict=True)])


@needs_compiler
@pytest.mark.parametrize("seed", mostly_slow(range(100), 3))
def test_a_program_of_floats_computes_what_the_compiler_makes_of_it(seed, tmp_path):
    (tmp_path / "f.c").write_text(Program(seed).text)
    expected = compiled(tmp_path)
    graph = as_model(read_function_file("f.c:step", tmp_path, options=ImportOptions(float32=True))).graph
    np.testing.assert_array_equal(evaluate(graph, COLUMNS, ParameterSet())["step"], expected)
    read = formula(to_text(graph)).graph
    np.testing.assert_array_equal(evaluate(read, COLUMNS, ParameterSet())["step"], expected)

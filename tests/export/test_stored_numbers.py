import numpy as np
import pytest

from kennfeld import Cube, Curve, Map, ParameterSet, Scalar, formula
from kennfeld.base.errors import InputError
from kennfeld.cli import run
from kennfeld.domain.storage import FloatStorage, StorageGrid, StorageRounding
from kennfeld.export.api import export_function
from kennfeld.export.c_code import write_c
from kennfeld.export.host_compiler import CompiledFunction, HostCompiler
from kennfeld.export.stored_numbers import with_stored_numbers
from kennfeld.project import Project
from tests.export.compiled import STRICT, hostile, needs_compiler, prepared, simulated

GRIDS = {
    "Byte": StorageGrid(0.7, -3.0, 1.0, 0.0, 255.0, 8),
    "Word": StorageGrid(-1.0, 0.0, 128.0, -32768.0, 32767.0, 16),
    "Long": StorageGrid(1e-3, 0.0, 1.0, -(2.0**31), 2.0**31 - 1, 32),
    "Step": StorageGrid.of_step(0.1),
    "K": StorageGrid.of_step(0.25),
}
TEXT = "y = Byte(u, v) * K + Word(u) - Long(u, v, u) + Step(v) * F(v) + Byte(v, u) * Plain(u)"
X, Y = [0.0, 1, 2, 5], [-1.0, 2, 3]


def _values():
    random = np.random.default_rng(3)

    def on_grid(name, *shape):
        grid = GRIDS[name]
        low, high = (grid.least, grid.largest) if grid.bits else (-100.0, 100.0)
        return grid.values(np.floor(random.uniform(low, high + 1, shape)))

    longs = on_grid("Long", 2, 3, 2)
    longs[0, 0, 0] = GRIDS["Long"].values(np.array(-(2.0**31)))  # has no literal of its own in C
    return ParameterSet(
        [
            # 4 x 3 with unequal axes: a transposed table would be another one
            Map("Byte", X, Y, on_grid("Byte", 4, 3)),
            Curve("Word", X, on_grid("Word", 4)),
            Cube("Long", [[0, 4], Y, [1, 2]], longs),
            Curve("Step", Y, on_grid("Step", 3)),
            Curve("F", Y, np.float64(np.float32(random.normal(size=3)))),
            Curve("Plain", X, random.normal(size=4)),
            Scalar("K", 1.75),
        ]
    )


def _function(values, **grids):
    rounding = StorageRounding(grids={**GRIDS, **grids}, floats={"F": FloatStorage(single=True)})
    return with_stored_numbers(prepared(formula(TEXT, parameters=list(values)), values), rounding)


@needs_compiler
def test_stored_numbers_give_the_bits_of_the_values():
    values, columns = _values(), hostile(1, 300, ["u", "v"])
    function, remarks = _function(values)
    kinds = {p.name: p.stored.kind for p in function.parameters if p.stored is not None}
    assert kinds == {
        "Byte": "uint8_t",
        "Word": "int16_t",
        "Long": "int32_t",
        "Step": "int8_t",
        "K": "uint8_t",
        "F": "float",
    }
    assert [str(remark) for remark in remarks] == ["f: Plain is written in floating point: its step is not known"]
    compiled = CompiledFunction(function, "double", HostCompiler.find(), STRICT)
    expected = simulated(formula(TEXT, parameters=list(values)), values, columns)
    np.testing.assert_array_equal(compiled.over(columns, 300), expected)
    CompiledFunction(function, "float", HostCompiler.find(), STRICT)


def test_values_between_two_steps_stay_in_floating_point_and_a_remark_says_so():
    values = _values()
    table = values["Word"]
    off = values.with_parameters(table.with_values(table.values + np.array([0, 1e-4, 0, 0])))
    function, remarks = _function(off)
    assert function.parameter("Word").stored is None
    assert "Word is written in floating point: 1 value between two steps of 0.0078125" in str(remarks[0])


def test_the_header_states_types_and_conversions():
    header = write_c(_function(_values())[0])["f.h"]
    assert "    uint8_t Byte[12]; /* value = 0.7 * number - 3, 4 x 3 values, row by x" in header
    assert "    int16_t Word[4]; /* value = (-1 * number) / 128" in header
    assert "    float F[3]; /*" in header
    assert "    double Plain[4]; /*" in header


PROJECT = """
[model]
file = "f.kf"
[[dataset]]
name = "bench"
files = ["bench.csv"]
[calibration]
rounding = "joint"
[parameters.M]
x = { input = "n", breakpoints = [0, 1, 3] }
y = { input = "load", breakpoints = [0, 2] }
initial = [[1.0, 2.0], [3.0, 5.5], [8.0, 13.0]]
step = 0.5
[[criterion]]
node = "y"
target = { channel = "torque" }
"""


@pytest.fixture
def project(tmp_path):
    (tmp_path / "kennfeld.toml").write_text(PROJECT)
    (tmp_path / "f.kf").write_text("y[Nm] = M(n, load) + 0.1 * n\n")
    rows = [f"{k % 7 / 2},{k % 5 / 3},{k}" for k in range(40)]
    (tmp_path / "bench.csv").write_text("\n".join(["n,load,torque", *rows]) + "\n")
    return tmp_path / "kennfeld.toml"


@needs_compiler
def test_the_command_writes_tables_as_stored_and_checks_them(project, capsys):
    assert run(["export", str(project), "--to", "c", "--stored"]) == 0
    assert "equal to the simulation, bit for bit" in capsys.readouterr().out
    assert "    uint8_t M[6]; /* value = number / 2, 3 x 2 values, row by x" in (project.parent / "f.h").read_text()


def test_a_project_that_does_not_know_its_storage_is_refused(project):
    project.write_text(PROJECT.replace('rounding = "joint"', "").replace("step = 0.5", ""))
    with pytest.raises(InputError, match="it is not known how a control unit stores the values"):
        export_function(Project.read(project), folder=project.parent, stored=True)

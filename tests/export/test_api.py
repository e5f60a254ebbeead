from pathlib import Path

import numpy as np
import pytest

from kennfeld import ArgumentError, InputError, Project, export_function, formula
from kennfeld.cli import run
from kennfeld.export.comparison import CodeComparison, OutputDeviation, deviations
from kennfeld.export.host_compiler import CompilationError, HostCompiler
from tests.export.compiled import needs_compiler

EXAMPLES = Path(__file__).parents[2] / "examples"
PROJECT = """
[model]
file = "engine model.kf"
[[dataset]]
name = "bench"
files = ["bench.csv"]
[parameters.M]
x = { input = "n", breakpoints = [0, 1, 3] }
y = { input = "load", breakpoints = [0, 2] }
initial = [[1.0, 2.0], [3.0, 5.0], [8.0, 13.0]]
unit = "Nm"
[[criterion]]
node = "y"
target = { channel = "torque" }
"""


@pytest.fixture
def project(tmp_path):
    (tmp_path / "kennfeld.toml").write_text(PROJECT)
    (tmp_path / "engine model.kf").write_text("y[Nm] = M(n, load) + 0.1 * n\n")
    rows = [f"{k % 7 / 2},{k % 5 / 3},{k}" for k in range(40)]
    (tmp_path / "bench.csv").write_text("\n".join(["n,load,torque", *rows]) + "\n")
    return tmp_path / "kennfeld.toml"


@needs_compiler
def test_the_code_of_a_project_is_compared_with_its_data(project, tmp_path):
    done = export_function(Project.read(project), folder=tmp_path / "out")
    assert [path.name for path in done.files] == ["engine_model.c", "engine_model.h"]
    assert str(done.comparison).endswith("over 40 samples: equal to the simulation, bit for bit")
    single = export_function(Project.read(project), folder=tmp_path / "out", precision="float")
    (output,) = single.comparison.outputs
    assert 0 < output.largest < 1e-5
    assert output.unit == "Nm"


@needs_compiler
def test_other_values_replace_those_of_the_project(project, tmp_path):
    values = Project.read(project).problem().parameters
    changed = values.with_parameters(values["M"].with_values(np.full((3, 2), 7.5)))
    export_function(Project.read(project), changed, tmp_path / "after")
    assert (tmp_path / "after" / "engine_model.c").read_text().count("7.5") == 6


def test_files_are_replaced_together_or_not_at_all(tmp_path):
    export_function("y = 2 * x", folder=tmp_path, name="f")
    before = {path.name: path.read_text() for path in tmp_path.iterdir()}
    (tmp_path / "f.h").unlink()
    (tmp_path / "f.h").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        export_function("y = 3 * x", folder=tmp_path, name="f")
    assert (tmp_path / "f.c").read_text() == before["f.c"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["f.c", "f.h"]


def test_unusable_arguments_are_named(tmp_path):
    model = formula("y = x")
    for arguments, sentence in (
        ({"to": "rust"}, "to='rust' must be 'c' or 'fmu' or 'm'"),
        ({"precision": "half"}, "precision='half' must be 'double' or 'float'"),
        ({"to": "m", "precision": "float"}, "precision='float' is for to='c', not for to='m'"),
        ({"to": "fmu", "step": 0.0}, "step=0.0 must be > 0"),
    ):
        with pytest.raises(ArgumentError) as error:
            export_function(model, folder=tmp_path, **arguments)
        assert str(error.value) == sentence
    assert not list(tmp_path.iterdir())


@needs_compiler
def test_a_compiler_that_fails_is_an_error_with_its_message(project, tmp_path, monkeypatch):
    monkeypatch.setattr(HostCompiler, "find", lambda: HostCompiler(("false",)))
    with pytest.raises(CompilationError, match="false fails"):
        export_function(Project.read(project), folder=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_without_a_compiler_the_code_is_written_and_a_remark_says_that_it_is_not_checked(
    project, tmp_path, monkeypatch
):
    monkeypatch.setattr(HostCompiler, "find", lambda: None)
    done = export_function(Project.read(project), folder=tmp_path / "out")
    assert done.comparison is None
    assert "the code is not checked: this machine has no C compiler" in str(done.findings[0])


def test_a_value_that_is_not_finite_on_one_side_only_deviates_without_limit():
    got, expected = np.array([[1.0, np.nan], [np.inf, 2.0]]), np.array([[1.0, np.nan], [1.0, 2.5]])
    assert deviations(got, expected).tolist() == [0.0, np.inf]


def test_code_that_no_data_were_compared_with_is_not_called_equal():
    comparison = CodeComparison("cc", 0, (OutputDeviation("y", "", 0.0, 0.0),))
    assert not comparison.is_exact
    assert str(comparison) == "compiled with cc, but not compared: the data have no samples"


@needs_compiler
def test_an_output_that_is_nan_throughout_is_compared_without_a_warning(project, tmp_path):
    values = Project.read(project).problem().parameters
    unknown = values.with_parameters(values["M"].with_values(np.full((3, 2), np.nan)))
    comparison = export_function(Project.read(project), unknown, tmp_path / "out").comparison
    assert comparison.is_exact
    assert comparison.outputs[0].range == 0


def test_the_command_warns_of_values_that_are_not_calibrated(project, capsys):
    assert run(["export", str(project), "--to", "m"]) == 0
    out, err = capsys.readouterr()
    assert "has no results: the initial values are exported. Calibrate it, or name a file with -p." in err
    assert "engine_model.m" in out
    assert "engine_model_defaults.m" in out


@needs_compiler
def test_the_command_takes_the_values_of_the_last_calibration(project, capsys, tmp_path):
    assert run(["calibrate", str(project), "-q"]) == 0
    assert run(["export", str(project), "--to", "c", "-o", str(tmp_path / "code")]) == 0
    out, err = capsys.readouterr()
    assert f"values: {project.parent / 'results' / 'parameters.json'}" in out
    assert "equal to the simulation, bit for bit" in out
    assert err == ""


@needs_compiler
@pytest.mark.slow
@pytest.mark.guests
@pytest.mark.parametrize("name", ["air-flow", "exhaust-temperature", "idle-speed", "nox", "simulink"])
def test_every_example_is_exported(name, tmp_path):
    done = export_function(Project.read(EXAMPLES / name / "kennfeld.toml"), folder=tmp_path)
    ranges = [max(output.range, 1.0) for output in done.comparison.outputs]
    assert all(y.largest <= 1e-12 * size for y, size in zip(done.comparison.outputs, ranges, strict=True))

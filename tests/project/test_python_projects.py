"""Projects that call functions in Python."""

import pytest

from kennfeld import cli
from kennfeld.base.errors import InputError
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.project import Project
from tests.draws import mostly_slow
from tests.project.partitioned_projects import TIMED, in_partitions, write_timed

CODE = """\
import numpy as np


def gain(x, k):
    parts = {"bend": np.tanh(x), "line": k * x}
    return parts["bend"] + parts["line"]
"""
TEXT = TIMED + '\n[functions]\ngain = "gain.py:gain"\n'


def write_calling(folder, model="Lagged = PT1(gain(K(u), 0.5), T)"):
    """Write recordings of a lag, and a model that calls a function which cannot be translated."""
    path = write_timed(folder, files=2, samples=150, text=TEXT)
    (folder / "lag.kf").write_text(f"input u\n{model}\n")
    (folder / "gain.py").write_text(CODE)
    return path


@pytest.mark.guests
@pytest.mark.parametrize("size", mostly_slow([120, 10**6], 1))
@pytest.mark.parametrize("model", ["Lagged = PT1(gain(K(u), 0.5), T)", "Lagged = gain(K(u), T)"])
def test_functions_give_the_same_values_over_partitions_as_over_all_samples(tmp_path, size, model):
    path = write_calling(tmp_path, model)
    whole, parted = (CompiledProblem(each.problem()) for each in (Project.read(path), in_partitions(path, size)))
    for factor in (1.0, 1.1):
        ours, theirs = (each.sums.normal(whole.start * factor) for each in (parted, whole))
        assert ours.gradient == pytest.approx(theirs.gradient, rel=1e-9)
        assert parted.sums.cost(whole.start * factor) == pytest.approx(whole.sums.cost(whole.start * factor))


@pytest.mark.guests
def test_a_project_with_a_function_in_python_is_calibrated(tmp_path, capsys):
    path = write_calling(tmp_path)
    assert cli.run(["check", "--trust", str(path)]) == 0
    assert "line 5 cannot be translated" in capsys.readouterr().err
    whole = Project.read(path).calibrate()
    parted = in_partitions(path, 150).calibrate()
    for name in ("K", "T"):
        assert parted.parameters[name].values == pytest.approx(whole.parameters[name].values, rel=1e-6)


def test_a_function_whose_file_is_missing_or_a_folder_is_an_error(tmp_path):
    path = write_calling(tmp_path)
    (tmp_path / "gain.py").rename(tmp_path / "gains.py")
    with pytest.raises(InputError, match=r"file gain\.py:gain does not exist. Did you mean gains\.py\?"):
        Project.read(path).problem()
    (tmp_path / "gain.py").mkdir()
    with pytest.raises(InputError, match=r"gain\.py is a folder"):
        Project.read(path).problem()


@pytest.mark.guests
def test_an_input_of_a_function_in_a_file_is_set_to_a_number_and_does_not_become_a_parameter(tmp_path):
    (tmp_path / "twice.py").write_text("def twice(u, k):\n    return k * u\n")
    (tmp_path / "bench.csv").write_text("u,y\n1,2\n2,4\n")
    text = '[model]\nfile = "twice.py:twice"\n[[dataset]]\nfiles = "bench.csv"\n'
    text += '[[criterion]]\nnode = "twice"\ntarget = 1\n'
    path = tmp_path / "kennfeld.toml"
    path.write_text(text)
    (error,) = (str(finding) for finding in Project.read(path).check() if finding.severity == "error")
    assert error.endswith('[channels]: k = "..."; or set it to a number: [calculated] k = "1.0".')
    path.write_text(text + '[calculated]\nk = "1.0"\n')
    assert [finding for finding in Project.read(path).check() if finding.severity == "error"] == []

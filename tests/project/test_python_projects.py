"""Projects that call functions in Python."""

import pytest
from partitioned_projects import TIMED, in_partitions, write_timed

from kennfeld import cli
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.project import Project

CODE = """\
import numpy as np


def gain(x, k):
    parts = [np.tanh(x), k * x]
    return sum(parts)
"""
TEXT = TIMED + '\n[functions]\ngain = "gain.py:gain"\n'


def write_calling(folder, model="Lagged = PT1(gain(K(u), 0.5), T)"):
    """Write recordings of a lag, and a model that calls a function which cannot be translated."""
    path = write_timed(folder, text=TEXT)
    (folder / "lag.kf").write_text(f"input u\n{model}\n")
    (folder / "gain.py").write_text(CODE)
    return path


@pytest.mark.parametrize("size", [300, 10**6])
@pytest.mark.parametrize("model", ["Lagged = PT1(gain(K(u), 0.5), T)", "Lagged = gain(K(u), T)"])
def test_functions_over_partitions_give_what_they_give_for_all_samples(tmp_path, size, model):
    path = write_calling(tmp_path, model)
    whole, parted = (CompiledProblem(each.problem()) for each in (Project.read(path), in_partitions(path, size)))
    for factor in (1.0, 1.1):
        ours, theirs = (each.sums.normal(whole.start * factor) for each in (parted, whole))
        assert ours.gradient == pytest.approx(theirs.gradient, rel=1e-9)
        assert parted.sums.cost(whole.start * factor) == pytest.approx(whole.sums.cost(whole.start * factor))


def test_a_project_with_a_function_in_python_is_calibrated(tmp_path, capsys):
    path = write_calling(tmp_path)
    assert cli.run(["check", str(path)]) == 0
    assert "line 5 cannot be translated" in capsys.readouterr().err
    assert cli.run(["calibrate", str(path)]) == 0
    whole = Project.read(path).calibrate()
    parted = in_partitions(path, 500).calibrate()
    for name in ("K", "T"):
        assert parted.parameters[name].values == pytest.approx(whole.parameters[name].values, rel=1e-6)

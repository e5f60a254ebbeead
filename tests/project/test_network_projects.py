"""Projects whose formula text calls an ONNX network."""

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")

from networks import perceptron, random_layers

from kennfeld.calfiles import write
from kennfeld.errors import InputError
from kennfeld.parameter_set import ParameterSet
from kennfeld.project import Project

PROJECT = """
[model]
file = "f.kf"
{model}
[functions]
net = "net.onnx"

[[dataset]]
files = ["data.csv"]

[parameters.C]
x = {{ begin = -1.0, end = 1.0, count = 5 }}
initial = 0.1
{parameters}
[[criterion]]
node = "y"
target = "target"
"""


@pytest.fixture
def project_of(tmp_path):
    """Write a project with further lines of its model and its parameters."""
    perceptron(tmp_path / "net.onnx", random_layers([2, 8, 1]))
    (tmp_path / "f.kf").write_text("y = net(C(u), v)\n")
    u, v = np.random.default_rng(0).uniform(-1, 1, (2, 200))
    rows = "\n".join(f"{a},{b},{np.sin(a) + b}" for a, b in zip(u, v, strict=True))
    (tmp_path / "data.csv").write_text(f"u,v,target\n{rows}\n")

    def write_project(parameters="", model=""):
        path = tmp_path / "kennfeld.toml"
        path.write_text(PROJECT.format(parameters=parameters, model=model))
        return Project.read(path)

    return write_project


def test_the_weights_of_a_network_stay_as_they_are(project_of):
    problem = project_of().problem()
    assert problem.free_names == ("C",)
    result = project_of().calibrate()
    assert result.parameters["net.layer1"] == problem.parameters["net.layer1"]
    assert result.quality[0].rmse_after < result.quality[0].rmse_before


def test_a_section_frees_the_weights_of_a_layer(project_of):
    problem = project_of('[parameters."net.layer2"]\nfree = true').problem()
    assert set(problem.free_names) == {"net.layer2", "C"}
    assert not project_of('[parameters."net.layer2"]\nlock = "no-data"').problem().parameters["net.layer2"].locked.any()


def test_directions_of_weights_that_the_data_leave_undetermined_are_described(project_of):
    result = project_of('[parameters."net.layer1"]\nfree = true\n[parameters."net.layer2"]\nfree = true').calibrate()
    assert result.trust.directions


def test_weights_of_an_initial_file_replace_those_of_the_network_and_stay_locked(project_of, tmp_path):
    block = project_of().problem().parameters["net.layer1"]
    write(ParameterSet([block.with_values(block.values + 1)]), tmp_path / "start.dcm")
    problem = project_of("", "").problem()
    text = (tmp_path / "kennfeld.toml").read_text() + '\n[calibration]\ninitial = "start.dcm"\n'
    (tmp_path / "kennfeld.toml").write_text(text)
    changed = Project.read(tmp_path / "kennfeld.toml").problem()
    np.testing.assert_array_equal(changed.parameters["net.layer1"].values, block.values + 1)
    assert changed.free_names == problem.free_names


def test_a_network_is_the_model_of_a_project(project_of, tmp_path):
    project_of()
    perceptron(tmp_path / "whole.onnx", random_layers([1, 4, 1]))
    text = '[model]\nfile = "whole.onnx"\n[channels]\nx = "u"\n[[dataset]]\nfiles = ["data.csv"]\n'
    text += '[parameters.layer2]\nfree = true\n[[criterion]]\nnode = "y"\ntarget = "target"\n'
    (tmp_path / "kennfeld.toml").write_text(text)
    assert Project.read(tmp_path / "kennfeld.toml").problem().free_names == ("layer2",)


def test_a_damaged_network_is_a_finding_of_the_project(project_of, tmp_path):
    project = project_of()
    (tmp_path / "net.onnx").write_bytes(b"\x01\x02\x03")
    with pytest.raises(InputError, match="not an ONNX file"):
        project.problem()

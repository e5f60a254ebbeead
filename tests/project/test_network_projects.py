"""Projects whose formula text calls an ONNX network."""

import json
import shutil

import numpy as np
import pyarrow.parquet
import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")

from kennfeld.base.errors import InputError
from kennfeld.calfiles import write
from kennfeld.cli import run
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.project import Project
from tests.importers.onnx.networks import perceptron, random_layers

pytestmark = pytest.mark.guests

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


def write_project_of(folder, parameters="", model=""):
    """Write a project with further lines of its model and its parameters; return its file."""
    perceptron(folder / "net.onnx", random_layers([2, 5, 1]))
    (folder / "f.kf").write_text("y = net(C(u), v)\n")
    u, v = np.random.default_rng(0).uniform(-1, 1, (2, 200))
    noise = 0.02 * np.random.default_rng(1).standard_normal(200)
    rows = "\n".join(f"{a},{b},{np.sin(a) + b + e}" for a, b, e in zip(u, v, noise, strict=True))
    (folder / "data.csv").write_text(f"u,v,target\n{rows}\n")
    (folder / "kennfeld.toml").write_text(PROJECT.format(parameters=parameters, model=model))
    return folder / "kennfeld.toml"


@pytest.fixture
def project_of(tmp_path):
    """Write and read a project with further lines of its model and its parameters."""
    return lambda parameters="", model="": Project.read(write_project_of(tmp_path, parameters, model))


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


@pytest.mark.slow
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


FITTED = '[parameters."net.layer1"]\nfree = true\n[parameters."net.layer2"]\nfree = true'
ROUGH = "\n[optimizer]\ntolerance = 1e-3\n"


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """A folder with a project whose weights were fitted, and their files in all formats; no test changes it."""
    folder = tmp_path_factory.mktemp("calibrated")
    path = write_project_of(folder, FITTED + '\n[calibration]\noutput = ["dcm", "cdfx", "csv"]\n' + ROUGH)
    assert run(["check", str(path)]) == run(["calibrate", str(path)]) == 0
    return folder


@pytest.mark.parametrize("ending", ["dcm", "cdfx", "csv", "json"])
def test_fitted_weights_simulate_to_the_same_errors_from_each_file(calibrated, tmp_path, ending):
    folder = shutil.copytree(calibrated, tmp_path / "project")
    result = json.loads((folder / "results" / "result.json").read_text())
    fitted = result["quality"][0]["rmse_after"]
    assert fitted < 0.5 * result["quality"][0]["rmse_before"]
    assert (folder / "results" / "report.html").stat().st_size
    path = folder / "kennfeld.toml"
    text = path.read_text().replace("initial = 0.1", "")
    path.write_text(text.replace("output =", f'initial = "results/parameters.{ending}"\noutput ='))
    assert run(["simulate", str(path)]) == 0
    simulated = pyarrow.parquet.read_table(folder / "simulation.parquet")
    error = simulated["y"].to_numpy() - simulated["target"].to_numpy()
    assert np.sqrt(np.mean(error**2)) == pytest.approx(fitted, rel=1e-9)


@pytest.mark.slow
def test_poorly_determined_weights_are_summarised_in_one_sentence_without_advice_for_tables(project_of):
    trust = project_of(FITTED + ROUGH).calibrate().trust
    of_weights = [d for d in trust.directions if "weights of net.layer" in d.sentence]
    only_weights = [d for d in of_weights if not d.parts.keys() - {"net.layer1", "net.layer2"}]
    assert len(only_weights) <= 1
    text = "\n".join(map(str, of_weights))
    assert "The data hardly determine" in text
    for word in ("smoothness", "row", "Scaling net", "pin net", "Pin a known value of net"):
        assert word not in text


def test_positions_of_a_value_block_are_locked_by_ranges(project_of):
    block = (
        project_of('[parameters."net.layer2"]\nlock = [{ x = [5, 5], y = [0, 0] }]').problem().parameters["net.layer2"]
    )
    assert block.locked.ravel().tolist() == [False] * 5 + [True]


def test_a_network_that_starts_at_zero_is_a_warning_and_fitted_from_other_weights(project_of, tmp_path):
    project = project_of(FITTED + ROUGH)
    perceptron(tmp_path / "net.onnx", [(np.zeros((2, 8)), np.zeros(8)), (np.zeros((8, 1)), np.zeros(1))])
    warnings = [str(finding) for finding in project.check() if finding.severity == "warning"]
    assert any("[parameters.net.layer1] initial: all weights are 0" in text for text in warnings)
    result = project.calibrate()
    assert "It started with different weights." in result.message
    assert result.quality[0].r2_after > 0.9


def test_neurons_that_start_with_equal_weights_are_a_warning(project_of, tmp_path):
    project = project_of(FITTED + "\n[optimizer]\nmax_iterations = 1\n")
    perceptron(tmp_path / "net.onnx", [(np.ones((2, 8)), np.zeros(8)), (np.ones((8, 1)), np.zeros(1))])
    (warning,) = [str(finding) for finding in project.check() if finding.severity == "warning"]
    assert "8 of 8 neurons of net.layer1 start with equal weights" in warning
    assert any("8 of 8 neurons" in str(warning) for warning in project.calibrate().warnings)

"""Actions of a project: problem, calibration, simulation."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles import read as read_parameters
from kennfeld.domain.axis import Axis
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map, Scalar
from kennfeld.project import Project
from kennfeld.project.demo import torque


def test_a_project_is_calibrated_to_the_values_behind_the_data(shop):
    lines = []
    result = shop.project.calibrate(lines.append)
    assert result.status == "converged"
    np.testing.assert_allclose(result.parameters["Gain"].values, [1, 2, 3], rtol=1e-6)
    assert result.parameters["offset"].value == pytest.approx(5, rel=1e-6)
    assert lines
    assert 0 < result.seconds.read < result.seconds.total


def test_the_published_torque_problem_runs_from_its_files(shop):
    shop.text = torque.FORMULA
    torque.start().save(shop.folder / "start.dcm")
    for data in (torque.bench(), torque.fresh(200)):
        shop.csv(f"{data.name}.csv", {f"{c.name} [{c.unit}]": c.values for c in data.channels})
    tables = "\n".join(f"[parameters.{name}]\nsmoothness = {s}" for name, s in torque.SMOOTHNESS.items())
    shop.toml = (
        "model.file = 'sensor.kf'\n[calibration]\ninitial = 'start.dcm'\n[[dataset]]\nfiles = 'bench.csv'\n"
        f"[[dataset]]\nfiles = 'fresh.csv'\nuse = 'test'\n{tables}\n"
        "[[criterion]]\nnode = 'TorquePredict'\ntarget = 'Torque'\n[optimizer]\ncontinuation = 'off'\n"
    )
    assert shop.findings() == []
    bench, fresh = shop.project.calibrate().quality
    assert (bench.samples, fresh.use) == (2812, "test")
    assert bench.rmse_before > 70
    assert max(bench.rmse_after, fresh.rmse_after) < 2.2


def test_the_solver_uses_the_options_of_the_project(shop):
    result = shop.add("[optimizer]\nmax_iterations = 1\ncontinuation = 'off'").project.calibrate()
    assert result.status == "max_iterations"


def test_the_search_of_a_project_ends_in_its_time_or_in_that_of_the_call(shop):
    project = shop.add("[optimizer]\nmax_seconds = 1e-9\ncontinuation = 'off'").project
    result = project.calibrate()
    assert (result.status, len(result.trace)) == ("stopped", 1)
    assert "max_seconds = 1e-09" in result.message
    assert "max_seconds = 2e-09" in project.calibrate(max_seconds=2e-9).message


def test_files_are_read_once(shop, monkeypatch):
    from kennfeld.measurement import cache

    read, paths = cache.read_leniently, []
    monkeypatch.setattr(cache, "read_leniently", lambda path, *rest: paths.append(path) or read(path, *rest))
    project = shop.project
    assert project.seconds_read == 0
    project.check()
    project.calibrate()
    project.simulate()
    assert len(paths) == 1
    assert project.seconds_read > 0


def test_a_wrong_project_raises_all_its_findings(shop):
    shop.change('"bench.csv"', '"bnch.csv"').change('"start.json"', '"strt.json"')
    project = shop.project
    with pytest.raises(InputError) as raised:
        project.problem()
    assert [finding for finding in project.check() if finding.severity == "error"] == list(raised.value.findings)
    with pytest.raises(InputError):
        project.calibrate()
    with pytest.raises(InputError):
        project.simulate()


def test_simulation_gives_all_nodes_and_the_targets_of_every_dataset(shop):
    shop.bench("other.csv", [1100, 2900])
    shop.add('[[dataset]]\nfiles = "other.csv"\nuse = "test"')
    bench, other = shop.project.simulate()
    assert isinstance(bench, Dataset)
    assert list(bench) == ["base", "Predict", "Torque"]
    assert (bench.name, other.name, other.use) == ("bench", "other", "test")
    assert bench["Predict"].values.tolist() == [10, 11, 12, 13, 10, 11]
    assert bench["Torque"].unit == "Nm"


def test_simulation_takes_other_values(shop):
    (data,) = shop.project.simulate(ParameterSet([Scalar("offset", 100.0)]))
    assert data["Predict"].values.tolist() == [110, 111, 112, 113, 110, 111]
    finer = ParameterSet([Curve("Gain", [1000, 1500], [1.0, 2.0])])
    (data,) = shop.project.simulate(finer)
    assert data["Predict"].values.tolist() == [10, 22, 24, 26, 20, pytest.approx(11 * 1.4)]


def test_simulation_refuses_tables_that_do_not_fit(shop):
    with pytest.raises(InputError, match="Gain is a map of 1 x 1 values, but the function looks it up"):
        shop.project.simulate(ParameterSet([Map("Gain", [1], [1], [[1]])]))


def test_a_simulated_target_with_the_name_of_a_node_gets_a_suffix(shop):
    shop.bench("bench.csv", base=np.arange(6))
    shop.add('[[criterion]]\nnode = "Predict"\ntarget = { channel = "base" }')
    (data,) = shop.project.simulate()
    assert data["base (target)"].values.tolist() == [0, 1, 2, 3, 4, 5]
    assert data["base"].values.tolist() == [10, 11, 12, 13, 10, 11]


def test_a_model_with_memory_is_calibrated_on_its_own_step(shop):
    time, u = np.arange(200) * 0.1, np.repeat([0.0, 1.0, 0.3, 2.0, 1.2], 40)
    repeated = np.repeat(u, 2)[:399]  # as set values are between their samples
    y, state = [], repeated[0] * 3
    for k, x in enumerate(repeated):
        state = 3 * x if k == 0 else state + 0.05 / (0.8 + 0.05) * (3 * x - state)
        y.append(state)
    shop.csv("bench.csv", {"time": time, "u": u + 0.0, "y": np.array(y)[::2]})
    shop.text = "step 0.05\nout = PT1(k * u, T)\n"
    shop.toml = (
        "model.file = 'sensor.kf'\n[[dataset]]\nfiles = 'bench.csv'\n[[criterion]]\nnode = 'out'\ntarget = 'y'\n"
        "[parameters.k]\ninitial = 1\n[parameters.T]\ninitial = 2\nbounds = [0, inf]\n"
    )
    assert shop.findings() == []
    result = shop.project.calibrate()
    assert result.parameters["k"].value == pytest.approx(3, rel=1e-6)
    assert result.parameters["T"].value == pytest.approx(0.8, rel=1e-6)
    assert result.quality[0].samples == 200


def test_locked_values_and_pins_hold(shop):
    shop.add("[parameters.Gain]\nlock = [{ x = [1000, 1000] }]\npin = [{ at = 3000, value = 2.5 }]")
    values = shop.project.calibrate().parameters["Gain"].values
    assert values[0] == 1.0
    assert values[2] == pytest.approx(2.5, abs=1e-9)


def test_group_axes_survive_the_calibration(shop):
    shop.add("[axes.A]\ninput = 'Speed'\nbreakpoints = [1000, 2000, 3000]\n[parameters.Gain]\nx = { axis = 'A' }")
    result = shop.project.calibrate()
    assert result.parameters.axes == (Axis([1000, 2000, 3000], "Speed", "rpm", "A"),)


@pytest.mark.slow
def test_reading_a_project_file_imports_neither_solver_nor_compiler(shop):
    code = (
        "import sys; from kennfeld.project import Project; Project.read(sys.argv[1]);"
        "print([m for m in ('llvmlite', 'scipy', 'pandas', 'pyarrow', 'kennfeld.optimize') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code, shop.path], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


GAIN = """[model]
file = "gain.kf"
[[dataset]]
files = "*.csv"
[parameters.Gain]
initial = 1.0
[[criterion]]
node = "y"
target = "T"
[optimizer]
save_every = 1
"""


@pytest.fixture
def folders(tmp_path):
    """Two projects whose files have the same names; the gain is 2 in the first one and 5 in the other."""
    for name, gain in (("here", 2), ("there", 5)):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "kennfeld.toml").write_text(GAIN, encoding="utf-8")
        (folder / "gain.kf").write_text("y = Gain * u\n", encoding="utf-8")
        (folder / "bench.csv").write_text(f"u,T\n1,{gain}\n2,{2 * gain}\n3,{3 * gain}\n", encoding="utf-8")
        (folder / "start.dcm").write_text(f"KONSERVIERUNG_FORMAT 2.0\n* {name}\nFESTWERT Gain\n   WERT {gain}\nEND\n")
    return tmp_path


def test_a_project_keeps_its_folder_when_the_working_directory_changes(folders, monkeypatch):
    monkeypatch.chdir(folders / "here")
    project = Project.read("kennfeld.toml")
    monkeypatch.chdir(folders / "there")
    assert project.check() == []
    assert project.calibrate().parameters["Gain"].value == pytest.approx(2)
    assert project.saves().folder == folders / "here" / "results" / "saves"
    assert not (folders / "there" / "results").exists()


def test_the_file_of_parameters_is_updated_from_any_working_directory(folders, monkeypatch):
    monkeypatch.chdir(folders / "here")
    start = read_parameters("start.dcm")
    monkeypatch.chdir(folders / "there")
    start.save("saved.dcm")
    assert "* here" in (folders / "there" / "saved.dcm").read_text(encoding="utf-8")


@pytest.mark.guests
@pytest.mark.parametrize("at", ["here", ".", "there"])
def test_messages_name_files_relative_to_the_working_directory(at, folders, monkeypatch):
    (folders / "here" / "net.onnx").write_bytes(b"damaged")
    (folders / "here" / "kennfeld.toml").write_text(GAIN.replace("gain.kf", "net.onnx"), encoding="utf-8")
    monkeypatch.chdir(folders / at)
    reached = Path(os.path.relpath(folders / "here"))
    pytest.importorskip("onnx", reason="the package onnx is not installed")
    (finding,) = Project.read(reached / "kennfeld.toml").check()
    assert finding.location.file == str(reached / "net.onnx")

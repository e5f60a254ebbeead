"""Projects whose function is an FMU, or whose formula text calls one."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld import cli
from kennfeld.calfiles import read
from kennfeld.importers.fmu import instance
from kennfeld.importers.fmu.importing import read_fmu
from tests.importers.fmu.lag_fmu import build, description_2, pack

PLANT = """[model]
file = "lag.fmu"
[[dataset]]
files = ["bench.csv"]
[[criterion]]
node = "y"
target = "wanted"
[calibration]
free = ["tau", "k"]
"""
TEXT = """[model]
file = "torque.kf"
[functions]
plant = "lag.fmu"
[[dataset]]
files = ["bench.csv"]
[[criterion]]
node = "torque"
target = "wanted"
[calibration]
free = ["plant.tau", "plant.k"]
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    return build(tmp_path_factory.mktemp("lag"), 2)


def written(folder, path, text):
    """Write a project on data of the FMU with tau = 0.7, k = 1.3."""
    (folder / "lag.fmu").write_bytes(path.read_bytes())
    time = 0.1 * np.arange(200)
    u = 2 + np.sin(time)
    values = kf.simulate(kf.fmu(path), {"time": time, "u": u}, {"tau": 0.7, "k": 1.3})["y"].values
    rows = [f"{a!r},{b!r},{c!r}" for a, b, c in zip(time.tolist(), u.tolist(), values.tolist(), strict=True)]
    (folder / "bench.csv").write_text("\n".join(["time,u,wanted", *rows, ""]))
    (folder / "torque.kf").write_text("torque = plant(u)\n")
    (folder / "kennfeld.toml").write_text(text)
    return str(folder / "kennfeld.toml")


@pytest.mark.slow
@pytest.mark.parametrize(("text", "prefix"), [(PLANT, ""), pytest.param(TEXT, "plant.", marks=pytest.mark.slow)])
def test_parameters_of_an_fmu_are_calibrated(tmp_path, built, capsys, text, prefix):
    project = written(tmp_path, built, text)
    assert cli.run(["calibrate", "--trust", project]) == 0
    result = read(tmp_path / "results/parameters.json")
    assert result[f"{prefix}tau"].value == pytest.approx(0.7, rel=1e-6)
    assert result[f"{prefix}k"].value == pytest.approx(1.3, rel=1e-6)
    assert "remark: kennfeld.toml line 2 [model] file: lag.fmu: slopes are" in capsys.readouterr().err or prefix


@pytest.mark.slow
def test_an_fmu_that_cannot_run_is_a_finding(tmp_path, built, capsys):
    project = written(tmp_path, built, PLANT)
    (tmp_path / "lag.fmu").write_bytes(build(tmp_path, 2, "-DMEMORY").read_bytes())
    assert cli.run(["calibrate", "--trust", project]) == 2
    assert "its equations depend on earlier evaluations" in capsys.readouterr().err


def test_check_names_the_slopes(tmp_path, built, capsys):
    assert cli.run(["check", "--trust", written(tmp_path, built, PLANT)]) == 0
    text = "".join(capsys.readouterr())
    assert "slopes of lag.fmu: directional derivatives along x, u; differences along tau" in text


def test_start_values_are_fitted_if_a_section_frees_them(tmp_path, capsys):
    path = build(tmp_path, 2, "-DSTART", start='start="1.5"')
    section = '[parameters."plant.x.start"]\nfree = true\ninitial = 2.0\nbounds = [0.0, 5.0]\n'
    project = written(tmp_path, path, TEXT + section)
    assert cli.run(["calibrate", "--trust", project]) == 0
    capsys.readouterr()
    result = read(tmp_path / "results/parameters.json")
    assert result["plant.tau"].value == pytest.approx(0.7, rel=1e-6)
    assert result["plant.x.start"].value == pytest.approx(1.5, rel=1e-6)


def test_info_does_not_run_code(built, capsys, monkeypatch):
    monkeypatch.setattr(instance, "FmuInstance", None)
    assert cli.run(["info", str(built)]) == 0
    assert "lag.fmu: FMI 2.0 for model exchange" in capsys.readouterr().out


def test_an_fmu_cannot_be_converted_to_formula_text(tmp_path, built, capsys):
    assert cli.run(["convert", str(built), str(tmp_path / "lag.kf")]) == 2
    message = capsys.readouterr().err
    assert "lag.fmu: holds machine code, which cannot be written as formula text" in message
    assert 'NAME = "lag.fmu" under [functions]' in message


def test_start_values_are_converted_to_calibration_files(tmp_path, built, capsys, monkeypatch):
    monkeypatch.setattr(instance, "FmuInstance", None)
    assert cli.run(["convert", str(built), str(tmp_path / "lag.dcm")]) == 0
    capsys.readouterr()
    assert read(tmp_path / "lag.dcm")["table"].values.tolist() == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize("call", ["plant.x(u)", "plant.y.2(u)"])
def test_a_call_of_an_unknown_output_is_a_finding(tmp_path, built, capsys, call):
    project = written(tmp_path, built, TEXT)
    (tmp_path / "torque.kf").write_text(f"torque = {call}\n")
    assert cli.run(["check", "--trust", project]) == 2
    assert f"{call[:-3]} is not an output of a function. Did you mean plant.y?" in capsys.readouterr().err


def test_elements_of_arrays_have_names_that_formula_text_can_write(tmp_path):
    text = description_2().replace('name="y"', 'name="flow[1,2].y"').replace('name="u"', 'name="der(u)"')
    (tmp_path / "lag.so").write_bytes(b"")
    path = pack(tmp_path / "lag.fmu", text, library=tmp_path / "lag.so")
    called, own = (read_fmu(path, "", name, None) for name in ("plant", ""))
    assert [each.name for each in (*called.inputs, *called.outputs)] == ["der_u_", "flow.1.2.y"]
    assert [each.name for each in (*own.inputs, *own.outputs)] == ["der(u)", "flow[1,2].y"]

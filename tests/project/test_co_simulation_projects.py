"""Projects with FMUs for co-simulation."""

import numpy as np
import pytest

from kennfeld import cli
from kennfeld.calfiles import read
from tests.importers.fmu.tank_fmu import COUNT, build, closed_form, recording

TANK = """[model]
file = "tank.fmu:co-simulation"
[[dataset]]
files = ["bench.csv"]
[[criterion]]
node = "y"
target = "wanted"
[calibration]
free = ["gain", "tau", "level"]
"""
TEXT = """[model]
file = "torque.kf"
[functions]
plant = "tank.fmu"
[[dataset]]
files = ["bench.csv"]
[[criterion]]
node = "torque"
target = "wanted"
[calibration]
free = ["plant.gain", "Scale"]
[parameters]
Scale = { initial = 1.0 }
"""
FORMULA = "scalar Scale\ntorque = plant.y(Scale * flow, 3, open)\n"


@pytest.fixture(scope="module")
def tank(tmp_path_factory):
    return build(tmp_path_factory.mktemp("tank"), 2)


def written(folder, path, text):
    """Write a project on data of the FMU with gain = 1.3, tau = 0.7, level = 0.4."""
    (folder / "tank.fmu").write_bytes(path.read_bytes())
    data = recording()
    data["wanted"] = closed_form(data, 1.3, 0.7, 0.4)
    rows = [",".join(map(repr, row)) for row in np.array(list(data.values())).T.tolist()]
    (folder / "bench.csv").write_text("\n".join([",".join(data), *rows, ""]))
    (folder / "torque.kf").write_text(FORMULA)
    (folder / "kennfeld.toml").write_text(text)
    return str(folder / "kennfeld.toml")


@pytest.mark.slow
def test_parameters_of_an_fmu_are_calibrated_and_reported(tmp_path, tank):
    project = written(tmp_path, tank, TANK)
    assert cli.run(["calibrate", "--trust", project]) == 0
    result = read(tmp_path / "results/parameters.json")
    assert [result[name].value for name in ("gain", "tau", "level")] == pytest.approx([1.3, 0.7, 0.4], rel=1e-6)
    assert (tmp_path / "results/report.html").is_file()


@pytest.mark.parametrize("interface", ["co-simulation", "co_simulation"])
def test_a_project_is_checked_and_simulated(tmp_path, tank, capsys, interface):
    project = written(tmp_path, tank, TANK.replace("co-simulation", interface))
    assert cli.run(["check", "--trust", project]) == 0
    assert "co-simulation: outputs at a sample" in capsys.readouterr().err
    assert cli.run(["simulate", "--trust", project, "-o", str(tmp_path / "out.csv")]) == 0
    assert len((tmp_path / "out.csv").read_text().splitlines()) == COUNT + 1


@pytest.mark.slow
def test_a_value_before_an_fmu_is_calibrated_through_it(tmp_path, tank):
    project = written(tmp_path, tank, TEXT.replace('"plant.gain", "Scale"', '"plant.tau", "plant.level", "Scale"'))
    cli.run(["calibrate", "--trust", project])
    result = read(tmp_path / "results/parameters.json")
    flow = recording()["flow"][0]  # scaled as well, so that the level makes up for it
    assert result["plant.tau"].value == pytest.approx(0.7, rel=1e-5)
    assert result["Scale"].value == pytest.approx(1.3, rel=1e-5)
    assert result["plant.level"].value == pytest.approx(0.4 - 0.3 * flow, rel=1e-4)


def test_steady_state_points_are_held_until_an_fmu_has_settled(tmp_path, tank):
    project = written(tmp_path, tank, TANK.replace('"bench.csv"]', '"bench.csv"]\nsettle = 20'))
    rows = [f"{flow},0,1,{flow * 1.3 * 0.7}" for flow in (0.5, 1.0, 1.5, 2.0)]
    (tmp_path / "bench.csv").write_text("\n".join(["flow,mode,open,wanted", *rows, ""]))
    text = (tmp_path / "kennfeld.toml").read_text().replace('"gain", "tau", "level"', '"tau"')
    (tmp_path / "kennfeld.toml").write_text(f"{text}[parameters]\ngain = {{ initial = 1.3 }}\n")
    assert cli.run(["calibrate", "--trust", project]) == 0
    assert read(tmp_path / "results/parameters.json")["tau"].value == pytest.approx(0.7, rel=1e-6)


def test_an_unknown_interface_is_a_finding(tmp_path, tank, capsys):
    project = written(tmp_path, tank, TANK.replace("co-simulation", "scheduled"))
    assert cli.run(["check", "--trust", project]) == 2
    assert 'Write "tank.fmu" or "tank.fmu:co-simulation" or "tank.fmu:model-exchange"' in capsys.readouterr().err


def test_an_interface_that_an_fmu_does_not_offer_is_a_finding(tmp_path, tank, capsys):
    project = written(tmp_path, tank, TANK.replace("co-simulation", "model_exchange"))
    assert cli.run(["check", "--trust", project]) == 2
    assert "offers co-simulation only, not model exchange" in capsys.readouterr().err

"""Projects whose function is an ESDL class: checked, calibrated, written back, and turned into formula text."""

import json

import numpy as np
import pytest

from kennfeld import cli
from kennfeld.base.errors import InputError
from kennfeld.calfiles import read, write
from kennfeld.graph.interpreter import evaluate
from kennfeld.importers.ascet.importing import esdl
from kennfeld.models.formula import read as read_formula
from kennfeld.project import Project
from tests.clocks import even_clock
from tests.importers.ascet.amd_files import Component, Drawing, Method, message, parameter, write_archive
from tests.importers.ascet.esdl_projects import BATTERY, TASKS, run, write_project

TOML = """[model]
file = "Battery/Cell/Accu.esdl"
[[dataset]]
files = "bench.csv"
[[criterion]]
node = "charge"
target = "wanted"
[calibration]
output = ["esdl", "dcm"]
free = ["shift"]
"""


@pytest.fixture
def folder(tmp_path):
    """A project on the sensor, with data of another curve."""
    write_project(tmp_path, BATTERY)
    temperature, voltage = np.linspace(-5, 65, 120), np.tile([1.3, 1.34, 1.38], 40)
    shift = np.interp(temperature, [0.0, 20.0, 30.0, 40.0, 60.0], [0.15, 0.16, 0.155, 0.15, 0.17])
    target = np.clip((voltage + shift - 1.4) * 100.0, 0.0, 100.0)
    rows = [f"{t!r},{u!r},{w!r}" for t, u, w in zip(*(x.tolist() for x in (temperature, voltage, target)), strict=True)]
    (tmp_path / "bench.csv").write_text("\n".join(["T,U,wanted", *rows, ""]))
    (tmp_path / "kennfeld.toml").write_text(TOML)
    return tmp_path


@pytest.mark.slow
def test_a_class_is_calibrated_and_its_values_are_written_into_a_copy_of_the_file(folder):
    assert cli.run(["calibrate", str(folder / "kennfeld.toml")]) == 0
    result = read(folder / "results/parameters.esdl")
    np.testing.assert_allclose(result["shift"].values, [0.15, 0.16, 0.155, 0.15, 0.17], atol=1e-6)
    before = (folder / "Battery/Cell/Accu.esdl").read_text().splitlines()
    after = (folder / "results/parameters.esdl").read_text().splitlines()
    changed = [line for line, old in zip(after, before, strict=True) if line != old]
    assert len(changed) == 1
    assert "shift[5]" in changed[0]
    assert read(folder / "results/parameters.dcm")["shift"].values == pytest.approx(result["shift"].values)


def test_values_of_calibration_files_replace_those_of_the_class(folder):
    values = esdl(folder / "Battery/Cell/Accu.esdl").values
    write(values.with_parameters(values["base"].with_values(1.3)), folder / "start.dcm")
    text = TOML.replace('output = ["esdl", "dcm"]', 'initial = "start.dcm"')
    (folder / "kennfeld.toml").write_text(text)
    problem = Project.read(folder / "kennfeld.toml").problem()
    assert problem.parameters["base"].value == 1.3
    assert float(problem.parameters["base"].upper) == 5.0


def test_values_that_start_from_a_calibration_file_are_written_into_copies_of_both_files(folder):
    values = esdl(folder / "Battery/Cell/Accu.esdl").values
    write(values.with_parameters(values["shift"].with_values(np.full(5, 0.3))), folder / "start.dcm")
    (folder / "start.dcm").write_text(f"* by hand\n{(folder / 'start.dcm').read_text()}")
    (folder / "kennfeld.toml").write_text(TOML.replace("[calibration]", '[calibration]\ninitial = "start.dcm"'))
    assert cli.run(["calibrate", str(folder / "kennfeld.toml")]) == 0
    for name in ("parameters.esdl", "parameters.dcm"):
        shift = read(folder / "results" / name)["shift"].values
        np.testing.assert_allclose(shift, [0.15, 0.16, 0.155, 0.15, 0.17], atol=1e-6)
    assert "class Accu" in (folder / "results/parameters.esdl").read_text()
    assert "* by hand" in (folder / "results/parameters.dcm").read_text()


def test_keys_choose_class_methods_and_task(folder):
    for keys, inputs in (
        ('file = "Battery/Cell/Accu.esdl"\nclass = "Accu"\nmethods = ["charge"]', {"U", "T"}),
        ('file = "Battery/Battery.app"\ntask = "Task_10ms"', {"current", "ambient"}),
        ('file = "Battery/Cell/Plant.esdl"\nstartup = ["init"]\nfolders = ["Lib"]', {"current", "ambient"}),
    ):
        (folder / "kennfeld.toml").write_text(TOML.replace('file = "Battery/Cell/Accu.esdl"', keys))
        project = Project.read(folder / "kennfeld.toml")
        findings = [str(finding) for finding in project.check()]
        assert not [text for text in findings if "unknown key" in text or "require" in text]
        missing = {name for name in inputs for text in findings if f"{name}" in text}
        assert missing or inputs == {"U", "T"}


def test_an_application_cannot_be_exported_as_a_class(folder):
    text = TOML.replace('file = "Battery/Cell/Accu.esdl"', 'file = "Battery/Battery.app"')
    text = text.replace('files = "bench.csv"', 'files = "cycle.csv"').replace('node = "charge"', 'node = "estimate"')
    (folder / "cycle.csv").write_text("time,current,ambient,wanted\n0,1,20,50\n0.01,2,21,51\n0.02,3,22,52\n")
    (folder / "kennfeld.toml").write_text(text.replace('free = ["shift"]', 'free = ["accu.shift"]'))
    findings = [str(finding) for finding in Project.read(folder / "kennfeld.toml").check()]
    assert any("esdl requires one ESDL class" in text for text in findings)


def test_characteristics_of_tasks_at_several_periods_are_recovered_from_a_recording(tmp_path):
    application = write_project(tmp_path, TASKS) / "Plant/Plant.app"
    model = esdl(application, task=["Fast_10ms", "Slow_30ms"])
    time = 0.01 * np.arange(300)
    demand = np.sin(3.0 * time) + 0.5
    recorded = np.column_stack([time + 7.3, demand, run(model, {"demand": demand})["slow"]])
    np.savetxt(tmp_path / "drive.csv", recorded, delimiter=",", header="time,demand,measured", comments="")
    (tmp_path / "kennfeld.toml").write_text(
        '[model]\nfile = "Plant/Plant.app"\ntask = ["Fast_10ms", "Slow_30ms"]\n[[dataset]]\nfiles = "drive.csv"\n'
        '[[criterion]]\nnode = "slow"\ntarget = "measured"\n[calibration]\nfree = ["gain", "weight"]\n'
        "[parameters.gain]\ninitial = 2.0\n[parameters.weight]\ninitial = 0.1\n"
    )
    result = Project.read(tmp_path / "kennfeld.toml").calibrate()
    assert result.parameters["gain"].value == pytest.approx(3.0, rel=1e-8)
    assert result.parameters["weight"].value == pytest.approx(0.25, rel=1e-8)


def test_a_list_of_tasks_is_a_key(folder):
    text = TOML.replace(
        'file = "Battery/Cell/Accu.esdl"', 'file = "Battery/Battery.app"\ntask = ["Task_10ms", "Other"]'
    )
    (folder / "kennfeld.toml").write_text(text)
    with pytest.raises(InputError, match="unknown task Other"):
        Project.read(folder / "kennfeld.toml").problem()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ('file = "Battery/Cell/Accu.esdl"\nclass = "Akku"', "unknown class Akku"),
        ('file = "Battery/Cell/Accu.esdl"\nfolders = ["Nowhere"]', "folder Nowhere does not exist"),
        ('file = "model.kf"\nclass = "Accu"', "class requires an ASCET project, got model.kf"),
        ('file = "model.kf"\nlimit_assignments = false', "limit_assignments requires an ASCET project, got model.kf"),
        ('file = "Battery/Cell/Accu.esdl"\nsubsystem = "A"', "subsystem requires a Simulink model"),
        ('file = "Battery/Cell/None.esdl"', "does not exist"),
    ],
)
def test_wrong_keys_are_reported(folder, keys, message):
    (folder / "kennfeld.toml").write_text(TOML.replace('file = "Battery/Cell/Accu.esdl"', keys))
    try:
        findings = Project.read(folder / "kennfeld.toml").check()
    except InputError as error:
        findings = error.findings
    assert any(message in str(finding) for finding in findings)


def test_info_shows_the_parameters_of_a_class(folder, capsys):
    assert cli.run(["info", str(folder / "Battery/Cell/Plant.esdl")]) == 0
    text = capsys.readouterr().out
    for word in (
        "C_heat",
        "4 x 3",
        "temperature",
        "heat.memory",
        "every 0.01 s",
        "Cell.Plant.init",
        "can be calibrated",
    ):
        assert word in text
    assert cli.run(["info", "--json", str(folder / "Battery/Battery.app")]) == 0
    report = json.loads(capsys.readouterr().out)["import"]
    assert report["methods"] == ["Cell.Plant.calc", "Cell.Sensor.calc"]
    assert report["whole"] is True


def test_info_names_unsupported_parts(folder, capsys):
    (folder / "Battery/Cell/Accu.esdl").write_text(
        "package Cell; class Accu { public real get(real x) { return f(x); } }"
    )
    assert cli.run(["info", str(folder / "Battery/Cell/Accu.esdl"), "--class", "Accu", "--method", "get"]) == 0
    text = capsys.readouterr().out
    assert "unknown method f" in text
    assert "cannot be calibrated: 1 finding" in text


def test_convert_writes_formula_text_with_the_same_results(folder):
    target = folder / "plant.kf"
    assert cli.run(["convert", str(folder / "Battery/Cell/Plant.esdl"), str(target)]) == 0
    model, again = esdl(folder / "Battery/Cell/Plant.esdl"), read_formula(target)
    assert again.step == model.step
    columns = {
        "current": np.linspace(-5, 5, 20),
        "ambient": np.full(20, 25.0),
        **even_clock(0.01, 20),
    }
    first = evaluate(model.graph, columns, model.values)
    second = evaluate(again.graph, columns, read(target.with_suffix(".json")))
    np.testing.assert_array_equal(first["voltage"], second["voltage"])


def test_a_component_of_ascet_6_is_calibrated_and_written_into_a_copy_of_its_archive(tmp_path):
    drawing = Drawing()
    drawing.write("charge", drawing.value_of("shift", "getAt", "oned", x=drawing.element("T")), ("calc", 1))
    drawing.write("on", drawing.operator("=", drawing.element("mode"), drawing.literal("On")), ("calc", 2))
    shift = parameter("shift", ([0.0, 60.0], [0.15, 0.16]), scope="exported")
    choice = parameter("mode", "On", basic="enumeration", reference="/Engine/Mode", scope="exported")
    elements = [message("T"), message("charge", "exported"), message("on", "exported", basic="log"), shift, choice]
    mode = Component("Mode", kind="ASCET_Enumeration", labels=("Off", "On"))
    write_archive(tmp_path, Component("Sensor", elements, [Method("calc")], drawing), mode)
    rows = [f"{t},{0.1 + 0.01 * t}" for t in range(0, 61, 5)]
    (tmp_path / "bench.csv").write_text("\n".join(["T,wanted", *rows, ""]))
    text = TOML.replace("Battery/Cell/Accu.esdl", "Engine.axl").replace(
        '["esdl", "dcm"]', '["axl", "dcm"]\ninitial = "Engine.axl"'
    )
    (tmp_path / "kennfeld.toml").write_text(text.replace("[[dataset]]", 'class = "Sensor"\n[[dataset]]', 1))
    assert any(
        "mode: numbers in the function" in str(finding) for finding in Project.read(tmp_path / "kennfeld.toml").check()
    )
    assert cli.run(["calibrate", str(tmp_path / "kennfeld.toml")]) == 0
    result = read(tmp_path / "results/parameters.axl")
    np.testing.assert_allclose(result["shift"].values, [0.1, 0.7], atol=1e-6)
    assert read(tmp_path / "results/parameters.dcm")["shift"].values == pytest.approx(result["shift"].values)

"""Importers are guests: one of another package works as those of Kennfeld do, and the core works without any."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld import cli
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.session.session import Session
from kennfeld.base.errors import InputWarning
from kennfeld.files import identify
from kennfeld.models import importer_registry
from kennfeld.models.function_files import read_function_file
from kennfeld.models.importer import Importer, ImportRequest
from kennfeld.models.importer_registry import importer_of, importer_of_format, importers
from kennfeld.project import Project
from kennfeld.terminal.file_info import describe_file
from tests.files.packages import forget_packages, install

PAGE = Path(__file__).parents[2] / "docs" / "adding-an-importer.md"
DATA = "time,load,speed,measured\n0,1,10,12.5\n1,2,20,25\n2,4,10,20\n3,3,40,47.5\n"
PROJECT = """
[model]
file = "torque.sum"

[[dataset]]
files = ["drive.csv"]

[[criterion]]
node = "torque"
target = "measured"
"""


@pytest.fixture
def packages(tmp_path, monkeypatch):
    folder = tmp_path / "packages"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    forget_packages()
    yield folder
    forget_packages()


@pytest.fixture
def project(packages, tmp_path):
    """A project with a function of the package of the documentation."""
    code = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    install(packages, "acme_sums", code, "sums = acme_sums:IMPORTER", "kennfeld.importers")
    (tmp_path / "torque.sum").write_text("ACME-SUM torque\nk load 1\nm speed 0.5\n", encoding="utf-8")
    (tmp_path / "drive.csv").write_text(DATA, encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(PROJECT, encoding="utf-8")
    return tmp_path / "kennfeld.toml"


def test_a_project_is_calibrated_with_the_importer_of_the_documentation(project):
    assert identify(project.parent / "torque.sum").format.name == "ACME sum"
    assert Project.read(project).check() == []
    result = Project.read(project).calibrate()
    load, speed, measured = np.loadtxt(project.parent / "drive.csv", delimiter=",", skiprows=1)[:, 1:].T
    expected = np.linalg.lstsq(np.column_stack([load, speed]), measured, rcond=None)[0]
    assert result.status == "converged"
    assert [result.parameters[name].value for name in ("k", "m")] == pytest.approx(expected.tolist())


def test_formula_text_calls_its_functions(project):
    (project.parent / "gross.kf").write_text("input load\ninput speed\ngross = sum(load, speed)", encoding="utf-8")
    text = PROJECT.replace("torque.sum", "gross.kf").replace('"torque"', '"gross"')
    project.write_text(f'{text}\n[functions]\nsum = "torque.sum"\n', encoding="utf-8")
    assert list(Project.read(project).problem().parameters) == ["sum.k", "sum.m"]


def test_commands_describe_and_convert_its_files(project, capsys):
    file = project.parent / "torque.sum"
    assert cli.run(["info", str(file), "--json"]) == 0
    described = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in described["import"]["inputs"]] == ["load", "speed"]
    assert cli.run(["convert", str(file), str(file.with_suffix(".kf"))]) == 0
    assert "torque = " in file.with_suffix(".kf").read_text(encoding="utf-8")
    assert kf.read_parameters(file.with_suffix(".json"))["m"].value == 0.5


def test_the_app_shows_its_function(project):
    session = Session(project)
    shown = QUESTIONS["function-file"](session, {}).head
    assert ([row["name"] for row in shown["inputs"]], shown["kind"]) == (["load", "speed"], "ACME sum")
    COMMANDS["convert-function"](session, {})
    assert session.settings["model"] == {"file": "torque.kf"}
    assert session.findings == ()


@pytest.mark.guests
def test_keys_that_it_does_not_take_are_refused(project):
    project.write_text(PROJECT.replace("[model]", '[model]\nsubsystem = "A"'), encoding="utf-8")
    with pytest.raises(kf.InputError, match=r"subsystem requires a Simulink model, got torque\.sum"):
        Project.read(project)


def test_an_importer_that_is_broken_is_named_and_left_out(packages):
    install(packages, "broken", "IMPORTER = 3\n", "lost = broken:IMPORTER", "kennfeld.importers")
    sys.modules.pop("broken", None)
    with pytest.warns(InputWarning, match="the importer lost of the package broken cannot be loaded"):
        assert importer_of("torque.sum") is None


@pytest.fixture
def alone(monkeypatch):
    """Kennfeld without the folders of its importers."""
    monkeypatch.setattr(importer_registry, "find_spec", lambda name: None)
    forget_packages()
    yield
    forget_packages()


@pytest.mark.parametrize("name", ["plant.slx", "Accu.esdl", "plant.fmu", "knock.onnx", "engine.c:torque", "gain.py:g"])
def test_without_importers_such_files_are_unknown(alone, tmp_path, name):
    (tmp_path / name.partition(":")[0]).write_text("?", encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(PROJECT.replace("torque.sum", name), encoding="utf-8")
    (tmp_path / "drive.csv").write_text(DATA, encoding="utf-8")
    [finding] = [each for each in Project.read(tmp_path / "kennfeld.toml").check() if "model" in each.location.path]
    assert "unknown model format" in finding.message
    assert finding.remedy == "Use formula text (.kf)."


def test_without_importers_a_file_is_described_by_what_is_known_of_its_format(alone, tmp_path):
    sources = {"plant.slx": "a Simulink model file", "f.c": "a C source file", "g.py": "a Python source file"}
    for name, kind in sources.items():
        (tmp_path / name).write_text("?", encoding="utf-8")
        with pytest.raises(kf.InputError, match=f"^{name}: this is {kind}, for which no importer is installed"):
            describe_file(tmp_path / name)
    pump = "package engine;\nstatic class Pump { characteristic real gain = 2.0; }\n"
    (tmp_path / "pump.esdl").write_text(pump, encoding="utf-8")
    assert describe_file(tmp_path / "pump.esdl").summary.startswith("pump.esdl: calibration (ESDL")


def test_without_importers_messages_name_none(alone, project, tmp_path):
    project.write_text(PROJECT.replace('"torque.sum"', '"torque.sum"\nsubsystem = "A"'), encoding="utf-8")
    with pytest.raises(kf.InputError, match="subsystem requires an importer that is not installed, got"):
        Project.read(project)
    with pytest.raises(kf.InputError, match=r"gain\.py:g: not a file of functions\. Known are \.sum"):
        read_function_file("gain.py:g", tmp_path)
    with pytest.raises(kf.ArgumentError, match="f is a Python function, for which no importer is installed"):
        kf.formula("y = f(x)", functions={"f": abs})


@pytest.mark.guests
def test_every_importer_is_identified_by_its_files():
    assert {each.name for each in importers()} >= {"Simulink model", "ASCET project", "FMU", "ONNX network"}
    for importer in importers():
        assert isinstance(importer, Importer)
        assert {importer_of(f"a{ending}") for ending in importer.endings} == {importer}
        assert {importer_of_format(known) for known in importer.formats} == {importer}


def test_nothing_but_the_public_names_of_kennfeld_names_an_importer_outside_of_its_folder():
    package = Path(kf.__file__).parent
    others = [path for path in package.rglob("*.py") if "importers" not in path.relative_to(package).parts]
    naming = [path for path in others if re.search(r"kennfeld\.importers\.[a-z]", path.read_text(encoding="utf-8"))]
    assert naming == [package / "__init__.py"]


SEVERAL = """
from kennfeld import files, formula
from kennfeld.models.import_report import FunctionReport
from kennfeld.models.importer import Importer, ImportResult
from kennfeld.models.model_function import FunctionSummary

def import_(request):
    return ImportResult(formula(f"{request.choice} = 2 * load"), FunctionReport((), (), (), 0.25, ()))

KNOWN = files.FileFormat("sheet", (".sheet",), lambda head: head.text.startswith("SHEET"), role=files.Role.FUNCTION)
IMPORTER = Importer(
    "a sheet", (KNOWN,), imports=import_, named=True, lists=lambda path: [FunctionSummary("air", ("load",), ("air",))]
)
"""


def test_an_importer_of_whole_models_may_list_several_in_a_file(packages, tmp_path):
    install(packages, "sheets", SEVERAL, "sheets = sheets:IMPORTER", "kennfeld.importers")
    file = tmp_path / "engine.sheet"
    file.write_text("SHEET", encoding="utf-8")
    assert describe_file(file).tables == [[("function", "arguments", "results", ""), ("air", "load", "air", "")]]
    assert describe_file(f"{file}:air").as_json["import"]["step"] == 0.25
    importer = importer_of("engine.sheet")
    assert importer.model(ImportRequest(file, choice="air")).graph.outputs == ("air",)
    with pytest.raises(kf.InputError, match=r'Name the function: "engine\.sheet:NAME"'):
        importer.model(ImportRequest(file))


@pytest.mark.guests
def test_a_name_behind_the_file_of_one_function_is_refused():
    for file in ("plant.slx", "Accu.esdl", "knock.onnx"):
        with pytest.raises(kf.InputError, match=rf'^{file}:Torque: an? .* holds one function. Write "{file}"'):
            importer_of(file).model(ImportRequest(Path(file), choice="Torque"))

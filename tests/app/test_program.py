"""ASCET models in the app: dropped files, source text with its report, choices, export and conversion."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.calfiles import read
from tests.importers.ascet.amd_files import write_archive
from tests.importers.ascet.component_samples import LOW_PASS, plant_component
from tests.importers.ascet.esdl_projects import BATTERY, LIBRARY, write_project

pytestmark = pytest.mark.guests

TOML = """[model]
file = "Battery/Cell/Accu.esdl"
[[dataset]]
files = "bench.csv"
[[criterion]]
node = "charge"
target = "wanted"
[calibration]
free = ["shift"]
"""


@pytest.fixture
def accu(tmp_path: Path) -> Session:
    """Return a session on the sensor of the battery, with data."""
    write_project(tmp_path, BATTERY)
    temperature, voltage = np.linspace(-5, 65, 60), np.tile([1.3, 1.34, 1.38], 20)
    rows = [f"{t},{u},{100 * (u + 0.16 - 1.4)}" for t, u in zip(temperature, voltage, strict=True)]
    (tmp_path / "bench.csv").write_text("\n".join(["T,U,wanted", *rows, ""]))
    (tmp_path / "kennfeld.toml").write_text(TOML)
    return Session(tmp_path / "kennfeld.toml")


@pytest.fixture
def empty(tmp_path: Path) -> Session:
    """Return a session of a new project."""
    (tmp_path / "new").mkdir()
    (tmp_path / "new/function.kf").write_text("")
    (tmp_path / "new/kennfeld.toml").write_text('[model]\nfile = "function.kf"\n')
    return Session(tmp_path / "new/kennfeld.toml")


def program(session: Session) -> dict[str, Any]:
    return QUESTIONS["program"](session, {}).head


def drop(session: Session, files: dict[str, str], *words: str) -> dict[str, Any]:
    """Drop the files whose path contains one of the words, all into one folder as a page stores them."""
    names = []
    for path, text in files.items():
        if any(word in path for word in words):
            names.append(Path(path).name)
            (session.path.parent / names[-1]).write_text(text, encoding="utf-8")
    return COMMANDS["add-files"](session, {"files": names}).head


def set_keys(session: Session, *changes: tuple[tuple[str, ...], object]) -> None:
    session.do(SetKeys("changed", session.path.name, changes))


def test_a_class_is_shown_with_its_source_and_its_outputs(accu: Session) -> None:
    own = program(accu)
    assert own["whole"]
    assert [each["file"] for each in own["sources"]] == ["Battery/Cell/Accu.esdl"]
    lines = own["sources"][0]["text"].splitlines()
    places = {each["name"]: lines[each["line"] - 1] for each in own["places"]}
    assert "shift[5]" in places["shift"]
    assert "real charge(" in places["charge"]
    assert [each["name"] for each in own["inputs"]] == ["U", "T"]
    assert {line["node"] for line in own["lines"]} - {""} == {"charge"}
    assert own["classes"] == [{"name": "Accu", "methods": ["charge"]}]


def test_an_application_is_shown_with_all_files_that_take_part(accu: Session) -> None:
    set_keys(accu, (("model", "file"), "Battery/Battery.app"))
    own = program(accu)
    files = [each["file"] for each in own["sources"]]
    assert files[:3] == ["Battery/Battery.app", "Battery/Cell/Plant.esdl", "Battery/Cell/Sensor.esdl"]
    assert {"Battery/Signals/Messages.esdl", "Lib/Lib/Dynamics/Integrator.esdl"} <= set(files)
    assert [task["name"] for task in own["tasks"]] == ["Task_10ms"]
    assert own["startup"] == ["Cell.Plant.init"]
    assert any("Messages.esdl" in files[each["source"]] for each in own["places"] if each["name"] == "voltage")


def test_a_part_that_is_not_supported_is_named_with_its_line(accu: Session) -> None:
    path = accu.path.parent / "Battery/Cell/Accu.esdl"
    path.write_text(path.read_text().replace("return max", "return unheard(U) + max"))
    COMMANDS["reread-function"](accu, {})
    [problem] = program(accu)["problems"]
    assert (problem["source"], problem["line"]) == (0, 9)
    assert "unknown method unheard" in problem["message"]


@pytest.mark.parametrize(
    ("content", "message"),
    [("class {", "expected"), (None, "does not exist"), ("package Cell;", "the file has no class")],
)
def test_a_file_that_cannot_be_read_is_a_message(accu: Session, content: str | None, message: str) -> None:
    path = accu.path.parent / "Battery/Cell/Accu.esdl"
    path.unlink() if content is None else path.write_text(content)
    COMMANDS["reread-function"](accu, {})
    own = program(accu)
    assert any(message in each["text"] for each in own["problems"])
    assert not own.get("whole")


def test_dropped_files_are_stored_by_package_and_the_application_is_the_function(empty: Session) -> None:
    answer = drop(empty, {**BATTERY, **LIBRARY}, ".esdl", ".app")
    assert answer["kinds"]["Cell/Plant.esdl"] == "program"
    assert empty.settings["model"]["file"] == "Battery.app"
    assert (empty.path.parent / "Lib/Dynamics/Integrator.esdl").is_file()
    own = program(empty)
    assert own["whole"]
    assert own["missing"] == []
    listed = QUESTIONS["functions"](empty, {}).head["files"]
    assert {"Battery.app", "Cell/Plant.esdl", "function.kf"} <= set(listed)
    assert "Signals/Messages.esdl" not in listed


def test_the_class_that_no_other_class_uses_is_the_function(empty: Session) -> None:
    drop(empty, BATTERY, "Accu", "Sensor", "Messages", "Types")
    assert empty.settings["model"]["file"] == "Cell/Sensor.esdl"
    assert program(empty)["whole"]


@pytest.mark.slow
def test_missing_packages_are_named_until_their_files_are_dropped(empty: Session) -> None:
    drop(empty, BATTERY, "Plant", "Messages", "Types")
    own = program(empty)
    assert own["calls"] == ["Cell.Plant.calc"]
    assert own["missing"] == ["Lib.Dynamics", "Lib.Math"]
    assert "The package Lib.Dynamics is missing" in own["problems"][0]["remedy"]
    drop(empty, LIBRARY, ".esdl")
    assert empty.settings["model"]["file"] == "Cell/Plant.esdl"
    assert program(empty)["missing"] == []
    assert program(empty)["whole"]


def test_files_go_to_the_packages_of_the_present_model(accu: Session) -> None:
    (accu.path.parent / "Extra.esdl").write_text("package Cell.More; class Extra { public real one() { return 1.0; } }")
    COMMANDS["add-files"](accu, {"files": ["Extra.esdl"]})
    assert (accu.path.parent / "Battery/Cell/More/Extra.esdl").is_file()
    assert accu.settings["model"]["file"] == "Battery/Cell/Accu.esdl"


def test_a_file_is_not_overwritten_by_another_of_its_name(empty: Session) -> None:
    drop(empty, BATTERY, "Accu", "Types")
    drop(empty, BATTERY, "Accu")  # the same file again
    with pytest.raises(InputError, match=r"Cell/Accu\.esdl: exists with another content"):
        drop(empty, {"Accu.esdl": "package Cell; class Accu { }"}, "Accu")
    assert "charge" in (empty.path.parent / "Cell/Accu.esdl").read_text()
    assert not (empty.path.parent / "Accu.esdl").exists()


def test_a_package_cannot_leave_the_folder(empty: Session) -> None:
    drop(empty, {"Own.esdl": "package a..b; class Own { public real one() { return 1.0; } }"}, "Own")
    assert all(path.is_relative_to(empty.path.parent) for path in empty.path.parents[1].rglob("Own.esdl"))


def test_values_are_exported_into_a_copy_of_the_class(accu: Session) -> None:
    assert ".esdl" in QUESTIONS["formats"](accu, {}).head["formats"]
    accu.do(SetKeys("values", accu.path.name, ((("parameters", "base", "initial"), 1.3),)))
    files = QUESTIONS["export"](accu, {"formats": [".esdl"]}).head["files"]
    assert read(accu.path.parent / files[0])["base"].value == 1.3


def test_a_class_becomes_formula_text_with_the_same_scores(accu: Session) -> None:
    before = accu.require_view().now.scores[0].rmse
    COMMANDS["convert-function"](accu, {})
    assert accu.settings["model"] == {"file": "Accu.kf"}
    assert accu.require_view().now.scores[0].rmse == pytest.approx(before, rel=1e-12)
    with pytest.raises(ArgumentError, match="not in a file of another tool"):
        program(accu)


def test_keys_of_the_import_are_removed_with_the_class(accu: Session) -> None:
    set_keys(accu, (("model", "class"), "Accu"), (("model", "methods"), ["charge"]), (("model", "folders"), ["Lib"]))
    COMMANDS["choose-function"](accu, {"file": "Battery/Battery.app"})
    assert accu.settings["model"] == {"file": "Battery/Battery.app", "folders": ["Lib"]}
    COMMANDS["new-function"](accu, {})
    assert accu.settings["model"] == {"file": "function.kf"}


def test_a_dropped_archive_of_ascet_6_is_the_function(empty: Session) -> None:
    write_archive(empty.path.parent, plant_component(), LOW_PASS)
    COMMANDS["add-files"](empty, {"files": ["Engine.axl"]})
    assert empty.settings["model"]["file"] == "Engine.axl"
    own = program(empty)
    assert own["whole"]
    assert own["missing"] == []
    assert {item["name"] for item in own["outputs"]} == {"torque", "high"}
    assert [item["name"] for item in own["classes"]] == ["Plant", "LowPass"]
    labels = [item["file"] for item in own["sources"]]
    assert labels[:2] == ["Engine.axl", "Engine.axl/Engine/Plant.specification.amd"]
    assert own["sources"][0]["text"] == ""
    assert "Engine.axl" in QUESTIONS["functions"](empty, {}).head["files"]

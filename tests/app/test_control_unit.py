"""Into the control unit: storage of the labels, rounding, code, and files that are written together or not at all."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.questions.control_unit import UnitCommand, _settings
from kennfeld.app.session.calibration_source import SourceName
from kennfeld.app.session.runs import Run
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetTables
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.calfiles import read
from kennfeld.export import cross_compiler
from kennfeld.export.host_compiler import HostCompiler
from tests.calfiles import a2l_files

PROJECT = """\
model.file = "speed.kf"
calibration.initial = "now.json"
[[dataset]]
files = "d.csv"
[[criterion]]
node = "m"
target = "y"
[parameters.Gain]
[parameters.K]
"""
NOW = {"from": "now"}


def ask(session: Session, question: str, **arguments: Any) -> dict[str, Any]:
    return dict((QUESTIONS.get(question) or COMMANDS[question])(session, arguments).head)


@pytest.fixture
def session(tmp_path: Path) -> Session:
    """Return a session with a map of 3 x 4 values on unequal axes, which fits its data up to noise."""
    rng = np.random.default_rng(3)
    values = np.linspace(3.3, 27.9, 12).reshape(3, 4) + rng.uniform(0, 1, (3, 4))
    gain = kf.Map("Gain", [0.0, 1, 3], [0.0, 2, 3, 7], values, unit="Nm")
    parameters = kf.ParameterSet([gain, kf.Scalar("K", 0.25)])
    # within the cells, so that neighbours make up for each other
    x, z = rng.choice([0.5, 2.0], 300), rng.choice([1.0, 2.5, 5.0], 300)
    x, z = x + rng.uniform(-0.2, 0.2, 300), z + rng.uniform(-0.2, 0.2, 300)
    exact = kf.simulate("m = Gain(x, z) + K", {"x": x, "z": z}, parameters)["m"].values
    y = exact + 0.05 * rng.standard_normal(300)
    rows = "".join(f"{a},{b},{c}\n" for a, b, c in zip(x, z, y, strict=True))
    (tmp_path / "d.csv").write_text(f"x,z,y\n{rows}", encoding="utf-8")
    (tmp_path / "speed.kf").write_text("input x\ninput z\nm[Nm] = Gain(x, z) + K\n", encoding="utf-8")
    parameters.save(tmp_path / "now.json")
    (tmp_path / "kennfeld.toml").write_text(PROJECT, encoding="utf-8")
    session = Session(tmp_path / "kennfeld.toml")
    assert session.findings == ()
    return session


def write(session: Session, **arguments: Any) -> dict[str, Any]:
    return ask(session, "write-unit", **{"source": NOW, "languages": ["m"], "formats": [".json"], **arguments})


def test_a_typed_step_brings_rounding_into_the_project_and_the_last_one_takes_it_away(session: Session) -> None:
    before = session.state.texts
    ask(session, "set-storage", steps={"Gain": 2.5})
    assert not session.stale, session.findings  # but for rounding, the step would be an error
    offered = ask(session, "control-unit")
    assert offered["method"] == "joint"
    assert {row["name"]: (row["step"], row["reason"]) for row in offered["rows"]} == {
        "Gain": (2.5, ""),
        "K": (None, "its step is not known"),
    }
    ask(session, "set-storage", steps={"Gain": None})
    assert not session.stale, session.findings
    assert ask(session, "control-unit")["method"] == ""
    session.undo()
    assert session.undo() == "Step of Gain"
    assert session.state.texts == before
    with pytest.raises(ArgumentError, match="step=0 of Gain must be a finite number > 0"):
        ask(session, "set-storage", steps={"Gain": 0.0})


def test_rounding_has_the_errors_of_both_methods_and_writes_storable_values(session: Session) -> None:
    with pytest.raises(ArgumentError, match="no step is known"):
        ask(session, "rounding", source=NOW, method="joint")
    ask(session, "set-storage", steps={"Gain": 2.5})
    before, parameters = session.state, session.parameters
    reply = ask(session, "rounding", source=NOW, method="joint")
    [error] = reply["errors"]
    assert error["unrounded"] == pytest.approx(session.require_view().now.scores[0].rmse, rel=1e-9)
    assert error["unrounded"] < error["joint"] < error["nearest"]
    [label] = reply["labels"]
    assert (label["name"], label["values"], label["share"]) == ("Gain", 12, pytest.approx(1.0))
    assert reply["advice"] == "Gain"
    assert session.state is before  # nothing is changed
    for method in ("nearest", "joint"):
        assert write(session, rounding=method, languages=[], force=True)["files"] == ["export/parameters.json"]
        stored = read(session.path.parent / "export" / "parameters.json")["Gain"].values
        np.testing.assert_array_equal(stored, 2.5 * np.rint(stored / 2.5))
        scored = session.require_view().model.evaluate(
            parameters.with_parameters(parameters["Gain"].with_values(stored))
        )
        assert scored.scores[0].rmse == pytest.approx(error[method], rel=1e-9)


def test_finer_storage_of_the_label_that_decides_is_computed(session: Session) -> None:
    ask(session, "set-storage", steps={"Gain": 2.5, "K": 0.25})
    reply = ask(session, "rounding", source=NOW, method="joint")
    assert reply["trials"][0] == ["Gain"]
    finer = ask(session, "finer-storage", source=NOW, method="joint", labels=["Gain"])
    assert finer["steps"] == {"Gain": 2.5 / 256}
    assert finer["errors"][0]["joint"] < 1.01 * reply["errors"][0]["unrounded"]
    ask(session, "set-storage", steps=finer["steps"])
    [now] = ask(session, "rounding", source=NOW, method="joint")["errors"]
    assert now == finer["errors"][0]  # as it was promised


def test_in_place_of_values_that_a_run_has_rounded_its_fit_is_rounded(session: Session) -> None:
    ask(session, "set-storage", steps={"Gain": 2.5})
    assert session.project is not None
    result = session.project.calibrate()
    assert result.rounding is not None
    session.runs.append(Run(1, session.parameters, result))
    session.do(SetTables("Run 1", session.values_of(result.parameters, ["Gain", "K"])))
    unrounded = result.rounding.unrounded["m/d"]
    reply = ask(session, "rounding", source=NOW, method="joint")
    assert (reply["run"], reply["errors"][0]["unrounded"]) == (1, unrounded)
    assert reply["errors"][0]["joint"] == result.quality[0].rmse_after
    ask(session, "set-storage", steps={"Gain": 0.5})  # of the fit, not of values in steps of 2.5
    again = ask(session, "rounding", source=NOW, method="nearest")
    assert (again["run"], again["errors"][0]["unrounded"]) == (1, unrounded)
    session.do(SetTables("edited", {"Gain": session.parameters["Gain"].values + 1.0}))
    assert ask(session, "rounding", source=NOW, method="nearest")["run"] == 0


@pytest.mark.skipif(HostCompiler.find() is None, reason="no C compiler")
def test_the_code_is_that_of_the_values_and_is_compared(session: Session) -> None:
    compared = ask(session, "code", source=NOW, check=True)
    assert compared["name"] == "speed"
    assert (compared["compared"]["samples"], compared["compared"]["exact"]) == (300, True)
    ask(session, "set-storage", steps={"Gain": 2.5})
    rounded = ask(session, "code", source=NOW, rounding="nearest", precision="float")
    assert rounded["compared"] is None
    assert rounded["text"] != compared["text"]
    assert (rounded["size"], compared["size"]) == (20 * 4, 20 * 8)  # 12 values, 7 breakpoints and a scalar


def test_without_a_compiler_the_code_is_shown_and_written_but_not_compared(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    assert ask(session, "control-unit")["compiler"] == ""
    assert ask(session, "code", source=NOW, check=True)["compared"] is None
    done = write(session, languages=["c"], formats=[])
    assert done["files"] == ["export/speed.c", "export/speed.h"]
    assert "no C compiler" in " ".join(done["findings"])


def test_files_are_replaced_on_confirmation_only_and_all_together(session: Session) -> None:
    folder = session.path.parent
    assert write(session)["files"] == ["export/parameters.json", "export/speed.m", "export/speed_defaults.m"]
    session.do(SetTables("edited", {"K": np.array(0.75)}))
    before = {path.name: path.read_bytes() for path in (folder / "export").iterdir()}
    assert write(session)["existing"] == ["speed_defaults.m", "parameters.json"]
    assert {path.name: path.read_bytes() for path in (folder / "export").iterdir()} == before
    assert "existing" not in write(session, force=True)
    assert read(folder / "export" / "parameters.json")["K"].values == 0.75
    assert not [path for path in (folder / "export").iterdir() if path.name.startswith(".")]


def test_one_file_that_cannot_be_written_leaves_all_as_they_were(session: Session) -> None:
    folder = session.path.parent / "out"
    (folder / "parameters.json").mkdir(parents=True)  # a folder in the place of a file
    with pytest.raises(InputError, match=r"cannot be written|directory"):
        write(session, folder="out", force=True)
    assert [path.name for path in folder.iterdir()] == ["parameters.json"]
    with pytest.raises(InputError, match="outside"):
        write(session, folder="../elsewhere")
    if hasattr(os, "symlink"):
        (session.path.parent / "linked").symlink_to(folder, target_is_directory=True)
        with pytest.raises(InputError, match="link"):
            write(session, folder="linked")


def test_two_files_of_one_name_are_refused(session: Session) -> None:
    with pytest.raises(ArgumentError, match=r"two of the files would be called parameters\.m;"):
        write(session, name="parameters", formats=[".m"])
    with pytest.raises(ArgumentError, match="no file is chosen"):
        write(session, languages=[], formats=[])


def test_calculated_signals_are_written_as_mdf_with_the_chosen_values(session: Session) -> None:
    session.do(SetTables("edited", {"K": np.array(0.75)}))
    done = write(session, languages=[], formats=[], signals=True)
    assert done["files"] == ["export/simulation.mf4"]
    data = kf.read(session.path.parent / "export" / "simulation.mf4")
    expected = session.require_view().now.outputs[0][0]
    assert data["m"].values == pytest.approx(expected)
    assert data["m"].unit == "Nm"


def test_an_a2l_file_chosen_for_the_storage_states_the_steps(session: Session) -> None:
    folder = session.path.parent
    layout = a2l_files.layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT")
    scale = a2l_files.method("CM", "LINEAR", "COEFFS_LINEAR 0.125 0")
    label = a2l_files.label("VALUE", name="K", conversion="CM", limits="0 30")
    (folder / "ecu.a2l").write_bytes(a2l_files.module(layout, scale, label))
    choices = ask(session, "control-unit")
    assert choices["descriptions"] == ["ecu.a2l"]
    ask(session, "set-storage", steps={}, storage="ecu.a2l")
    assert not session.stale, session.findings
    after = ask(session, "control-unit")
    assert after["storage"] == "ecu.a2l"
    rows = {row["name"]: row for row in after["rows"]}
    assert (rows["K"]["step"], rows["K"]["bits"]) == (0.125, 8)
    assert "ecu.a2l does not define it" in rows["Gain"]["reason"]
    ask(session, "set-storage", steps={}, storage="")
    assert ask(session, "control-unit")["storage"] == ""


def test_libraries_of_an_fmu_for_other_machines_are_offered_and_refused_without_their_compiler(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cross_compiler, "find_spec", lambda name: None)
    offered = ask(session, "control-unit")
    assert {offered["platform"], *offered["platforms"]} >= set(cross_compiler.PLATFORMS)
    assert offered["platform"] not in offered["platforms"]
    assert "pip install kennfeld[platforms]" in offered["cross"]
    with pytest.raises(ArgumentError, match="ziglang"):
        write(session, languages=["c", "fmu"], platforms=[offered["platforms"][0]])
    assert not (session.path.parent / "export").exists()
    monkeypatch.setattr(cross_compiler, "find_spec", lambda name: object())
    assert ask(session, "control-unit")["cross"] == ""
    chosen = UnitCommand(SourceName("now"), ["fmu"], [], platforms=["aarch64-linux", "aarch64-linux"])
    assert _settings(chosen, "fmu").platforms == ("aarch64-linux",)

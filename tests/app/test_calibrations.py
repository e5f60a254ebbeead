"""Calibration files in the app: compared, taken into the project, merged, converted, and written into images."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

import kennfeld as kf
from kennfeld.app.session.calibration_source import SourceName, source_of
from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError, InputError
from tests.app.questions import ask

NOW, START = {"from": "now"}, {"from": "start"}


def file(name: str, a2l: str = "") -> dict[str, str]:
    return {"from": "file", "file": name, "a2l": a2l}


@pytest.fixture
def session(torque: Path) -> Session:
    return Session(torque)


@pytest.fixture
def bench(session: Session) -> str:
    """Return a file of the folder with other values of two tables."""
    own = session.parameters
    map_, curve = own["MapOptTorque"], own["CurveEtaDeltaSpark"]
    changed = own.with_parameters(map_.with_values(map_.values + 3.0), curve.with_values(curve.values * 0.9))
    changed.without(["MapDragTorque"]).save(session.path.parent / "bench.dcm")
    return "bench.dcm"


def test_the_calibration_files_of_the_folder_are_listed(session: Session, bench: str) -> None:
    folder = session.path.parent
    (folder / "sub").mkdir()
    session.parameters.save(folder / "sub" / "other.json")
    (folder / "sub" / "settings.json").write_text("{}")
    (folder / ".hidden").mkdir()
    session.parameters.save(folder / ".hidden" / "secret.dcm")
    (folder.parent / "outside").mkdir()
    session.parameters.save(folder.parent / "outside" / "outside.dcm")
    (folder / "link").symlink_to(folder.parent / "outside")
    names = [each["name"] for each in ask(session, "calibrations").head["files"]]
    assert names == [bench, "start.dcm", "sub/other.json"]


def test_differences_have_a_row_for_each_name(session: Session, bench: str) -> None:
    head = ask(session, "differences", first=NOW, second=file(bench)).head
    rows = {row["name"]: row for row in head["rows"]}
    assert set(rows) == {"MapOptTorque", "CurveEtaDeltaSpark", "MapDragTorque"}
    assert rows["MapOptTorque"]["largest"] == pytest.approx(3.0)
    assert rows["MapOptTorque"]["differ"] == rows["MapOptTorque"]["total"] == session.parameters["MapOptTorque"].size
    assert rows["MapDragTorque"]["only"] == "first"
    assert not rows["MapDragTorque"]["takeable"]
    assert head["compared"] == len(session.parameters) - 1


def test_a_tolerance_hides_small_differences(session: Session, bench: str) -> None:
    head = ask(session, "differences", first=NOW, second=file(bench), tolerance=3.5).head
    assert [row["name"] for row in head["rows"]] == ["MapDragTorque"]


def test_a_pair_has_both_tables(session: Session, bench: str) -> None:
    head = ask(session, "pair", first=NOW, second=file(bench), name="MapOptTorque").head
    assert np.subtract(head["second"]["values"], head["first"]["values"]) == pytest.approx(3.0)
    assert ask(session, "pair", first=NOW, second=file(bench), name="MapDragTorque").head["second"] is None


def test_taken_values_are_undone_at_once(session: Session, bench: str) -> None:
    before = session.parameters["MapOptTorque"].values.copy()
    ask(session, "take-values", source=file(bench), names=["MapOptTorque", "CurveEtaDeltaSpark"])
    assert session.parameters["MapOptTorque"].values == pytest.approx(before + 3.0)
    assert session.undo() == "Took MapOptTorque, CurveEtaDeltaSpark from bench.dcm"
    assert session.parameters["MapOptTorque"].values == pytest.approx(before)


def test_other_axes_are_interpolated_onto_those_of_the_project(session: Session) -> None:
    own = session.parameters["MapOptTorque"]
    x, y = (np.linspace(axis.breakpoints[0], axis.breakpoints[-1], 3) for axis in own.axes)
    plane = kf.Map("MapOptTorque", x, y, 2.0 * x[:, None] + 5.0 * y, unit="Nm")
    kf.ParameterSet([plane]).save(session.path.parent / "coarse.json")
    head = ask(session, "take-values", source=file("coarse.json"), names=["MapOptTorque"]).head
    assert head["findings"] == ["MapOptTorque: interpolated onto the axes of the project"]
    expected = 2.0 * own.axes[0].breakpoints[:, None] + 5.0 * own.axes[1].breakpoints
    assert session.parameters["MapOptTorque"].values == pytest.approx(expected)


def test_the_place_of_a_difference_names_the_axes(session: Session, bench: str) -> None:
    rows = ask(session, "differences", first=NOW, second=file(bench)).head["rows"]
    places = {row["name"]: row["place"] for row in rows}
    assert places["MapOptTorque"] == "Speed = 700, Rel_Airmass = 28"


def test_a_parameter_of_another_kind_is_refused(session: Session) -> None:
    kf.ParameterSet([kf.Scalar("MapOptTorque", 1.0)]).save(session.path.parent / "scalar.json")
    with pytest.raises(ArgumentError, match="MapOptTorque is a map"):
        ask(session, "take-values", source=file("scalar.json"), names=["MapOptTorque"])


def test_ticked_labels_are_merged_into_a_file(session: Session, bench: str) -> None:
    arguments = {"first": NOW, "second": file(bench), "names": ["MapOptTorque"], "target": "both.cdfx"}
    head = ask(session, "write-calibration", **arguments).head
    assert head["changes"] == [{"name": "MapOptTorque", "action": "replaced", "details": head["changes"][0]["details"]}]
    merged = kf.read_parameters(session.path.parent / "both.cdfx")
    now = session.parameters
    assert merged["MapOptTorque"].values == pytest.approx(now["MapOptTorque"].values + 3.0)
    assert merged["CurveEtaDeltaSpark"].values == pytest.approx(now["CurveEtaDeltaSpark"].values)


def test_a_file_is_converted_with_warnings_of_lost_properties(session: Session) -> None:
    head = ask(session, "write-calibration", first=START, target="start.csv").head
    assert any("descriptions are left out" in text for text in head["findings"])
    assert ask(session, "differences", first=START, second=file("start.csv")).head["rows"] == []


def test_a_file_is_replaced_only_on_request(session: Session, bench: str) -> None:
    content = (session.path.parent / bench).read_bytes()
    assert ask(session, "write-calibration", first=START, target=bench).head == {"exists": bench}
    assert (session.path.parent / bench).read_bytes() == content
    ask(session, "write-calibration", first=START, target=bench, force=True)
    assert ask(session, "differences", first=START, second=file(bench)).head["rows"] == []


@pytest.mark.parametrize("name", ["../other.dcm", "/etc/passwd", "sub/../../x.dcm", "missing.dcm", "link.dcm"])
def test_files_outside_are_neither_read_nor_written(session: Session, name: str) -> None:
    session.parameters.save(session.path.parents[1] / "other.dcm")
    (session.path.parent / "link.dcm").symlink_to(session.path.parents[1] / "other.dcm")
    with pytest.raises(ArgumentError):
        ask(session, "contents", source=file(name))
    with pytest.raises(ArgumentError):
        ask(session, "write-calibration", first=START, target="new.hex", image=name)


def test_a_target_stays_in_the_folder(session: Session) -> None:
    head = ask(session, "write-calibration", first=START, target="../../out.json").head
    assert head["file"] == "out.json"
    assert (session.path.parent / "out.json").is_file()


@pytest.mark.parametrize("target", ["kennfeld.toml", "function", "x.exe"])
def test_only_calibration_files_are_written(session: Session, target: str) -> None:
    with pytest.raises((ArgumentError, InputError)):
        ask(session, "write-calibration", first=START, target=target, force=True)


def test_the_contents_of_a_file_are_listed(session: Session, bench: str) -> None:
    head = ask(session, "contents", source=file(bench)).head
    row = next(row for row in head["rows"] if row["name"] == "MapOptTorque")
    own = session.parameters["MapOptTorque"].values + 3.0
    assert (row["kind"], row["unit"]) == ("map", "Nm")
    assert (row["least"], row["greatest"]) == (pytest.approx(own.min()), pytest.approx(own.max()))


@pytest.fixture
def flash(torque: Path) -> Path:
    """Return a project that starts from an image: a curve of bytes in steps of 0.01."""
    from tests.calfiles.a2l_files import axis, hex_file, label, layout, method, module

    folder = torque.parent
    points = axis("FIX_AXIS", 12, "FIX_AXIS_PAR_DIST -15 5 12")
    blocks = (
        layout("FNC_VALUES 1 UBYTE COLUMN_DIR DIRECT"),
        method("CM", "RAT_FUNC", "COEFFS 0 100 0 0 0 1"),
        label("CURVE", points, name="CurveEtaDeltaSpark", conversion="CM", limits="0 2"),
    )
    (folder / "ecu.a2l").write_bytes(module(*blocks))
    (folder / "ecu.hex").write_bytes(hex_file({0x1000: bytes(range(80, 92))}))
    return torque


def test_a_file_written_as_an_image_lists_rounded_values(flash: Path) -> None:
    session = Session(flash)
    head = ask(session, "calibrations").head
    assert {"name": "ecu.hex", "format": "HEX", "image": True} in head["files"]
    assert head["descriptions"] == ["ecu.a2l"]
    curve = kf.read_parameters(flash.parent / "ecu.hex")["CurveEtaDeltaSpark"]
    assert curve.values[0] == pytest.approx(0.80)
    kf.ParameterSet([curve.with_values(curve.values + 0.0142)]).save(flash.parent / "new.json")
    arguments = {"first": file("new.json"), "target": "new.hex", "image": "ecu.hex", "a2l": "ecu.a2l"}
    answer = ask(session, "write-calibration", **arguments).head
    (row,) = answer["rounded"]
    assert (row["name"], row["differ"], row["total"]) == ("CurveEtaDeltaSpark", 12, 12)
    assert row["largest"] == pytest.approx(0.0042, rel=1e-6)
    assert [text for text in answer["findings"] if "rounded to storable values" in text], answer["findings"]


def test_an_image_as_initial_file_is_exported_with_its_rounding(flash: Path) -> None:
    session = Session(flash)
    session.parameters.without(["CurveEtaDeltaSpark"]).save(flash.parent / "maps.dcm")
    assert ".hex" not in ask(session, "formats").head["formats"]
    initial = ["maps.dcm", {"a2l": "ecu.a2l", "hex": "ecu.hex"}]
    ask(session, "set-keys", changes=[[["calibration", "initial"], initial]], title="Start from ecu.hex")
    assert not session.stale, session.findings
    assert ".hex" in ask(session, "formats").head["formats"]
    values = session.parameters["CurveEtaDeltaSpark"].values
    ask(session, "set-values", name="CurveEtaDeltaSpark", cells=[0, 3], values=[0.8, 0.9876], title="Typed")
    answer = ask(session, "export", formats=[".hex"]).head
    assert answer["files"] == ["results/parameters.hex"]
    (row,) = answer["rounded"]
    assert (row["name"], row["differ"]) == ("CurveEtaDeltaSpark", 1)
    assert row["largest"] == pytest.approx(0.0024, rel=1e-6)
    stored = kf.read_parameters(flash.parent / "results" / "parameters.hex", a2l=flash.parent / "ecu.a2l")
    assert stored["CurveEtaDeltaSpark"].values[3] == pytest.approx(0.99)
    assert stored["CurveEtaDeltaSpark"].values[4:] == pytest.approx(values[4:])


def test_a_value_beyond_the_raw_scale_is_refused_by_name(flash: Path) -> None:
    session = Session(flash)
    curve = kf.read_parameters(flash.parent / "ecu.hex")["CurveEtaDeltaSpark"]
    kf.ParameterSet([curve.with_values(curve.values + 5.0)]).save(flash.parent / "new.json")
    with pytest.raises(InputError, match="CurveEtaDeltaSpark"):
        ask(session, "write-calibration", first=file("new.json"), target="new.hex", image="ecu.hex")
    assert not (flash.parent / "new.hex").exists()


def test_the_labels_of_an_a2l_file_are_listed(flash: Path) -> None:
    head = ask(Session(flash), "contents", source=file("ecu.a2l")).head
    (row,) = head["rows"]
    assert (row["name"], row["kind"], row["size"], row["greatest"]) == ("CurveEtaDeltaSpark", "curve", "12", 2.0)


def test_values_follow_a_file_that_the_description_includes(flash: Path) -> None:
    description, included = flash.parent / "ecu.a2l", flash.parent / "methods.a2l"
    text = description.read_text(encoding="latin-1")
    start = text.index("/begin COMPU_METHOD")
    end = text.index("/end COMPU_METHOD") + len("/end COMPU_METHOD")
    included.write_text(text[start:end], encoding="latin-1")
    description.write_text(text[:start] + '/include "methods.a2l"' + text[end:], encoding="latin-1")
    session = Session(flash)
    before = source_of(session, SourceName("file", "ecu.hex", "ecu.a2l")).parameters["CurveEtaDeltaSpark"].values
    included.write_text(text[start:end].replace("0 100 0", "0 200 0"), encoding="latin-1")
    after = source_of(session, SourceName("file", "ecu.hex", "ecu.a2l")).parameters["CurveEtaDeltaSpark"].values
    np.testing.assert_array_equal(after, before / 2)


@pytest.mark.slow
def test_the_report_on_an_earlier_run_is_written_from_its_folder(session: Session) -> None:
    from kennfeld.project import Project
    from kennfeld.project.results import write

    folder = session.path.parent / "results"
    assert not ask(session, "formats").head["stored"]
    project = Project.read(session.path)
    write(project.calibrate(), project, folder)
    assert ask(session, "formats").head["stored"]
    assert ask(session, "export", formats=[], stored=True).head["files"] == ["results/report.html"]
    assert "TorquePredict" in (folder / "report.html").read_text()


def test_a_simulation_is_written_at_the_present_values(session: Session) -> None:
    ask(session, "set-values", name="MapOptTorque", cells=[0], values=[200.0], title="Typed")
    assert ask(session, "export", formats=[], simulation=".csv").head["files"] == ["simulation.csv"]
    header = (session.path.parent / "simulation.csv").read_text().splitlines()[0]
    assert "TorquePredict" in header
    assert ask(session, "export", formats=[], simulation=".mat").head["files"] == ["simulation.mat"]
    bench = loadmat(session.path.parent / "simulation.mat", simplify_cells=True)["bench"]
    np.testing.assert_allclose(bench["TorquePredict_error"], bench["TorquePredict"] - bench["Torque"])
    with pytest.raises(ArgumentError):
        ask(session, "export", formats=[], simulation=".exe")

"""Saved projects: what the app writes is a project that Kennfeld reads, with the values that were shown."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetTables, SetText
from kennfeld.domain.parameters import Parameter
from kennfeld.project import Project
from kennfeld.project.demo import prepare, write
from tests.app.function_samples import write_functions
from tests.app.test_edited_values import calibrate
from tests.project.flash_files import A2L, hex_of

EXAMPLES = Path(__file__).parents[2] / "examples"
X = np.linspace(0.0, 4.0, 81)
PROJECT = """\
model.file = "m.kf"
[[dataset]]
files = "d.csv"
[[criterion]]
node = "m"
target = "y"
[calibration]
"""


def save_and_read_again(path: Path) -> None:
    """Edit all values of a project, save it, and require that a check passes and that the same values are read."""
    session = Session(path)
    assert session.view is not None, session.findings
    assert session.project is not None
    now = session.parameters.without(session.project.surrogates)
    edited = {name: now[name].values + 0.25 * (1 + np.abs(now[name].values)) for name in now}
    held = {name: np.clip(values, now[name].lower, now[name].upper) for name, values in edited.items()}
    session.do(SetTables("edited", held))
    shown = session.parameters
    session.save()
    errors = [str(finding) for finding in Project.read(path).check() if finding.severity == "error"]
    assert errors == []
    again = Session(path).parameters
    for name in shown:
        np.testing.assert_array_equal(again[name].values, shown[name].values, err_msg=name)
        for one, other in zip(again[name].axes, shown[name].axes, strict=True):
            np.testing.assert_array_equal(one.breakpoints, other.breakpoints, err_msg=name)


def write_project(folder: Path, calibration: str, *tables: Parameter) -> Path:
    folder.mkdir(exist_ok=True)
    rows = "".join(f"{x},{x / 2},{3 * x}\n" for x in X)
    (folder / "d.csv").write_text(f"x,z,y\n{rows}", encoding="utf-8")
    (folder / "m.kf").write_text("input x\ninput z\nm = A(x) + B(x, z) + K\n", encoding="utf-8")
    if tables:
        kf.ParameterSet([*tables]).save(folder / "start.dcm")
    (folder / "kennfeld.toml").write_text(PROJECT + calibration, encoding="utf-8")
    return folder / "kennfeld.toml"


def group(points: list[float]) -> kf.Axis:
    return kf.Axis(points, input="x", name="AX")


A = kf.Curve("A", [0.0, 1, 2, 4], [1.0, 2, 3, 4])
B = kf.Map("B", [0.0, 2, 4], [0.0, 2], np.ones((3, 2)))
K = kf.Scalar("K", 1.0)
SHARED = (
    kf.Curve("A", group([0.0, 2, 4]), [1.0, 2, 3]),
    kf.Map("B", group([0.0, 2, 4]), [0.0, 2], np.ones((3, 2))),
)
START = 'initial = "start.dcm"\n'
WRITERS: dict[str, Callable[[Path], Path]] = {
    "values of the start": lambda folder: write_project(folder, START, A, B, K),
    "axes of its own": lambda folder: write_project(
        folder, f"{START}[parameters.A]\nx = {{ breakpoints = [0, 2, 4] }}\n", A, B, K
    ),
    "axes of its own, of the same number": lambda folder: write_project(
        folder, f"{START}[parameters.B]\nx = {{ breakpoints = [0, 1, 4] }}\ny = {{ breakpoints = [0, 1] }}\n", A, B, K
    ),
    "an axis of its own for a table of a group": lambda folder: write_project(
        folder, f"{START}[parameters.A]\nx = {{ breakpoints = [0, 1, 2, 4] }}\n", *SHARED, K
    ),
    "no initial file": lambda folder: write_project(
        folder,
        "[parameters.A]\nx = { breakpoints = [0, 4] }\ninitial = 1\n"
        "[parameters.B]\nx = { begin = 0, end = 4, count = 3 }\ny = { count = 3 }\ninitial = 1\n"
        "[parameters.K]\ninitial = 0\nbounds = [-1, 1]\n",
    ),
    "functions of C": lambda folder: write_functions(folder),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_a_saved_project_is_one_that_kennfeld_reads(tmp_path: Path, kind: str) -> None:
    save_and_read_again(WRITERS[kind](tmp_path / "project"))


def test_a_saved_project_with_an_image_and_axes_of_its_own_is_one_that_kennfeld_reads(tmp_path: Path) -> None:
    (tmp_path / "ecu.a2l").write_text(A2L)
    (tmp_path / "ecu.hex").write_text(hex_of(100, 100, 100, 0))
    rows = "".join(f"{speed},{speed / 1000}\n" for speed in range(1000, 3001, 100))
    (tmp_path / "d.csv").write_text(f"Speed,y\n{rows}", encoding="utf-8")
    (tmp_path / "m.kf").write_text("input Speed\nm = Gain(Speed) + offset\n", encoding="utf-8")
    initial = 'initial = { a2l = "ecu.a2l", hex = "ecu.hex" }\n'
    section = "[parameters.Gain]\nx = { breakpoints = [1000, 1500, 2500, 3000] }\n"
    (tmp_path / "kennfeld.toml").write_text(PROJECT + initial + section, encoding="utf-8")
    save_and_read_again(tmp_path / "kennfeld.toml")


@pytest.mark.slow
@pytest.mark.usefixtures("forked_workers")
def test_a_project_whose_run_has_moved_breakpoints_of_an_initial_file_is_saved(tmp_path: Path) -> None:
    path = write_project(
        tmp_path / "p",
        f"{START}free = ['A']\n[axes.AX]\nfree = true\n[parameters.A]\nx = {{ axis = 'AX' }}\n",
        SHARED[0],
        B,
        K,
    )
    y = np.interp(X, [0, 0.7, 4], [2, 9, 4]) + 2
    rows = "".join(f"{a},{a / 2},{b}\n" for a, b in zip(X, y, strict=True))
    path.with_name("d.csv").write_text(f"x,z,y\n{rows}", encoding="utf-8")
    session = Session(path)
    calibrate(session)
    moved = session.parameters["A"].axes[0].breakpoints
    assert moved[1] == pytest.approx(0.7, abs=0.05)
    shown = session.require_view().now.scores
    session.save()
    again = Session(path)
    assert [str(f) for f in again.findings if f.severity == "error"] == []
    np.testing.assert_array_equal(again.parameters["A"].axes[0].breakpoints, moved)
    assert [s.rmse for s in again.require_view().now.scores] == pytest.approx([s.rmse for s in shown])


@pytest.mark.slow
@pytest.mark.parametrize("demo", ["torque", "exhaust", "idle"])
def test_a_saved_demo_is_a_project_that_kennfeld_reads(tmp_path: Path, demo: str) -> None:
    path = write(demo, tmp_path / demo)
    prepare(demo, path.parent, lambda line: None)
    save_and_read_again(path)


@pytest.mark.slow
@pytest.mark.guests
@pytest.mark.parametrize("example", sorted(path.parent.name for path in EXAMPLES.glob("*/kennfeld.toml")))
def test_a_saved_example_is_a_project_that_kennfeld_reads(tmp_path: Path, example: str) -> None:
    shutil.copytree(EXAMPLES / example, tmp_path / example)
    save_and_read_again(tmp_path / example / "kennfeld.toml")


def test_an_undo_after_saving_brings_the_text_of_a_file_back(tmp_path):
    session = Session(write_project(tmp_path / "p", START, A, B, K))
    file, before = session.path.with_name("m.kf"), session.text_of("m.kf")
    session.do(SetText("Doubled K", "m.kf", before.replace("K", "2 * K")))
    session.do(SetTables("edited", {"K": np.array(3.0)}))
    session.save()
    assert (session.undo(), session.undo()) != ("", "")
    assert session.text_of("m.kf") == before
    assert session.has_edits
    session.save()
    assert file.read_text(encoding="utf-8") == before
    assert session.redo()
    session.save()
    assert file.read_text(encoding="utf-8") == before.replace("K", "2 * K")
    assert Project.read(session.path).check() == []


def test_a_file_that_is_edited_and_restored_has_no_edits(tmp_path):
    session = Session(write_project(tmp_path / "p", START, A, B, K))
    session.do(SetText("Doubled K", "m.kf", session.text_of("m.kf").replace("K", "2 * K")))
    assert (session.has_edits, list(session.unsaved_texts)) == (True, ["m.kf"])
    session.undo()
    assert (session.has_edits, session.unsaved_texts, session.conflicts, session.disk_changes) == (False, {}, [], ())


def test_an_undo_of_what_is_saved_is_not_saved(tmp_path):
    session = Session(write_project(tmp_path / "p", START, A, B, K))
    session.do(SetTables("edited", {"K": np.array(3.0)}))
    session.save()
    session.reload()
    assert not session.has_edits
    session.undo()
    assert session.has_edits
    assert session.history.titles_since(session.saved) == ["Undone: edited"]

"""Remedies of undetermined values as keys of the project file, and their effect."""

from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.multistart import run
from kennfeld.optimize.trust.remedies import Remedy
from kennfeld.project import Project
from kennfeld.project.document import ProjectDocument
from kennfeld.project.remedies import KeyChanges, boxes, key_changes

X = np.linspace(0.0, 2.9, 60)


def project(folder: Path, parameters: str, formula: str = "y_model = C(x) + k") -> Path:
    """Write a project: y = 1 + x over 0 <= x < 3, with a curve C over 0 to 4."""
    rows = "\n".join(f"{x:.6g},{1 + x:.6g}" for x in X)
    (folder / "data.csv").write_text(f"x,y\n{rows}\n")
    (folder / "function.kf").write_text(f"{formula}\n")
    text = '[model]\nfile = "function.kf"\n\n[[dataset]]\nfiles = "data.csv"\n\n[[criterion]]\nnode = "y_model"\n'
    (folder / "kennfeld.toml").write_text(f'{text}target = "y"\n\n{parameters}')
    return folder / "kennfeld.toml"


CURVE = "[parameters.C]\nx = { breakpoints = [0, 1, 2, 3, 4] }\ninitial = 1.0\n"
OFFSET = "\n[parameters.k]\ninitial = 0.5\n"


def calibrated(path: Path) -> tuple[Problem, kf.Result]:
    own = Project.read(path)
    return own.problem(), run(own.problem(), Options())


def apply(path: Path, change: KeyChanges) -> None:
    document = ProjectDocument.read(path)
    for key, value in change.changes:
        document.remove(key) if value is None else document.set(key, value)
    document.save()


def settings(path: Path) -> dict[str, object]:
    tables: dict[str, object] = ProjectDocument.read(path).get()
    return tables


def test_the_remedy_of_the_null_space_determines_all_values(tmp_path: Path) -> None:
    path = project(tmp_path, CURVE + OFFSET)
    problem, result = calibrated(path)
    assert result.trust.null_space.dimension == 2  # sum of curve and offset, and the point at 4
    change = key_changes(result.trust.null_space.remedy, problem, settings(path))
    assert change is not None
    assert not change.applied
    apply(path, change)
    again = key_changes(result.trust.null_space.remedy, problem, settings(path))
    assert again is not None
    assert again.applied
    assert calibrated(path)[1].trust.null_space.dimension == 0


def test_every_remedy_of_a_direction_reduces_the_null_space(tmp_path: Path) -> None:
    text = CURVE + OFFSET
    path = project(tmp_path, text)
    problem, result = calibrated(path)
    open_before = result.trust.null_space.dimension
    choices = [each for direction in result.trust.directions for each in direction.remedies]
    assert len(choices) >= 2
    for choice in choices:
        path = project(tmp_path, text)
        change = key_changes(choice, problem, settings(path))
        assert change is not None
        apply(path, change)
        assert calibrated(path)[1].trust.null_space.dimension < open_before, change.title


def test_more_smoothness_multiplies_that_of_the_run(tmp_path: Path) -> None:
    path = project(tmp_path, CURVE + "smoothness = 0.02\n", "y_model = C(x)")
    problem, _ = calibrated(path)
    change = key_changes(Remedy(smoother=("C",)), problem, settings(path))
    assert change is not None
    assert change.changes == ((("parameters", "C", "smoothness"), 0.2),)
    apply(path, change)
    again = key_changes(Remedy(smoother=("C",)), problem, settings(path))
    assert again is not None
    assert again.applied


def test_smoothness_is_chosen_from_the_data_if_there_was_none(tmp_path: Path) -> None:
    path = project(tmp_path, CURVE, "y_model = C(x)")
    problem, _ = calibrated(path)
    change = key_changes(Remedy(smoother=("C",)), problem, settings(path))
    assert change is not None
    assert change.changes[0][1] == "auto"


def test_smoothness_that_was_chosen_from_the_data_is_multiplied(tmp_path: Path) -> None:
    path = project(tmp_path, CURVE + 'smoothness = "auto"\n', "y_model = C(x)")
    problem, result = calibrated(path)
    change = key_changes(Remedy(smoother=("C",)), problem, settings(path), result.smoothness)
    assert change is not None
    assert change.changes[0][1] == pytest.approx(10 * result.smoothness["C"]["x"], rel=1e-3)


def test_a_pin_is_added_to_existing_ones(tmp_path: Path) -> None:
    path = project(tmp_path, CURVE + "pin = [{ at = [1], value = 2 }]\n", "y_model = C(x)")
    problem, _ = calibrated(path)
    change = key_changes(Remedy(pins=(kf.Pin("C", (3.0,), 4.0),)), problem, settings(path))
    assert change is not None
    assert change.title == "Pin C at 3 to 4"
    assert change.changes[0][1] == [{"at": [1], "value": 2}, {"at": [3.0], "value": 4.0}]


FREE = '[parameters.C]\nx = { breakpoints = "free", begin = 0, end = 4, count = 5 }\ninitial = 1.0\n'


def test_a_free_axis_is_fixed_where_it_started(tmp_path: Path) -> None:
    path = project(tmp_path, FREE, "y_model = C(x)")
    problem = Project.read(path).problem()
    change = key_changes(Remedy(axes=("C.x",)), problem, settings(path))
    assert change is not None
    assert change.kind == "fix"
    apply(path, change)
    fixed = Project.read(path).problem()
    assert not fixed.free_axes
    assert fixed.parameters["C"].axes[0].breakpoints.tolist() == [0, 1, 2, 3, 4]


def test_a_free_axis_is_coarsened(tmp_path: Path) -> None:
    path = project(tmp_path, FREE, "y_model = C(x)")
    problem, _ = calibrated(path)
    change = key_changes(Remedy(coarser=("C.x",)), problem, settings(path))
    assert change is not None
    apply(path, change)
    coarse = Project.read(path).problem()
    assert list(map(str, coarse.free_axes)) == ["C.x"]
    assert coarse.parameters["C"].axes[0].breakpoints.tolist() == [0, 2, 4]


def test_ranges_of_a_lock_cover_exactly_the_marked_values() -> None:
    table = kf.Map("M", np.arange(5.0), np.arange(4.0), np.zeros((5, 4)))
    rng = np.random.default_rng(3)
    for share in (0.1, 0.5, 0.9):
        where = rng.random((5, 4)) < share
        covered = np.zeros((5, 4), dtype=bool)
        for box in boxes(table, where):
            x, y = box.get("x", [0, 4]), box.get("y", [0, 3])
            inside = (np.arange(5) >= x[0])[:, None] & (np.arange(5) <= x[1])[:, None]
            inside = inside & (np.arange(4) >= y[0]) & (np.arange(4) <= y[1])
            assert not (covered & inside).any()
            covered |= inside
        assert (covered == where).all()

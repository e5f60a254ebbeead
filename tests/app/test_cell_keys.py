"""Locks and pins of single values, as keys of the project file."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.app.session.cell_keys import lock_changes, pin_changes, pinned_cells
from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError
from tests.app.questions import ask

TABLE = kf.Map("M", [0.0, 1.0, 2.0], [0.0, 10.0], np.arange(6.0).reshape(3, 2))


def cells(*numbers: int) -> np.ndarray:
    where = np.zeros(6, dtype=bool)
    where[list(numbers)] = True
    return where.reshape(3, 2)


def test_a_locked_point_is_a_range_of_one_point() -> None:
    assert lock_changes({}, TABLE, cells(2), locked=True) == [
        (("parameters", "M", "lock"), [{"x": [1.0, 1.0], "y": [0.0, 0.0]}])
    ]


def test_a_point_unlocked_of_a_locked_table_leaves_ranges_of_the_others() -> None:
    locked = TABLE.changed(locked=True)
    [(_, ranges)] = lock_changes({"parameters": {"M": {"lock": True}}}, locked, cells(0), locked=False)
    again = np.zeros((3, 2), dtype=bool)
    for each in ranges:
        (x0, x1), (y0, y1) = each.get("x", [0, 2]), each.get("y", [0, 10])
        again |= np.logical_and.outer(
            (TABLE.axes[0].breakpoints >= x0) & (TABLE.axes[0].breakpoints <= x1),
            (TABLE.axes[1].breakpoints >= y0) & (TABLE.axes[1].breakpoints <= y1),
        )
    assert np.array_equal(again, ~cells(0))


def test_the_last_unlocked_point_removes_the_key() -> None:
    table, path = TABLE.changed(locked=cells(2)), ("parameters", "M", "lock")
    assert lock_changes({"parameters": {"M": {"lock": [{"x": [1, 1]}]}}}, table, cells(2), locked=False) == [
        (path, None)
    ]
    # locked by the initial file, which only a key can overrule
    assert lock_changes({}, table, cells(2), locked=False) == [(path, False)]


def test_pins_are_added_moved_and_removed_at_their_grid_points() -> None:
    path, between = ("parameters", "M", "pin"), {"at": [0.5, 3.0], "value": 7.0}
    settings = {"parameters": {"M": {"pin": [between, {"at": [1, 10], "value": 0}]}}}
    assert pinned_cells(settings, TABLE) == [3]
    both = [between, {"at": [1.0, 10.0], "value": 3.0}, {"at": [2.0, 0.0], "value": 4.0}]
    assert pin_changes(settings, TABLE, [3, 4], pinned=True) == [(path, both)]
    assert pin_changes(settings, TABLE, [3], pinned=False) == [(path, [between])]
    assert pin_changes({}, TABLE, [3], pinned=False) == [(path, None)]


@pytest.mark.parametrize("entry", [{"at": [1]}, {"at": "1"}, {"at": ["a", 1]}, 3, {}])
def test_a_pin_that_is_wrong_is_kept_and_marks_nothing(entry: Any) -> None:
    settings = {"parameters": {"M": {"pin": [entry]}}}
    assert pinned_cells(settings, TABLE) == []
    assert pin_changes(settings, TABLE, [0], pinned=False) == [(("parameters", "M", "pin"), [entry])]


def test_marks_of_the_page_are_locks_and_pins_of_the_project(torque: Path) -> None:
    session = Session(torque)
    name = "MapOptTorque"
    before = session.state
    ask(session, "lock-values", name=name, cells=[3, 4], on=True, title="locked")
    ask(session, "pin-values", name=name, cells=[20], on=True, title="pinned")
    assert not session.stale, session.findings
    table = ask(session, "table", name=name).head["table"]
    assert table["locked"] == [3, 4]
    assert table["pinned"] == [20]
    [pin] = [pin for pin in session.require_view().model.problem.pins if pin.parameter == name]
    assert pin.value == pytest.approx(table["values"][20])
    ask(session, "lock-values", name=name, cells=[3, 4], on=False, title="unlocked")
    ask(session, "pin-values", name=name, cells=[20], on=False, title="unpinned")
    table = ask(session, "table", name=name).head["table"]
    assert table["locked"] == table["pinned"] == []
    for _ in range(4):
        session.undo()
    assert session.state == before
    for question in ("lock-values", "pin-values"):
        with pytest.raises(ArgumentError, match="none with the number 9999"):
            ask(session, question, name=name, cells=[9999], on=True, title="")

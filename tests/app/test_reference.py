"""The reference of the present values: the start, a run or a file."""

from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.app.questions.overview import overview
from kennfeld.app.session.reference import relative_change, relative_deviation
from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError, KennfeldError
from tests.app.questions import ask

NAME = "CurveEtaDeltaSpark"


def test_a_file_is_the_reference_on_the_present_breakpoints(torque: Path) -> None:
    session = Session(torque)
    own = session.parameters[NAME]
    coarse = kf.Curve(NAME, own.axes[0].breakpoints[[0, -1]], [0.0, 1.0])
    kf.ParameterSet([coarse]).save(torque.parent / "other.json")
    before = session.revision
    ask(session, "choose-reference", source={"from": "file", "file": "other.json"})
    assert session.revision > before
    table = ask(session, "table", name=NAME).head["table"]
    assert table["reference"] == pytest.approx(coarse(own.axes[0].breakpoints).tolist())
    assert table["referenceTitle"] == "other.json, interpolated"
    other = ask(session, "table", name="MapOptTorque").head["table"]
    assert other["reference"] == other["values"]
    assert other["referenceTitle"] == "start, as other.json lacks it"
    rows = {row.name: row for row in overview(session).parameters}
    assert rows[NAME].changed == np.count_nonzero(coarse(own.axes[0].breakpoints) != own.values)
    assert rows["MapOptTorque"].changed == 0
    # as it was when it was chosen
    (torque.parent / "other.json").unlink()
    assert ask(session, "table", name=NAME).head["table"]["reference"] == table["reference"]
    ask(session, "choose-reference", source=None)
    assert ask(session, "table", name=NAME).head["table"]["referenceTitle"] == "start"


def test_a_set_that_is_missing_is_refused_and_the_reference_stays(torque: Path) -> None:
    session = Session(torque)
    ask(session, "choose-reference", source={"from": "start"})
    for source in ({"from": "3"}, {"from": "now"}, {"from": "file", "file": "none.dcm"}):
        with pytest.raises(KennfeldError):
            ask(session, "choose-reference", source=source)
    assert overview(session).reference.key == "start"
    with pytest.raises(ArgumentError, match="compared with themselves"):
        ask(session, "choose-reference", source={"from": "now"})


def test_edits_are_counted_against_the_reference(torque: Path) -> None:
    session = Session(torque)
    ask(session, "set-values", name=NAME, cells=[0, 1], values=[0.0, 0.1], title="edited")
    [row] = [row for row in overview(session).parameters if row.name == NAME]
    assert row.changed == 2
    assert row.change == pytest.approx(
        relative_change(session.parameters[NAME], session.require_view().start.parameters[NAME].values)
    )
    assert not row.unused
    assert row.deviation is None
    assert not row.undetermined


def test_a_table_is_as_weak_as_half_of_its_fitted_values() -> None:
    curve = kf.Curve("C", [0.0, 1.0, 2.0, 3.0], [0.0, 10.0, 20.0, 10.0])
    assert relative_deviation(curve, np.array([0.0, 1.0, 2.0, 4.0])) == pytest.approx(0.1)
    assert relative_deviation(curve, np.array([0.0, np.inf, np.inf, 4.0])) == np.inf
    assert relative_deviation(curve, np.zeros(4)) is None
    assert relative_deviation(curve, None) is None
    constant = kf.Curve("C", [0.0, 1.0], [0.0, 0.0])
    assert relative_deviation(constant, np.array([1.0, 1.0])) == 1.0
    assert relative_change(constant, np.zeros(2)) == 0.0

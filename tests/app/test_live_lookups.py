"""Lookups of a live model at changing values: compiled once, and as if they were compiled anew."""

from pathlib import Path

import numpy as np
import pytest

from kennfeld.app.session.evidence import Evidence
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetTables
from kennfeld.optimize.quality import lookup_coverage
from kennfeld.optimize.quality.quality import NodeSimulator


def test_an_edit_moves_lookups_without_compiling_them_again(torque: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session(torque)
    compiled = []
    monkeypatch.setattr(
        lookup_coverage, "NodeSimulator", lambda *given: compiled.append(given) or NodeSimulator(*given)
    )
    before = dict(session.require_view().samples)
    for shift in (5.0, 10.0):
        table = session.parameters["MapOptIgnition"]
        session.do(SetTables("edited", {"MapOptIgnition": table.values + shift}))
        view = session.require_view()
        fresh = Evidence(view.model, view.now.parameters)
        fresh._lookups = lookup_coverage.Lookups(view.model.problem, view.now.parameters)
        expected = fresh.sample_counts()
        compiled.pop()  # of the expected ones
        assert all(np.array_equal(view.samples[name], expected[name]) for name in expected)
    assert not np.array_equal(view.samples["CurveEtaDeltaSpark"], before["CurveEtaDeltaSpark"])
    assert compiled == []


def test_an_edit_that_moves_no_lookup_keeps_them(torque: Path) -> None:
    session = Session(torque)
    view = session.require_view()
    evidence, samples = view.evidence, view.samples
    session.do(SetTables("edited", {"MapOptTorque": session.parameters["MapOptTorque"].values * 1.1}))
    assert view.evidence is evidence
    assert view.samples is samples
    session.do(SetTables("edited", {"MapOptIgnition": session.parameters["MapOptIgnition"].values + 5}))
    assert view.evidence is not evidence
    assert view.samples is not samples


def test_settings_are_parsed_once_a_text(torque: Path) -> None:
    session = Session(torque)
    assert session.settings is session.settings
    session.do(SetTables("edited", {"MapOptIgnition": session.parameters["MapOptIgnition"].values + 1}))
    first = session.settings
    session.history.undo()
    assert session.settings is first

"""The limits of a project with two sets of values."""

from pathlib import Path
from typing import Any

import pytest

from kennfeld.app.session.session import Session
from tests.app.questions import ask

PROJECT = """
[model]
file = "f.kf"

[[dataset]]
files = ["d.csv"]

[parameters.C]
x = { input = "x", breakpoints = [0, 1, 2] }
initial = [0, 1, 2]
bounds = [0, 4]
gradient = { x = [0, inf] }
pin = [{ at = [2], value = 2 }]

[[criterion]]
node = "y"
target = "m"

[[limit]]
node = "y"
max = 3
"""


@pytest.fixture
def session(tmp_path: Path) -> Session:
    (tmp_path / "f.kf").write_text("y[Nm] = C(x)\n", encoding="utf-8")
    (tmp_path / "d.csv").write_text("x,m\n0,0\n0.5,1\n1,1\n2,2\n", encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(PROJECT, encoding="utf-8")
    session = Session(tmp_path / "kennfeld.toml")
    assert not session.stale, session.findings
    return session


def limits(session: Session) -> dict[str, dict[str, Any]]:
    rows = ask(session, "limits", first={"from": "start"}, second={"from": "now"}).head["rows"]
    return {f"{row['name']} {row['text']}": row for row in rows}


def test_limits_that_hold_say_how_many_values_are_at_them(session: Session) -> None:
    rows = limits(session)
    assert list(rows) == ["C 0 … 4", "C at 2 pinned to 2", "C slope along x ≥ 0", "y ≤ 3"]
    assert all(row["first"] == row["second"] and row["first"]["excess"] == 0 for row in rows.values())
    assert rows["C 0 … 4"]["first"]["active"] == 1


def test_the_worst_violation_is_named_with_its_size_and_place(session: Session) -> None:
    ask(session, "set-values", name="C", cells=[0, 1, 2], values=[0.0, 5.0, 2.5], title="edited")
    rows = limits(session)
    second = {name: row["second"] for name, row in rows.items()}
    assert second["C 0 … 4"] == {"excess": 1.0, "active": 1, "worst": "at 1"}
    assert second["C at 2 pinned to 2"]["excess"] == pytest.approx(0.5)
    assert second["C slope along x ≥ 0"]["excess"] == pytest.approx(2.5)
    assert second["C slope along x ≥ 0"]["worst"]
    assert second["y ≤ 3"]["excess"] == pytest.approx(2.0)
    assert second["y ≤ 3"]["worst"] == "1 of 4 samples"
    assert all(row["first"]["excess"] == 0 for row in rows.values())

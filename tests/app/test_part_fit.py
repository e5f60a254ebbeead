"""Fits of some values of a table, with all others held."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.app.session.part_fit import FittedPart, part_problem
from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError
from tests.app.questions import ask

pytestmark = pytest.mark.usefixtures("forked_workers")

FORMULA = "y = M(x, z) + offset\n"
SETTINGS = """
[model]
file = "sum.kf"

[[dataset]]
files = ["data.csv"]

[calibration]
initial = "start.json"

[parameters.M]
lock = [{ x = [0, 0] }]
pin = [{ at = [2, 1], value = 5 }]

[[criterion]]
node = "y"
target = "m"
"""


@pytest.fixture
def session(tmp_path: Path) -> Session:
    """Return a project whose measurement is 10 x + z, with an offset of 100 that would explain all of it."""
    rng = np.random.default_rng(3)
    x, z = rng.uniform(0, 2, 300), rng.uniform(0, 1, 300)
    rows = "\n".join(f"{a},{b},{10 * a + b}" for a, b in zip(x, z, strict=True))
    (tmp_path / "data.csv").write_text(f"x,z,m\n{rows}\n", encoding="utf-8")
    (tmp_path / "sum.kf").write_text(FORMULA, encoding="utf-8")
    start = kf.ParameterSet([kf.Map("M", [0.0, 1.0, 2.0], [0.0, 1.0], np.zeros((3, 2))), kf.Scalar("offset", 0.0)])
    start.save(tmp_path / "start.json")
    (tmp_path / "kennfeld.toml").write_text(SETTINGS, encoding="utf-8")
    return Session(tmp_path / "kennfeld.toml")


def finish(session: Session) -> Session:
    deadline = time.monotonic() + 120
    while session.is_busy:
        assert time.monotonic() < deadline
        time.sleep(0.01)
        session.pump()
    return session


def test_a_fit_of_a_point_holds_all_other_values(session: Session) -> None:
    before = session.parameters
    ask(session, "run", only={"name": "M", "cells": [2], "title": "M at 1, 0"})
    finish(session)
    assert session.job.state == "converged", session.job.message
    after = session.parameters
    changed = np.flatnonzero(after["M"].values != before["M"].values)
    assert changed.tolist() == [2]
    assert after["offset"].value == before["offset"].value
    assert session.history.undoable == "Run 1: M at 1, 0"
    assert "Only M at 1, 0 was fitted" in session.job.message
    assert session.undo() == "Run 1: M at 1, 0"
    assert np.array_equal(session.parameters["M"].values, before["M"].values)


def test_the_value_of_a_point_is_the_best_one_with_the_others_held(session: Session) -> None:
    ask(session, "run", only={"name": "M", "cells": [2], "title": "M at 1, 0"})
    best = finish(session).parameters["M"].values.copy()
    scores = []
    for step in (-0.01, 0.0, 0.01):
        moved = best.copy()
        moved.ravel()[2] += step
        ask(session, "set-values", name="M", cells=[2], values=[float(moved.ravel()[2])], title="moved")
        scores.append(session.require_view().now.scores[0].rmse)
    assert scores[1] < min(scores[0], scores[2])


def test_a_fit_of_a_part_is_an_entry_of_the_history_that_says_so(session: Session) -> None:
    ask(session, "run", only={"name": "M", "cells": [2, 3], "title": "M, 2 points"})
    finish(session)
    row = ask(session, "sets").head["rows"][1]
    assert row["title"] == "run 1"
    assert row["detail"].startswith("M, 2 points only · converged")


def test_what_is_known_of_the_other_values_stays_after_a_fit_of_a_part(session: Session) -> None:
    session.run()
    finish(session)
    known = ask(session, "table", name="M").head["table"]["deviation"]
    directions = ask(session, "trust").head
    ask(session, "run", only={"name": "M", "cells": [2], "title": "M at 1, 0"})
    finish(session)
    assert len(session.runs) == 2
    assert ask(session, "table", name="M").head["table"]["deviation"] == known
    assert ask(session, "trust").head == directions


def test_only_a_fit_of_all_values_is_written_as_converged(session: Session, tmp_path: Path) -> None:
    ask(session, "run", only={"name": "M", "cells": [2], "title": "M at 1, 0"})
    finish(session)
    ask(session, "export", formats=[], whole=True)
    result = json.loads((tmp_path / "results" / "result.json").read_text(encoding="utf-8"))
    assert result["status"] == "stopped"
    assert "Only M at 1, 0 was fitted in run 1" in result["message"]


def test_locks_and_pins_hold_in_a_fit_of_a_part(session: Session) -> None:
    ask(session, "run", only={"name": "M", "cells": list(range(6)), "title": "M"})
    values = finish(session).parameters["M"].values
    assert values[0].tolist() == [0.0, 0.0]
    assert values[2, 1] == pytest.approx(5.0, abs=1e-9)


def test_a_fit_of_nothing_is_refused_with_the_reason(session: Session) -> None:
    with pytest.raises(ArgumentError, match="M at 0, 0 is locked: unlock it"):
        ask(session, "run", only={"name": "M", "cells": [0], "title": "M at 0, 0"})
    with pytest.raises(ArgumentError, match="M has 6 values, none with the number 17"):
        ask(session, "run", only={"name": "M", "cells": [17], "title": "M"})
    ask(session, "set-keys", changes=[[["parameters", "offset", "free"], False]], title="fixed")
    with pytest.raises(ArgumentError, match="offset is fixed"):
        ask(session, "run", only={"name": "offset", "cells": [0], "title": "offset"})
    assert not session.is_busy


def test_breakpoints_are_held_with_the_other_values(session: Session) -> None:
    changes = [
        [["parameters", "M", "x"], {"breakpoints": [0, 1, 2], "free": True}],
        [["parameters", "M", "lock"], None],
    ]
    ask(session, "set-keys", changes=changes, title="free axis")
    problem = session.require_view().model.problem
    assert problem.free_axes
    assert not part_problem(problem, FittedPart("M", [2], "M at 1, 0")).free_axes

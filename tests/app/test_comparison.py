"""Two sets of values: what is taken of one into the other, what that does to the errors, and what belongs together."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetValues
from kennfeld.base.errors import ArgumentError
from tests.app.questions import ask

PROJECT = """\
model.file = "f.kf"
calibration.initial = "now.json"
[[dataset]]
files = "d.csv"
[[criterion]]
node = "m"
target = "y"
"""


def tables(gain: float, offset: float) -> kf.ParameterSet:
    """Return two curves whose product is the same for all gains, and a scalar that is added to it."""
    a, b = np.array([3.0, 5.0, 4.0]), np.array([1.0, 2.0, 3.0])
    curves = [kf.Curve("A", [0.0, 1, 2], a * gain), kf.Curve("B", [0.0, 1, 2], b / gain)]
    return kf.ParameterSet([*curves, kf.Scalar("K", offset)])


@pytest.fixture
def session(tmp_path: Path) -> Session:
    """Return a session whose present values fit as well as those of `other.json`, with a gain of 2."""
    rng = np.random.default_rng(3)
    x, z = rng.uniform(0, 2, (2, 200))
    y = np.interp(x, [0, 1, 2], [3, 5, 4]) * np.interp(z, [0, 1, 2], [1, 2, 3]) + 0.05 * rng.standard_normal(200)
    rows = "".join(f"{a},{b},{c}\n" for a, b, c in zip(x, z, y, strict=True))
    (tmp_path / "d.csv").write_text(f"x,z,y\n{rows}", encoding="utf-8")
    (tmp_path / "f.kf").write_text("input x\ninput z\nm = A(x) * B(z) + K\n", encoding="utf-8")
    tables(1.0, 0.0).save(tmp_path / "now.json")
    tables(2.0, 0.01).save(tmp_path / "other.json")
    (tmp_path / "kennfeld.toml").write_text(PROJECT, encoding="utf-8")
    return Session(tmp_path / "kennfeld.toml")


OTHER = {"from": "file", "file": "other.json"}


def test_what_is_not_taken_stays_as_it_is_now(session: Session) -> None:
    session.do(SetValues("edited", "A", np.array([3.1, 5.1, 4.1])))
    session.do(SetValues("edited", "B", np.array([1.1, 2.1, 3.1])))
    ask(session, "accept", source=OTHER, cells={"A": [1]}, title="Took one")
    assert session.parameters["A"].values.tolist() == [3.1, 10.0, 4.1]
    assert session.parameters["B"].values.tolist() == [1.1, 2.1, 3.1]
    assert session.undo() == "Took one"
    assert session.parameters["A"].values.tolist() == [3.1, 5.1, 4.1]


@pytest.mark.parametrize("cells", [{"A": [0, 2]}, {"A": None}, {"A": None, "B": None}, {"A": None, "B": [], "K": None}])
def test_the_errors_of_a_choice_are_those_after_it_is_taken(session: Session, cells: dict[str, Any]) -> None:
    session.do(SetValues("edited", "K", np.array(0.02)))
    [row] = ask(session, "choice", source=OTHER, cells=cells).head["scores"]
    [before] = session.require_view().now.scores
    ask(session, "accept", source=OTHER, cells=cells, title="Took")
    [after] = session.require_view().now.scores
    assert (row["now"], row["then"]) == (before.rmse, after.rmse)


def test_tables_that_moved_together_are_named_with_the_errors_of_both_choices(session: Session) -> None:
    head = ask(session, "choice", source=OTHER, cells={"A": [0, 1]}).head
    assert head["count"] == 2
    assert head["scores"][0]["then"] > 20 * head["scores"][0]["now"]
    together = head["together"]
    assert (together["names"], together["count"]) == (["A", "B"], 6)
    assert together["alone"] > 20 * together["together"]
    ask(session, "accept", source=OTHER, cells=dict.fromkeys(together["names"]), title="Took both")
    [score] = session.require_view().now.scores
    assert score.rmse == together["together"]


def test_a_choice_that_fits_alone_names_no_other_table(session: Session) -> None:
    head = ask(session, "choice", source=OTHER, cells={"K": None}).head
    assert (head["count"], head["together"]) == (1, None)


def test_nothing_is_taken_from_a_set_that_has_the_present_values(session: Session) -> None:
    head = ask(session, "choice", source={"from": "start"}, cells={"A": None}).head
    assert (head["count"], head["together"]) == (0, None)
    with pytest.raises(ArgumentError, match="are those of now"):
        ask(session, "accept", source={"from": "start"}, cells={"A": None}, title="Took")
    for cells, message in (({"A": [7]}, "has no value 7"), ({"Other": None}, "Other is not a parameter")):
        with pytest.raises(ArgumentError, match=message):
            ask(session, "choice", source=OTHER, cells=cells)


def test_a_file_is_compared_on_the_breakpoints_of_the_project(session: Session) -> None:
    finer = kf.ParameterSet([kf.Curve("A", [0.0, 0.5, 1, 2], [6.0, 8, 10, 8])])
    finer.save(session.path.parent / "finer.json")
    head = ask(session, "compare", first={"from": "now"}, second={"from": "file", "file": "finer.json"}).head
    rows = {row["name"]: row for row in head["changes"]}
    assert rows["A"]["second"] == [6.0, 10.0, 8.0]
    assert rows["K"]["largest"] == 0.0

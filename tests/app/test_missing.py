"""Missing terms in the app: looked for in another process, applied as one command, and old once the project changes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kennfeld.app.questions import QUESTIONS
from kennfeld.app.questions.missing import ChangedLine, _changed_lines
from kennfeld.app.questions.overview import overview
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetText
from kennfeld.base.errors import ArgumentError, InputError
from tests.app.questions import WaitingSession
from tests.project.test_missing_terms import plant_map, write_bench

pytestmark = pytest.mark.usefixtures("forked_workers")


class Looking(WaitingSession):
    """A session whose search can be waited for."""

    def look(self, **arguments: Any) -> dict[str, Any]:
        """Search, and return what was found."""
        self.ask("look", **arguments)
        self.wait(self.session.term_search)
        outcome = self.ask("missing")["found"]
        assert outcome is not None, self.session.term_search.reason
        return dict(outcome)


@pytest.fixture
def bench(tmp_path: Path) -> Looking:
    """Return a session of a bench whose drag depends on the oil, which the function does not know."""
    return Looking(write_bench(tmp_path, samples=80))


def rmse(session: Session) -> float:
    return session.require_view().now.scores[0].rmse


def test_a_term_is_found_and_applied_with_its_fit_as_one_command(bench: Looking) -> None:
    session, before = bench.session, bench.session.state.texts
    function = (session.path.parent / "f.kf").read_text("utf-8")
    offered = bench.ask("missing")
    assert offered["found"] is None
    reasons = {row["name"]: row["reason"] for row in offered["channels"]}
    assert reasons == {"speed": "", "load": "", "oil": "", "humidity": "", "m": "the target", "flat": "constant"}
    assert {row["name"]: row["places"] for row in offered["kinds"]} == {
        "add": 3,
        "multiply": 3,
        "map": 3,
        "lag": 0,
        "delay": 0,
        "offset": 3,
    }
    outcome = bench.look(kinds=["add"], channels=["oil", "humidity"])
    assert (outcome["old"], outcome["status"], overview(session).terms.detail) == (False, "found", "1 proposal")
    [row] = outcome["proposals"]
    assert (row["channel"], row["better"], len(row["heldOutParts"])) == ("oil", 3, 3)
    assert any("fitted further first" in text for text in outcome["remarks"])
    shown = QUESTIONS["term"](session, {"number": 0})
    assert shown.head["files"][0]["file"] == "f.kf"
    assert sum(shown.head["counts"]) == 240
    # the term takes away what the errors share over the channel
    means = np.abs(shown.arrays["before"]).max(), np.abs(shown.arrays["after"]).max()
    assert means[1] < 0.3 * means[0]
    title = bench.ask("apply-term", number=0)["title"]
    assert not session.stale, session.findings
    assert rmse(session) == pytest.approx(row["training"]["after"], rel=1e-9)
    assert bench.ask("missing")["found"]["old"]
    with pytest.raises(InputError, match="older than the values"):
        bench.ask("apply-term", number=0)
    assert session.undo() == title
    assert session.unsaved_texts == {}
    assert session.state.texts == before | {"f.kf": function}
    assert not bench.ask("missing")["found"]["old"]


def test_an_equal_place_gets_the_term_without_effect(bench: Looking) -> None:
    session, start = bench.session, rmse(bench.session)
    [row] = bench.look(kinds=["add"], channels=["oil"])["proposals"]
    number = next(place["number"] for place in row["places"] if place["node"] == "drag")
    shown = bench.ask("term", number=0, place=number)
    assert (shown["fitted"], shown["parameter"], set(shown["now"])) == (False, "AddDragOil", {0.0})
    bench.ask("apply-term", number=0, place=number)
    assert "2 drag[Nm] = CurveDrag(speed) + AddDragOil(oil)  # motored" in session.text_of("f.kf")
    assert rmse(session) == start
    with pytest.raises(InputError, match="there is no proposal 3 any more"):
        bench.ask("term", number=2)


def test_a_function_that_lacks_nothing_gets_the_smallest_effect_that_would_have_been_seen(tmp_path: Path) -> None:
    bench = Looking(write_bench(tmp_path, planted="", samples=80))
    outcome = bench.look(kinds=["add"], channels=["oil"], nodes=["drag"])
    assert (outcome["status"], outcome["proposals"]) == ("none", [])
    assert "would have been seen" in outcome["message"]
    assert overview(bench.session).terms.detail == "nothing is missing"


def test_a_search_needs_a_project_without_errors_and_a_scope(bench: Looking) -> None:
    with pytest.raises(ArgumentError, match="least must be >= 0"):
        bench.ask("look", least=-1.0)
    bench.session.do(SetText("wrong", "f.kf", "y = nothing("))
    with pytest.raises(InputError):
        bench.ask("look")
    assert bench.session.term_search.state == "idle"


@pytest.mark.guests
def test_a_function_of_another_tool_is_not_written_into(tmp_path: Path) -> None:
    from tests.importers.ascet.esdl_projects import BATTERY, write_project

    write_project(tmp_path, BATTERY)
    u, t, z = np.tile([1.3, 1.34, 1.38], 80), np.linspace(-5, 65, 240), np.random.default_rng(2).uniform(0, 1, 240)
    rows = np.column_stack([t, u, z, 100 * (u + 0.16 - 1.4) + z**2])
    np.savetxt(tmp_path / "bench.csv", rows, "%.6f", ",", header="T,U,z,wanted", comments="")
    path = tmp_path / "kennfeld.toml"
    path.write_text(
        'model.file = "Battery/Cell/Accu.esdl"\ncalibration.free = ["shift"]\n[[dataset]]\nfiles = "bench.csv"\n'
        '[[criterion]]\nnode = "charge"\ntarget = "wanted"\n',
        encoding="utf-8",
    )
    bench = Looking(path)
    assert not bench.session.stale, bench.session.findings
    [row] = bench.look(kinds=["add"], channels=["z"])["proposals"]
    assert (row["channel"], row["node"]) == ("z", "charge")
    shown = bench.ask("term", number=0)
    assert shown["reason"] == "Battery/Cell/Accu.esdl is not formula text, into which terms are written"
    assert shown["text"].startswith("charge = charge + AddChargeZ(z)")
    assert [each["file"] for each in shown["files"]] == ["kennfeld.toml"]
    before = bench.session.state
    with pytest.raises(InputError, match="not formula text"):
        bench.ask("apply-term", number=0)
    assert bench.session.state == before


def test_changed_lines_have_one_line_around_them() -> None:
    before = "\ufeffa\nb\nc\nd\ne\nf\ng\n"
    rows = _changed_lines(before, "a\nB\nc\nd\ne\nf\ng\nh\n")
    assert [(row.sign, row.line, row.text) for row in rows] == [
        (" ", 1, "a"),
        ("-", 2, "b"),
        ("+", 2, "B"),
        (" ", 3, "c"),
        (" ", 0, "…"),
        (" ", 7, "g"),
        ("+", 8, "h"),
    ]
    assert _changed_lines("a\n", "a\n") == []
    assert isinstance(rows[0], ChangedLine)


def test_offsets_of_recordings_are_found_and_drawn_by_their_numbers(tmp_path: Path) -> None:
    (tmp_path / "f.kf").write_text("input x\nscalar Gain\ny = Gain * x\n", encoding="utf-8")
    names = []
    for number, offset in enumerate((0.0, 0.8, -0.6, 0.3), 1):
        x = np.linspace(0, 10, 40)
        rows = np.column_stack([x, 2 * x + offset + 0.01 * np.sin(97 * x * number)])
        names.append(f"{number}.csv")
        np.savetxt(tmp_path / names[-1], rows, "%.6f", ",", header="x,m", comments="")
    text = f"""[model]
file = "f.kf"
[[dataset]]
files = {names}
[[criterion]]
node = "y"
target = {{ channel = "m" }}
[parameters.Gain]
initial = 2.0
"""
    (tmp_path / "kennfeld.toml").write_text(text.replace("'", '"'), encoding="utf-8")
    bench = Looking(tmp_path / "kennfeld.toml")
    [row] = bench.look(kinds=["offset"])["proposals"]
    assert (row["kind"], row["node"]) == ("offset", "y")
    shown = QUESTIONS["term"](bench.session, {"number": 0}).head
    assert (shown["input"], list(shown["points"])[:4]) == ("recording", [1, 2, 3, 4])
    assert any(line["text"] == 'per = "recording"' for line in shown["files"][1]["lines"])


@pytest.mark.slow
def test_a_map_is_shown_with_both_axes_and_applied(tmp_path: Path) -> None:
    path = write_bench(tmp_path, planted="", samples=80)
    plant_map(tmp_path)
    bench = Looking(path)
    [row] = bench.look(kinds=["map"], channels=["speed", "oil"], nodes=["drag"])["proposals"]
    assert (row["kind"], row["channel"], row["second"], row["ends"]) == ("add", "speed", "oil", [])
    shown = bench.ask("term", number=0)
    assert (shown["input"], shown["second"]) == ("speed", "oil")
    assert len(shown["now"]) == len(shown["points"]) * len(shown["secondPoints"]) == len(shown["deviation"])
    bench.ask("apply-term", number=0)
    assert not bench.session.stale, bench.session.findings
    assert rmse(bench.session) == pytest.approx(row["training"]["after"], rel=1e-9)

"""Proposals for what a project lacks."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.session.proposal import Range, even_breakpoints, propose, read_function
from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError
from kennfeld.models.code_consent import allow
from kennfeld.optimize.quality.lookup_coverage import Coverage
from tests.app.function_samples import write_functions
from tests.draws import mostly_slow
from tests.project.flash_files import A2L, hex_of

CHANNELS = {
    "n": Range(812.0, 3978.0),
    "Load": Range(9.5, 99.0),
    "Torque": Range(-20.0, 210.0),
    "time": Range(0.0, 60.0),
}


def proposals(text: str, settings: dict | None = None, known: tuple[str, ...] = ()) -> dict[str, dict]:
    function = read_function(text)
    assert function is not None
    return {each.title: dict(each.changes) for each in propose(function, settings or {}, known, CHANNELS)}


def test_tables_get_round_axes_that_cover_the_data() -> None:
    changes = proposals("torque = MapTorque(Speed, Load)", {"channels": {"Speed": "n"}})
    table = changes["map MapTorque over Speed, Load"][("parameters", "MapTorque")]
    assert table["x"]["breakpoints"][0] <= 812.0
    assert table["x"]["breakpoints"][-1] >= 3978.0
    assert all(point % 100 == 0 for point in table["x"]["breakpoints"])
    assert table["y"]["input"] == "Load"
    assert table["smoothness"] > 0


def test_existing_parameters_are_not_proposed() -> None:
    assert proposals("y = Gain * n", {"parameters": {"Gain": {}}, "criterion": [{}]}) == {}
    assert proposals("y = C(n)", {"criterion": [{}]}, ("C",)) == {}


def test_names_without_a_channel_are_scalars() -> None:
    assert proposals("y = offset + n", {"criterion": [{}]}) == {
        "scalar offset": {("parameters", "offset"): {"initial": 1.0}}
    }


def test_the_only_channel_left_is_the_target() -> None:
    changes = proposals("torque = C(n) + 0 * Load", {}, ("C",))
    assert changes == {"torque follows Torque": {("criterion", 1): {"node": "torque", "target": {"channel": "Torque"}}}}


def test_a_text_with_errors_has_no_proposals() -> None:
    assert read_function("a = b +") is None


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.2, 7.9), (1e-6, 9e-6), (800.0, 6100.0), (0.0, 1e9)])
@pytest.mark.parametrize("count", [2, 5, 10, 20])
def test_breakpoints_are_even_and_cover_the_range(low: float, high: float, count: int) -> None:
    points = even_breakpoints(Range(low, high), count)
    assert points[0] <= low
    assert points[-1] >= high
    steps = {round(b - a, 12) for a, b in pairwise(points)}
    assert max(steps) == pytest.approx(min(steps))
    assert len(points) <= 2 * count + 2


def test_a_constant_channel_still_gives_an_axis() -> None:
    assert kf.Axis(even_breakpoints(Range(5.0, 5.0), 8)).breakpoints.size == 2


def test_among_several_channels_the_user_chooses_the_target() -> None:
    function = read_function("torque = C(n)")
    assert function is not None
    (proposal,) = propose(function, {}, ("C",), CHANNELS)
    assert proposal.title == "torque follows the channel"
    assert proposal.choice is not None
    assert proposal.choice.path == ("criterion", 1, "target", "channel")
    assert list(proposal.choice.options) == ["Load", "Torque"]


def ask(session: Session, question: str, **arguments: Any) -> dict[str, Any]:
    return dict((QUESTIONS.get(question) or COMMANDS[question])(session, arguments).head)


def begin(folder: Path, formula: str, recording: str, more: str = "") -> Session:
    """Return a session with formula text and a recording, and nothing else."""
    folder.mkdir(exist_ok=True)
    (folder / "f.kf").write_text(formula, encoding="utf-8")
    (folder / "d.csv").write_text(recording, encoding="utf-8")
    (folder / "kennfeld.toml").write_text(f'[model]\nfile = "f.kf"\n[[dataset]]\nfiles = "d.csv"\n{more}')
    return Session(folder / "kennfeld.toml")


def add_all(session: Session, **choices: str) -> dict[str, Any]:
    rows = ask(session, "proposals")["proposals"]
    chosen = {row["title"]: next(iter(choices.values())) for row in rows if row["choice"] is not None}
    return ask(session, "add-proposals", titles=[row["title"] for row in rows], choices=chosen)


def test_the_torque_model_can_be_evaluated_once_all_proposals_are_added(torque: Path, tmp_path: Path) -> None:
    text, bench = (torque.with_name(name).read_text(encoding="utf-8") for name in ("torque.kf", "bench.csv"))
    session = begin(tmp_path / "new", text, bench)
    titles = [row["title"] for row in ask(session, "proposals")["proposals"]]
    assert "curve CurveEtaDeltaSpark over deltaSpark" in titles
    reply = add_all(session, channel="Torque")
    assert reply["problems"] == []
    target = session.require_view().model.recordings[0].targets[0]
    assert reply["rmse"] < 1.1 * np.nanstd(target)  # 5000 and more with a start of 1
    assert session.require_view().now.scores[0].rmse == reply["rmse"]
    curve = session.parameters["CurveEtaDeltaSpark"]
    [looked_up] = [
        block.coordinates[0]
        for block in Coverage(session.require_view().model.problem.graph, session.parameters, [curve.name]).blocks(
            session.require_view().model.recordings[0].bound
        )
    ]
    points = curve.axes[0].breakpoints
    assert points[0] < looked_up.min() < looked_up.max() < points[-1]
    assert session.undo().startswith("Added")


@pytest.mark.parametrize("unit", mostly_slow([1e4, 1.0, 1e-3], 1))
def test_starts_and_smoothness_follow_the_size_of_the_target(tmp_path: Path, unit: float) -> None:
    rows = "".join(f"{x / 100},{unit * (5 + np.sin(x / 20))}\n" for x in range(200))
    session = begin(tmp_path / "p", "y = C(x) * k\n", f"x,target\n{rows}", "[parameters.k]\ninitial = 2\n")
    reply = add_all(session)
    assert reply["rmse"] == pytest.approx(unit * np.std([5 + np.sin(x / 20) for x in range(200)]), rel=0.01)
    entry = session.settings["parameters"]["C"]
    assert entry["initial"] == pytest.approx(2.6 * unit, rel=0.05)
    [score] = session.require_view().now.scores
    project = session.project
    assert project is not None
    fitted = project.calibrate()
    assert fitted.quality[0].rmse_after < 0.1 * score.rmse  # smooth, but not against the data


def test_a_declared_input_without_a_channel_asks_for_it_and_does_not_become_a_scalar(tmp_path: Path) -> None:
    session = begin(tmp_path / "p", "input n[rpm]\ny = C(n)\n", "speed,y\n1,2\n2,3\n3,5\n")
    rows = {row["title"]: row for row in ask(session, "proposals")["proposals"]}
    assert "scalar n" not in rows
    assert rows["n reads the channel"]["choice"]["options"] == ["speed", "y"]
    with pytest.raises(ArgumentError, match="n reads the channel: choose one of speed, y"):
        ask(session, "add-proposals", titles=["n reads the channel"], choices={})
    ask(session, "add-proposals", titles=["n reads the channel"], choices={"n reads the channel": "speed"})
    assert session.settings["channels"] == {"n": "speed"}


def test_labels_of_an_image_are_known_and_not_proposed(tmp_path: Path) -> None:
    (tmp_path / "ecu.a2l").write_text(A2L)
    (tmp_path / "ecu.hex").write_text(hex_of(100, 100, 100, 0))
    rows = "".join(f"{speed},{speed / 1000}\n" for speed in range(1000, 3001, 100))
    for initial in ('{ a2l = "ecu.a2l", hex = "ecu.hex" }', '["ecu.hex"]', '[{ hex = "ecu.hex" }]'):
        more = f"[calibration]\ninitial = {initial}\n"
        session = begin(tmp_path, "m = Gain(Speed) + offset + Other(Speed)\n", f"Speed,y\n{rows}", more)
        assert set(session.initial_names) == {"Gain", "offset"}
        titles = [row["title"] for row in ask(session, "proposals")["proposals"]]
        assert titles == ["curve Other over Speed", "m follows y"]


def test_an_initial_file_that_cannot_be_read_is_named_beside_the_proposals(tmp_path: Path) -> None:
    (tmp_path / "a.dcm").write_text("KONSERVIERUNG_FORMAT 2.0\nKENNLINIE C\n")
    session = begin(tmp_path, "y = C(x)\n", "x,y\n1,2\n2,3\n", '[calibration]\ninitial = ["a.dcm", "gone.dcm"]\n')
    problems = ask(session, "proposals")["problems"]
    assert len(problems) == 3
    assert all(name in text for name, text in zip(("a.dcm", "a.dcm", "gone.dcm"), problems, strict=True))


@pytest.mark.guests
def test_a_function_of_another_tool_gets_a_criterion_proposed(tmp_path: Path) -> None:
    path = write_functions(tmp_path / "c", file="gain.py:gain")
    text = path.read_text(encoding="utf-8")
    begin_criterion, end = text.index("[[criterion]]"), text.index("[parameters.K]")
    path.write_text(text[:begin_criterion] + text[end:], encoding="utf-8")
    session = Session(path)
    for request in session.undecided:
        allow(request.digest)
    session.refresh()
    [row] = [row for row in ask(session, "proposals")["proposals"] if "follows" in row["title"]]
    assert row["choice"] is None or "wanted" in row["choice"]["options"]


def test_formula_text_is_checked_and_drawn_without_data(tmp_path: Path) -> None:
    (tmp_path / "kennfeld.toml").write_text('[model]\nfile = "f.kf"\n')
    (tmp_path / "f.kf").write_text("a[Nm] = MapX(n, load) + \nb = sqrt(a, 2)\n")
    wrong = [finding for finding in Session(tmp_path / "kennfeld.toml").findings if finding.location.file == "f.kf"]
    assert [(finding.location.line, finding.location.column > 0) for finding in wrong] == [(1, True), (2, True)]
    (tmp_path / "f.kf").write_text("a[Nm] = MapX(n, load)\nb = sqrt(a)\n")
    session = Session(tmp_path / "kennfeld.toml")
    assert not [finding for finding in session.findings if finding.location.file == "f.kf"]
    flow = ask(session, "flow")
    assert [(node["name"], node["kind"], node["tables"]) for node in flow["nodes"]] == [
        ("a", "map", ["MapX"]),
        ("b", "sqrt", []),
    ]


def test_a_function_with_declared_inputs_is_drawn_without_data_by_the_parameters_of_the_project(tmp_path: Path) -> None:
    (tmp_path / "f.kf").write_text("input a\nz = G * a\n")
    (tmp_path / "kennfeld.toml").write_text(
        '[model]\nfile = "f.kf"\n[[dataset]]\nfiles = ["gone.csv"]\n[parameters.G]\ninitial = 1.0\n'
        '[[criterion]]\nnode = "z"\ntarget = "y"\n'
    )
    session = Session(tmp_path / "kennfeld.toml")
    assert session.view is None
    assert [node["name"] for node in QUESTIONS["flow"](session, {}).head["nodes"]] == ["z"]

"""Settings changed in the app: what is written to the project file, kept on disk, and exported."""

from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.session.saved_values import VALUES
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys, SetText, SetValues
from kennfeld.base.errors import InputError
from tests.draws import mostly_slow


def set_key(session: Session, *path: str | int, value: object) -> None:
    session.do(SetKeys("set", session.path.name, [(path, value)]))


def test_a_key_that_is_set_and_undone_leaves_the_file_byte_for_byte(torque: Path) -> None:
    before = torque.read_bytes()
    session = Session(torque)
    set_key(session, "parameters", "MapOptTorque", "bounds", value=[0.0, 500.0])
    session.save()
    assert torque.read_bytes() != before
    session.undo()
    session.save()
    assert torque.read_bytes() == before


def test_comments_and_order_of_the_rest_stay(torque: Path) -> None:
    before = torque.read_text(encoding="utf-8").splitlines()
    session = Session(torque)
    set_key(session, "dataset", 3, "weight", value=0.5)
    session.save()
    after = torque.read_text(encoding="utf-8").splitlines()
    assert [line for line in after if line not in before] == ["weight = 0.5"]
    assert [line for line in before if line not in after] == []


def test_bounds_of_a_key_reach_the_problem(torque: Path) -> None:
    session = Session(torque)
    COMMANDS["set-keys"](
        session, {"title": "x", "changes": [[["parameters", "MapOptTorque", "bounds"], ["-inf", 400]]]}
    )
    table = session.parameters["MapOptTorque"]
    assert np.all(table.upper == 400.0)
    assert np.all(np.isneginf(table.lower))


def test_an_error_keeps_the_last_valid_view_and_says_where_it_is(torque: Path) -> None:
    session = Session(torque)
    scores = session.require_view().now.scores
    set_key(session, "optimizer", "starts", value="many")
    assert session.stale
    assert session.require_view().now.scores == scores
    assert any("[optimizer] starts" in str(finding) for finding in session.findings)
    with pytest.raises(InputError, match="starts"):
        session.run()
    session.undo()
    assert not session.stale


def test_formula_text_is_followed_before_it_is_saved(torque: Path) -> None:
    session = Session(torque)
    text = session.text_of("torque.kf")
    session.do(SetText("edit", "torque.kf", text.replace("product - dragTorque", "product - dragTorque + 5")))
    assert "+ 5" not in (torque.parent / "torque.kf").read_text()
    assert session.require_view().start.scores[0].mean == pytest.approx(
        Session(torque).require_view().start.scores[0].mean + 5.0
    )


def test_saved_values_are_read_again(torque: Path) -> None:
    session = Session(torque)
    table = session.parameters["MapOptTorque"]
    session.do(SetValues("raise", "MapOptTorque", table.values + 3.0))
    session.save()
    assert (torque.parent / VALUES).is_file()
    again = kf.Project.read(torque).problem().parameters["MapOptTorque"]
    np.testing.assert_allclose(again.values, table.values + 3.0)
    assert Session(torque).parameters["MapOptTorque"].values == pytest.approx(table.values + 3.0)


def test_edits_of_a_session_that_died_are_offered(torque: Path) -> None:
    first = Session(torque)
    first.do(SetValues("raise", "MapOptTorque", first.parameters["MapOptTorque"].values + 3.0))
    second = Session(torque)
    assert second.recoverable
    second.recover()
    np.testing.assert_array_equal(second.state.values["MapOptTorque"], first.state.values["MapOptTorque"])
    second.save()
    assert not Session(torque).recoverable


@pytest.mark.parametrize(
    "content",
    mostly_slow(
        ["", "{", "[]", '{"texts": 1, "values": 2}', '{"texts": {}, "values": {"a": 1}}'],
        ["{", '{"texts": 1, "values": 2}'],
    ),
)
def test_a_damaged_recovery_file_is_ignored(torque: Path, content: str) -> None:
    session = Session(torque)
    session.recovery.path.parent.mkdir(exist_ok=True)
    session.recovery.path.write_text(content)
    session = Session(torque)
    session.recover()
    assert session.history.undoable == ""


def test_a_change_on_disk_is_noticed_and_can_be_undone(torque: Path) -> None:
    session = Session(torque)
    before = session.state.texts[torque.name]
    torque.write_text(before.replace("smoothness = 10 ", "smoothness = 20 ") + "\n# edited\n", encoding="utf-8")
    assert session.changed_on_disk
    session.reload()
    assert not session.changed_on_disk
    assert "# edited" in session.state.texts[torque.name]
    session.undo()
    assert session.state.texts[torque.name] == before


def test_edits_that_are_replaced_by_those_on_disk_are_not_offered_again(torque: Path) -> None:
    session = Session(torque)
    set_key(session, "parameters", "MapOptTorque", "smoothness", value=50)
    assert session.recovery.exists
    torque.write_text(torque.read_text(encoding="utf-8") + "\n# edited\n", encoding="utf-8")
    session.reload()
    assert not session.recovery.exists
    session.undo()
    assert session.recovery.exists


def test_recordings_are_read_once(torque: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session(torque)
    calls: list[int] = []
    monkeypatch.setattr("kennfeld.app.session.recorded_data.load_datasets", lambda *given: calls.append(1))
    set_key(session, "parameters", "MapOptTorque", "smoothness", value=50)
    assert calls == []


def test_exported_files_hold_the_present_values(torque: Path) -> None:
    session = Session(torque)
    session.do(SetValues("raise", "MapOptTorque", session.parameters["MapOptTorque"].values + 3.0))
    answer = QUESTIONS["export"](session, {"formats": [".dcm", ".json"], "report": True, "script": True})
    names = {Path(path).name for path in answer.head["files"]}
    assert names == {"parameters.dcm", "parameters.json", "report.html", "calibrate.py"}
    values = kf.read_parameters(torque.parent / "results" / "parameters.dcm")
    np.testing.assert_allclose(values["MapOptTorque"].values, session.parameters["MapOptTorque"].values, rtol=1e-6)
    compile((torque.parent / "calibrate.py").read_text(), "calibrate.py", "exec")


def test_the_data_screen_lists_the_channels_of_files(torque: Path) -> None:
    head = QUESTIONS["files"](Session(torque), {}).head
    bench = head["datasets"][0]["files"][0]
    assert (bench["name"], bench["samples"]) == ("bench.csv", 2812)
    assert {channel["name"] for channel in bench["channels"]} == {"Speed", "Rel_Airmass", "Ignition", "Torque"}
    roles = [(row["name"], row["role"], row["channel"]) for row in head["inputs"]]
    assert ("Speed", "input", "Speed") in roles
    assert ("TorquePredict", "target", "Torque") in roles

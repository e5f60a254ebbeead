"""The state of a session, its commands and its history."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from kennfeld.app.session.state import (
    Command,
    History,
    Restore,
    SessionState,
    SetTables,
    SetText,
    SetValues,
    inverse,
)
from tests.draws import few_or_many

names = st.sampled_from(["MapX", "CurveY", "Kp"])
tables = st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=2).map(np.array)
commands = st.one_of(
    st.builds(SetValues, st.just("values"), names, tables),
    st.builds(SetText, st.just("text"), st.sampled_from(["kennfeld.toml", "a.kf"]), st.text(max_size=5)),
    st.builds(SetTables, st.just("tables"), st.dictionaries(names, st.none() | tables)),
)


@few_or_many(commands, few=12, many=200)
def test_every_command_has_an_inverse(command: Command) -> None:
    before = SessionState({"kennfeld.toml": "a"}, {"Kp": np.array([1.0, 2.0])})
    after = command.apply(before)
    assert inverse(before, after).apply(after) == before


@given(st.lists(commands, max_size=12), st.data())
@settings(max_examples=25)
def test_undo_and_redo_walk_through_the_same_states(sequence: list[Command], data: st.DataObject) -> None:
    history = History(SessionState({"kennfeld.toml": "a"}))
    states = [history.state]
    for command in sequence:
        history.do(command)
        states.append(history.state)
    at = len(sequence)
    for back in data.draw(st.lists(st.booleans(), max_size=30)):
        title = history.undo() if back else history.redo()
        at += (-1 if back else 1) if title else 0
        assert history.state is states[at]
        assert bool(history.undoable) == (at > 0)
        assert bool(history.redoable) == (at < len(sequence))


def test_the_moves_of_a_drag_are_one_entry() -> None:
    history = History(SessionState())
    for value in (1.0, 2.0, 3.0):
        history.do(SetValues("Dragged Kp", "Kp", np.array(value)), "drag 1")
    history.do(SetValues("Dragged Kp", "Kp", np.array(9.0)), "drag 2")
    history.undo()
    assert history.state.values["Kp"] == 3.0
    history.undo()
    assert not history.state.values
    assert history.undo() == ""


def test_a_new_command_clears_the_undone_ones() -> None:
    history = History(SessionState())
    history.do(SetText("first", "a", "1"))
    history.undo()
    history.do(SetText("second", "a", "2"))
    assert (history.redo(), history.state.texts["a"]) == ("", "2")


def test_titles_are_those_of_commands_since_the_saved_state() -> None:
    history = History(SessionState())
    history.do(SetText("first", "a", "1"))
    saved = history.state
    history.do(SetText("second", "a", "2"))
    assert history.titles_since(saved) == ["second"]
    history.undo()
    assert history.titles_since(saved) == []


def test_restoring_without_a_table_takes_the_initial_values() -> None:
    state = SessionState({}, {"Kp": np.array(1.0), "Ki": np.array(2.0)})
    assert list(Restore("", values={"Kp": None}).apply(state).values) == ["Ki"]

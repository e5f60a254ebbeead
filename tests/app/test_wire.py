"""Types on the wire: what a page may ask, what it is answered, and the TypeScript of both."""

import importlib.util
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
import pytest

from kennfeld.app.answer import Answer
from kennfeld.app.project_questions import PROJECT_QUESTIONS
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.wire import ABSENT, Absent, KeyChange, Question, from_json, members, to_answer, to_json
from kennfeld.app.workspace import AppWorkspace
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass

ROOT = Path(__file__).parents[2]
ALL: Mapping[str, Question[Any]] = {**QUESTIONS, **COMMANDS, **PROJECT_QUESTIONS}


@dataclass(frozen=True)
class Part:
    name: str
    at_bound: int = 0


@dataclass(frozen=True)
class Asked:
    from_: Literal["now", "start"]
    cells: Sequence[int]
    pair: tuple[str, float]
    either: str | int = "all"
    parts: Mapping[str, Part | None] | None = None
    changes: Sequence[KeyChange] = ()
    force: bool = False


QUESTION = {"from": "now", "cells": [1, 2.0], "pair": ["x", 1]}


def test_json_of_a_page_becomes_a_typed_value() -> None:
    details = {**QUESTION, "either": 3, "parts": {"a": {"name": "A", "atBound": 2}, "b": None}, "force": True}
    asked = from_json(Asked, {**details, "changes": [[["dataset", 1, "use"], None], [["x"], {"y": [1]}]]}, "ask")
    changes = ((("dataset", 1, "use"), None), (("x",), {"y": [1]}))
    assert asked == Asked("now", (1, 2), ("x", 1.0), 3, {"a": Part("A", 2), "b": None}, changes, True)
    assert isinstance(asked.cells[1], int)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"from": "later"}, "ask.from must be 'now' or 'start', got 'later'"),
        ({"cells": 3}, "ask.cells must be a list, got 3"),
        ({"cells": [1, "two"]}, r"ask.cells\[1\] must be an integer, got 'two'"),
        ({"cells": [1.5]}, r"ask.cells\[0\] must be an integer, got 1.5"),
        ({"cells": [True]}, r"ask.cells\[0\] must be an integer, got True"),
        ({"cells": [10**400]}, r"ask.cells\[0\] must be an integer, got 1000"),
        ({"pair": ["x"]}, "ask.pair must have 2 elements, got 1"),
        ({"pair": ["x", float("nan")]}, r"ask.pair\[1\] must be a number, got nan"),
        ({"either": [1]}, r"ask.either must be a text or an integer, got \[1\]"),
        ({"parts": {"a": {}}}, "ask.parts.a: name is missing"),
        ({"parts": {"a": {"name": "A", "bound": 1}}}, "ask.parts.a: unknown key 'bound'"),
        ({"force": 1}, "ask.force must be true or false, got 1"),
        ({"forced": True}, "ask: unknown key 'forced'. Did you mean force?"),
        ({"either": "x" * 1000, "force": "y" * 1000}, r"got 'y{99}\.\.\."),
    ],
)
def test_a_wrong_key_or_kind_is_one_message_with_its_place(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        from_json(Asked, {**QUESTION, **change}, "ask")


def test_all_missing_keys_are_named() -> None:
    with pytest.raises(ArgumentError, match=r"ask: from, cells, pair are missing"):
        from_json(Asked, {}, "ask")


@dataclass(frozen=True)
class Row:
    name: str
    at_bound: int = 0


@dataclass(frozen=True, eq=False)
class Reply:
    free_values: int
    rows: Sequence[Row]
    x: Float
    lines: Mapping[str, Float]
    step: float | Absent | None = ABSENT
    y: Float | None = None


def test_arrays_are_sent_beside_the_json_and_absent_fields_are_omitted() -> None:
    answer = to_answer(Reply(3, (Row("A"),), np.zeros(2), {"0": np.ones(1)}))
    assert answer.head == {"freeValues": 3, "rows": [{"name": "A", "atBound": 0}]}
    assert [*answer.arrays] == ["x", "0"]
    assert to_answer(Reply(3, (), np.zeros(0), {}, None, np.zeros(1))).head["step"] is None
    assert to_answer(None).head == {}


def test_json_of_records_within_lists_and_tables() -> None:
    assert to_json({"a": [[Part("A", 1)], []], "b": (1.5, None)}) == {
        "a": [[{"name": "A", "atBound": 1}], []],
        "b": [1.5, None],
    }


@pytest.mark.parametrize("name", ALL)
def test_every_question_has_types(name: str) -> None:
    question = ALL[name]
    for kind in (question.asked, *members(question.reply)):
        if kind not in (None, type(None)):
            assert is_dataclass(kind), f"{name}: {kind}"
            assert kind.__doc__, kind
            assert fields(kind)


@pytest.mark.parametrize("name", ALL)
def test_every_question_refuses_an_unknown_key(name: str) -> None:
    asked = ALL[name].asked
    with pytest.raises(ArgumentError, match=f"{name}: unknown key 'nonsense'"):
        ALL[name](None, {"nonsense": 1})
    if asked is not None:
        with pytest.raises(ArgumentError, match=f"{name} must be an object with keys, got 3"):
            ALL[name](None, 3)  # type: ignore[arg-type]


def test_an_answer_explains_the_error_of_a_question(torque: Path) -> None:
    workspace = AppWorkspace(torque)
    with pytest.raises(ArgumentError, match=r"strip.signals\[0\]: kind, name are missing"):
        workspace.answer("strip", {"dataset": 0, "signals": [{}], "begin": 0, "end": 1, "pixels": 10})
    with pytest.raises(ArgumentError, match="there is no run 7"):
        workspace.answer("compare", {"first": {"from": "now"}, "second": {"from": 7}})
    answer = workspace.answer("table", {"name": "MapOptTorque"})
    assert isinstance(answer, Answer)
    workspace.close()


@pytest.fixture
def wire_types(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / "scripts")
    spec = importlib.util.spec_from_file_location("wire_types", ROOT / "scripts" / "wire_types.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.skipif(not (ROOT / "web").is_dir(), reason="the sources of the page are not part of an installed package")
def test_the_types_of_the_page_are_those_of_the_questions(wire_types: ModuleType) -> None:
    for path, text in wire_types.documents(ROOT / "web").items():
        assert path.read_text(encoding="utf-8") == text, "run: python scripts/wire_types.py web"
        assert max(map(len, text.splitlines())) <= 120


def test_a_record_with_defaults_is_asked_or_replied(wire_types: ModuleType) -> None:
    def ask(session: None, asked: Part) -> Part:
        """Answer."""

    with pytest.raises(ValueError, match="Part has defaults, and is both asked and replied"):
        wire_types.module({"ask-it": Question("ask-it", ask)})


def test_types_of_fields_are_written_in_typescript(wire_types: ModuleType) -> None:
    def ask(session: None, asked: Asked) -> Reply:
        """Answer."""

    text = wire_types.module({"ask-it": Question("ask-it", ask)})
    for line in (
        'from: "now" | "start";',
        "cells: number[];",
        "pair: [string, number];",
        "either?: string | number;",
        "parts?: Record<string, Part | null> | null;",
        "changes?: [Path, Toml | null][];",
        "step?: number | null;",
        "y?: Float32Array;",
        "[name: string]: Float32Array;",
        '"ask-it": { asks: Asked; head: Reply; arrays: Arrays };',
    ):
        assert re.search(rf"^ *{re.escape(line)}$", text, re.MULTILINE), line

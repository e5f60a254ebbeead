"""Keys of the project file that the page sets: written as TOML, chosen from names, and without a trace once removed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SessionState, SetKeys
from kennfeld.base.errors import InputError
from kennfeld.project.demo import write
from kennfeld.project.document import ProjectDocument
from kennfeld.project.key_descriptions import describe_sections
from tests.draws import mostly_slow

SECTIONS = {section["name"]: section for section in describe_sections()}
VALUES = {
    "text": "abc",
    "number": 0.5,
    "integer": 3,
    "flag": True,
    "texts": ["a", "b"],
    "pair": [0, float("inf")],
    "numbers": [1, 2],
    "toml": [[1, 2], [3, 4]],
}


def value_of(form: dict[str, Any]) -> Any:
    """Return a value of a form."""
    kind = form["kind"]
    if kind == "choice":
        return form["options"][-1]
    if kind == "either":
        return value_of(form["forms"][-1])
    if kind == "list":
        return [value_of(form["item"])]
    if kind == "table":
        return {(form["names"] or ["Name"])[0]: value_of(form["values"])}
    if kind in ("entry", "entries"):
        table = {key["name"]: value_of(key["form"]) for key in form["keys"][:2]}
        return table if kind == "entry" else [table]
    return VALUES[kind]


def paths(document: ProjectDocument) -> Iterator[tuple[tuple[str | int, ...], dict[str, Any]]]:
    """Yield the path and form of every key that the first entry of each section may have."""
    for name, section in SECTIONS.items():
        form = section["form"]
        base: tuple[str | int, ...] = (name,)
        if form["kind"] == "entries" and document.get(name):
            base = (name, 1)
        elif form["kind"] == "entries":
            continue  # without an entry there is no key; the page adds the entry first
        elif form["kind"] == "named":
            base = (name, next(iter(document.get(name) or {"New": {}})))
        elif form["kind"] == "table":
            yield (name, "Name"), form["values"]
        for key in form.get("keys", ()):
            yield (*base, key["name"]), key["form"]


@pytest.mark.parametrize("demo", mostly_slow(["torque", "exhaust", "idle"], ["exhaust"]))
def test_a_key_that_is_set_and_removed_leaves_the_file_byte_for_byte(demo: str, tmp_path: Path) -> None:
    text = write(demo, tmp_path / demo).read_bytes().decode()
    state, document, count = SessionState({"kennfeld.toml": text}), ProjectDocument(text), 0
    for path, form in paths(document):
        before = document.get(*path)
        changed = SetKeys("set", "kennfeld.toml", [(path, value_of(form))], text).apply(state)
        restored = SetKeys("reset", "kennfeld.toml", [(path, before)], text).apply(changed)
        assert restored.texts["kennfeld.toml"] == text, path
        count += changed.texts["kennfeld.toml"] != text
    assert count > 60


def test_a_section_that_loses_its_last_key_is_removed_unless_it_has_a_comment() -> None:
    text = "[model]\nfile = 'a.kf'\n\n[optimizer]\nstarts = 4\n"
    for extra in ("", "# four are enough\n"):
        state = SessionState({"a.toml": text + extra})
        removed = SetKeys("reset", "a.toml", [(("optimizer", "starts"), None)]).apply(state).texts["a.toml"]
        assert ("[optimizer]" in removed) == bool(extra)


def test_a_value_is_written_as_toml(torque: Path) -> None:
    session = Session(torque)
    path = ["parameters", "MapOptTorque", "lock"]
    COMMANDS["set-toml"](session, {"path": path, "text": "[{ x = [700, 1000] }]", "title": "lock"})
    assert session.parameters["MapOptTorque"].locked.any()
    COMMANDS["set-toml"](session, {"path": path, "text": " ", "title": "no lock"})
    assert session.state.texts == session.saved.texts


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1, 2", "Unclosed array"),
        ("true\n[optimizer]\nstarts = 0", "must be one value"),
        ("[{ x = [700, 'a'] }]", "must be the first and the last axis value"),
        ("3", "must be a lock, got 3"),
    ],
)
def test_toml_that_the_schema_refuses_changes_nothing(torque: Path, text: str, message: str) -> None:
    session = Session(torque)
    with pytest.raises(InputError, match=message):
        COMMANDS["set-toml"](session, {"path": ["parameters", "MapOptTorque", "lock"], "text": text, "title": "lock"})
    assert session.state is session.saved


DCM = """KONSERVIERUNG_FORMAT 2.0
FESTWERT Kp
   VAR Engine=1
   WERT 1.0
END
FESTWERT Kp
   VAR Engine=2
   WERT 2.0
END
"""


def test_values_choose_from_the_names_of_the_project(torque: Path) -> None:
    (torque.parent / "variants.dcm").write_text(DCM)
    (torque.parent / "ecu.hex").write_text("")
    session = Session(torque)
    COMMANDS["set-keys"](session, {"title": "files", "changes": [[["calibration", "initial"], ["variants.dcm"]]]})
    names = QUESTIONS["names"](session, {}).head["names"]
    assert {"Speed", "Torque", "MotoringTorque"} <= set(names["channel"])
    assert "TorquePredict" in names["node"]
    assert "MapOptTorque" in names["parameter"]
    assert names["variant"] == ["Engine=1", "Engine=2"]
    assert names["calibration file"] == ["start.dcm", "variants.dcm"]
    assert "bench.csv" in names["recording"]
    assert names["image"] == ["ecu.hex"]

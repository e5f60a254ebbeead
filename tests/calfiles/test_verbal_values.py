"""Free text, enumerations and booleans stay what they are, from format to format."""

from dataclasses import replace
from itertools import permutations, product

import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.calfiles import compare, losses, read, write
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Curve, Map, Scalar
from kennfeld.domain.texts import Text

ENDINGS = (".json", ".csv", ".cdfx", ".dcm", ".xlsx", ".m", ".mat")
TEXTS = (
    Text("Name", "true", unit="-"),
    Text("Mode", "ON", "what runs", ("Idle",), display_name="m", unit="-", kind="enumeration"),
    Text("Switch", "false", kind="boolean"),
)
SPEED = Axis([1, 2, 3], unit="rpm", name="AxisSpeed")
TABLES = (
    Scalar("Kü", 0.1, unit="Nm"),
    Block("B", [1, 2, 3], unit="V"),
    Curve("C", Axis([0, 1], unit="%"), [1, 2], unit="°C"),
    Map("M", SPEED, Axis([0, 1], unit="s"), [[0, 1], [2, 3], [4, 5]], unit="bar"),
)


@pytest.mark.parametrize(
    ("first", "second"),
    [  # unmarked: each format once in each place
        pytest.param(first, second, marks=() if ENDINGS[ENDINGS.index(first) - 1] == second else pytest.mark.slow)
        for first, second in permutations(ENDINGS, 2)
    ],
)
def test_kinds_values_units_and_names_pass_through_any_two_formats(tmp_path, first, second):
    members = ParameterSet(TABLES, TEXTS)
    write(members, tmp_path / f"a{first}")
    write(read(tmp_path / f"a{first}"), tmp_path / f"b{second}")
    assert compare(members, read(tmp_path / f"b{second}")).differences == ()


KINDS, TRUTHS, VARIANTS = ("text", "enumeration", "boolean"), ("true", "false", "ON", ""), ("", "Car=A")


def every_text():
    """A set with a label for each kind, text, variant and text of another variant."""
    labels = list(product(KINDS, TRUTHS, VARIANTS, (None, "true", "OFF")))
    texts = [Text(f"T{n}", text, variant=name, kind=kind) for n, (kind, text, name, _) in enumerate(labels)]
    others = [
        replace(text, text=other, variant="Car=B")
        for text, (*_, other) in zip(texts, labels, strict=True)
        if other is not None
    ]
    return ParameterSet([], texts, others=others)


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_kind_stays_or_its_loss_is_reported(tmp_path, ending):
    members, path = every_text(), tmp_path / f"a{ending}"
    write(members, path)
    remarks = [remark.location.path for remark in losses(members, path) if "reads back as" in remark.message]
    after = read(path).everything
    assert after.keys() == members.everything.keys()
    assert set(remarks) == {
        name for (name, variant), text in members.everything.items() if after[name, variant] != text
    }


def test_a_boolean_of_other_words_is_an_enumeration_in_dcm(tmp_path):
    members = ParameterSet([], [Text("T", "ON", kind="boolean")])
    [warning] = losses(members, tmp_path / "a.dcm")
    assert str(warning) == (
        "a.dcm T: is of kind boolean, but 'ON' reads back as enumeration. Write it as .cdfx or .json to keep the kind."
    )


def test_variants_of_a_label_are_words_of_one_kind(written):
    path = written('FESTWERT S\n VAR A=1\n TEXT "true"\nEND\nFESTWERT S\n VAR A=2\n TEXT "undefined"\nEND')
    assert {text.kind for text in read(path).everything.values()} == {"enumeration"}


def test_an_enumeration_of_a_dcm_file_is_written_in_its_place(written, tmp_path):
    path = written('FESTWERT S  \n  EINHEIT_W "-"\n TEXT   "ON"\nEND\n')
    members = read(path)
    changed = members.merged(ParameterSet([], [replace(members.texts[0], text="OFF")]))
    write(changed, tmp_path / "new.dcm")
    assert (tmp_path / "new.dcm").read_text(encoding="utf-8") == path.read_text(encoding="utf-8").replace("ON", "OFF")


def test_a_text_that_becomes_an_enumeration_gets_a_block_of_that_kind(written, tmp_path):
    path = written('TEXTSTRING S\n TEXT "ON"\nEND\n')
    changed = read(path).merged(ParameterSet([], [Text("S", "ON", kind="enumeration")]))
    write(changed, tmp_path / "new.dcm")
    assert "FESTWERT S\n" in (tmp_path / "new.dcm").read_text(encoding="utf-8")
    assert read(tmp_path / "new.dcm").texts == changed.texts


def test_an_unknown_kind_of_text_is_refused():
    with pytest.raises(ArgumentError, match="kind='word' of T must be text, enumeration or boolean"):
        Text("T", "on", kind="word")

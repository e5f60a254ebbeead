import pytest

from kennfeld.base.errors import ArgumentError, Finding, InputError, KennfeldError, Location, visible
from kennfeld.base.formatting import nearest


def test_everything_raised_on_purpose_has_one_root():
    assert issubclass(InputError, KennfeldError)
    assert issubclass(ArgumentError, KennfeldError)
    assert issubclass(ArgumentError, ValueError)
    assert not issubclass(InputError, ValueError)


@pytest.mark.parametrize(
    ("finding", "text"),
    [
        (Finding(Location("a.kf", 4), "X is no parameter"), "a.kf line 4: X is no parameter"),
        (
            Finding(Location("a.kf", 4), "X is no parameter", "Did you mean Y?"),
            "a.kf line 4: X is no parameter. Did you mean Y?",
        ),
        (Finding(Location("a.kf"), "X ends.", "Mend it."), "a.kf: X ends. Mend it."),
        (Finding(Location("a.kf"), "What is X?", "Mend it."), "a.kf: What is X? Mend it."),
        (Finding(Location("a.kf"), "X!", "Mend it."), "a.kf: X! Mend it."),
        (Finding(Location(), "X is wrong"), "X is wrong"),
        (Finding(Location(), "X is wrong", "Mend it."), "X is wrong. Mend it."),
    ],
)
def test_a_finding_reads_as_place_problem_and_mend(finding, text):
    assert str(finding) == text


def test_a_finding_is_an_error_unless_it_is_marked_as_a_warning():
    assert Finding(Location("a"), "b").severity == "error"
    assert Finding(Location("a"), "b", severity="warning").severity == "warning"


def test_an_input_error_carries_every_finding_in_order():
    findings = [Finding(Location("line 1"), "one"), Finding(Location("line 2"), "two")]
    error = InputError(iter(findings))
    assert error.findings == tuple(findings)
    assert str(error) == "line 1: one\nline 2: two"


def test_an_input_error_of_a_single_finding():
    error = InputError.of(Location("line 1"), "one", "Mend it.", "x = ")
    assert error.findings == (Finding(Location("line 1"), "one", "Mend it.", "x = "),)


@pytest.mark.parametrize(
    ("name", "candidates", "question"),
    [
        ("Sped", ["Speed", "Load"], "Did you mean Speed?"),
        ("SPEED", ["speed", "Load"], "Did you mean speed?"),
        ("xyz", ["Speed", "Load"], ""),
        ("Speed", [], ""),
    ],
)
def test_the_nearest_name_is_offered(name, candidates, question):
    assert nearest(name, iter(candidates)) == question


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Speed [1/min] °C µ ≥ 转速", "Speed [1/min] °C µ ≥ 转速"),
        ("a\tb\nc", "a\tb\nc"),
        ("a\x1b[31m\x07\x7f\x9b", r"a\u001b[31m\u0007\u007f\u009b"),
        ("a\u202eb\u2066\u200b\ufeff\u2028", r"a\u202eb\u2066\u200b\ufeff\u2028"),
        ("\U000e0041", r"\udb40\udc41"),
    ],
)
def test_characters_that_act_on_a_terminal_become_escapes(text, shown):
    assert visible(text) == shown
    assert str(Finding(Location(text), "is odd")) == f"{shown}: is odd"
    assert str(ArgumentError(text)) == shown
    assert str(InputError.of(Location("a"), text)) == f"a: {shown}"


def test_the_nearest_of_very_many_names_is_suggested():
    names = [f"Channel_{i}" for i in range(20_000)]
    assert nearest("Chanel_17321", names) == "Did you mean Channel_17321?"
    assert nearest("Torque", names) == ""
    assert nearest("Torqe", [*names, "Torque"]) == "Did you mean Torque?"

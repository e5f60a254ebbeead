import numpy as np
import pytest

from kennfeld import Curve, InputError, Map, ParameterSet, formula, function
from kennfeld.base.errors import Findings, Location
from kennfeld.export.c_code import write_c
from kennfeld.export.names import c_identifier
from kennfeld.export.prepared import prepare
from tests.export.compiled import hostile, in_c, needs_compiler, prepared, simulated


def _messages(text, parameters=(), name="f", **options):
    findings = Findings()
    with pytest.raises(InputError) as error:
        prepare(
            formula(text, parameters=[p.name for p in parameters]),
            ParameterSet(parameters),
            name,
            Location("project"),
            findings,
            **options,
        )
    return [str(finding) for finding in error.value.findings]


@needs_compiler
def test_names_that_are_not_identifiers_get_one():
    text = "y = %n rpm% + %double% * %2nd% + %NAN% + %Air.Mass% + %linux%"
    columns = hostile(1, 30, ["n rpm", "double", "2nd", "NAN", "Air.Mass", "linux"])
    model = formula(text)
    np.testing.assert_array_equal(in_c(model, ParameterSet(), columns), simulated(model, ParameterSet(), columns))


def test_a_remark_says_how_names_are_called():
    findings = Findings()
    prepare(formula("y = %n rpm% + %double%"), ParameterSet(), "f", Location("project"), findings)
    sentence = "project: names of inputs that are not identifiers of C: 'n rpm' is n_rpm, 'double' is double_"
    assert [str(finding) for finding in findings] == [sentence]


def test_names_that_become_equal_are_refused():
    sentence = "project: the inputs 'a.b', 'a b' are both a_b in C. Rename one of them in the function."
    assert _messages("y = %a.b% + %a b%") == [sentence]


def test_names_that_differ_only_behind_63_characters_are_refused():
    long = "x" * 63
    assert "are both" in _messages(f"y = {long}a + {long}b")[0]


def test_a_function_with_a_long_name_is_refused():
    message = _messages("y = x", name="n" * 53)[0]
    assert message.endswith(
        "is longer than 52 characters, which C does not tell apart. Give a shorter one with --name."
    )


@pytest.mark.parametrize("name", ["", "°", "_", "__", "a" * 200, "void", "ä1", "*/", "a\nb", "\u202e"])
def test_every_name_becomes_an_identifier(name):
    own = c_identifier(name)
    assert own.isidentifier()
    assert own.isascii()
    assert len(own) <= 63
    assert not own.startswith("_")


def test_code_outside_of_the_function_is_refused_by_its_name():
    def square(x):
        return x * x

    model = function(square)
    with pytest.raises(InputError, match=r"calls .*square.*: code that is not part of it and cannot be written"):
        prepare(model, ParameterSet(), "f", Location("project"), Findings())


def test_values_that_single_precision_cannot_hold_are_refused():
    table = Curve("C", [0, 1, 1 + 1e-9], [0, 1e39, 2])
    assert _messages("y = C(x)", [table], precision="float") == [
        "project: C has values beyond 3.4e38, the limit of single precision. Export with --precision double.",
        "project: breakpoints 1.0 and 1.000000001 are equal in single precision. "
        "Export with --precision double, or move one of them.",
    ]


def test_missing_values_and_unknown_nodes_are_named():
    table = Map("M", [0, 1, 2], [0, 1], [[0, 1], [2, 3], [4, 5]])
    assert "has no node z" in _messages("y = M(x, x)", [table], outputs=["z"])[0]
    with pytest.raises(InputError, match="values of M are missing"):
        prepare(formula("y = M(x, x)", parameters=["M"]), ParameterSet(), "f", Location("project"), Findings())


def test_a_comment_cannot_be_ended_by_a_name():
    _, source = write_c(
        prepared(formula("%*/ int evil; /*% = x + 1\ny = %*/ int evil; /*% * 2"), ParameterSet())
    ).values()
    assert "* / int evil; / *" in source

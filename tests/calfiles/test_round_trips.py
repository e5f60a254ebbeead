"""Each format reads back an equal set; damaged files are refused with findings."""

import json
from dataclasses import replace

import pytest
from hypothesis import assume
from hypothesis import strategies as st

from kennfeld.base.errors import InputError
from kennfeld.calfiles import read, write
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.texts import Text
from tests.calfiles.calibration_sets import line_texts, parameter_sets, plain_units
from tests.draws import few_or_many

FULL = parameter_sets(quantities=line_texts, cubes=True)
SETS = {  # what each format can hold
    ".dcm": parameter_sets(),
    ".json": FULL,
    ".csv": parameter_sets(units=plain_units, descriptions=st.just("")),
    ".cdfx": parameter_sets(cubes=True),
    ".xlsx": FULL,
    ".mat": FULL,
    ".m": FULL,
}


@pytest.mark.parametrize("ending", SETS)
@few_or_many(data=st.data(), few=5, many=50)
def test_a_format_reads_back_what_it_wrote(tmp_path_factory, ending, data):
    path, parameters = tmp_path_factory.mktemp("sets") / f"a{ending}", data.draw(SETS[ending])
    checked = {".xlsx": repr(parameters), ".cdfx": "".join(text.text for text in parameters.texts)}
    assume(not set(NO_XML) & set(checked.get(ending, "")))
    # a DCM states no kind of a text: these two are truth values there
    assume(
        ending != ".dcm" or not {"true", "false"} & {text.text for text in parameters.texts if text.kind != "boolean"}
    )
    write(parameters, path)
    assert read(path) == (in_xml(parameters) if ending == ".cdfx" else parameters)
    if ending == ".json":
        json.loads(path.read_text(encoding="utf-8"))


def labelled(item, functions, display_name, variant):
    """A parameter or text with all that says where it belongs."""
    labels = {"functions": tuple(functions), "display_name": display_name, "variant": variant}
    return replace(item, **labels) if isinstance(item, Text) else item.changed(**labels)


@st.composite
def labelled_sets(draw):
    """Sets with functions, display names, and further variants of some labels."""
    plain = draw(parameter_sets(units=plain_units, descriptions=st.just("")))
    functions = draw(st.lists(st.sampled_from(["Idle", "Trq", "A b"]), unique=True, max_size=2))
    display_name = draw(st.sampled_from(["", "k", "k 1"]))
    first, second = draw(st.sampled_from([("", "Car=A"), ("Car=A,Gear=M", "Car=B,Gear=M"), ("A", "B=2")]))
    items = [
        [labelled(item, functions, display_name, first) for item in group] for group in (plain.parameters, plain.texts)
    ]
    others = [labelled(item, functions, display_name, second) for item in (*plain.parameters[::2], *plain.texts[:1])]
    return ParameterSet(*items, plain.axes, others)


@pytest.mark.parametrize("ending", [".json", ".csv", ".cdfx", ".xlsx", ".m", ".mat"])
@few_or_many(parameters=labelled_sets(), few=5, many=50)
def test_functions_display_names_and_variants_come_back(tmp_path_factory, ending, parameters):
    path = tmp_path_factory.mktemp("sets") / f"a{ending}"
    assume(not any(character in text.text for text in parameters.texts for character in NO_XML))
    write(parameters, path)
    again = read(path)
    assert again.everything == parameters.everything
    assert again.chosen == parameters.chosen


def in_xml(parameters):
    """The set with the two characters that XML excludes turned into blanks, as units and descriptions are written."""
    return ParameterSet(
        [
            member.changed(
                unit=blanked(member.unit),
                description=blanked(member.description),
                axes=tuple(axis.changed(unit=blanked(axis.unit)) for axis in member.axes),
            )
            for member in parameters.parameters
        ],
        [replace(text, description=blanked(text.description), unit=blanked(text.unit)) for text in parameters.texts],
        [axis.changed(unit=blanked(axis.unit)) for axis in parameters.axes],
    )


NO_XML = "\ufffe\uffff"


def blanked(text):
    return "".join(" " if character in NO_XML else character for character in text)


@pytest.mark.parametrize("ending", [".dcm", ".json", ".csv", ".cdfx", ".xlsx", ".m", ".mat"])
@few_or_many(data=st.data(), few=4, many=40)
def test_a_damaged_file_is_read_or_refused_with_findings(tmp_path_factory, ending, data):
    path = tmp_path_factory.mktemp("sets") / f"a{ending}"
    write(data.draw(parameter_sets(units=plain_units)), path)
    path.write_bytes(data.draw(damaged(path.read_bytes())))
    assert all(finding.message for finding in findings(path))


def findings(path):
    """Return the message that refuses a damaged file; any other exception fails the test."""
    try:
        read(path)
    except InputError as error:
        return error.findings or pytest.fail("refused without a finding")
    return ()


@st.composite
def damaged(draw, raw):
    """The file cut off, with a piece removed, repeated or replaced, or with its words shuffled."""
    first, last = sorted(draw(st.lists(st.integers(0, len(raw)), min_size=2, max_size=2)))
    replacement = draw(st.one_of(st.binary(max_size=8), st.sampled_from(_INSERTS)))
    return draw(
        st.sampled_from(
            [
                raw[:first],
                raw[:first] + raw[last:],
                raw[:last] + raw[first:],
                raw[:first] + replacement + raw[first:],
                raw[:first] + replacement + raw[last:],
                raw[:first] + raw[first:last][::-1] + raw[last:],
            ]
        )
    )


_INSERTS = [
    b"\nEND\n",
    b"\nKENNFELD X 999999999 999999999\n",
    b"\nKENNLINIE\n",
    b" nan ",
    b" 1e999 ",
    b"\0",
    b'"',
    b"\n",
    b"[[[[",
    b"null",
    b"-",
    b"\n,MAP\nMAP,\n",
    b"\xff\xfe",
    b"</VG><VG>",
    b"<V>1</V>",
    b"<VT>1</VT>",
    b"<SW-INSTANCE>",
    b"&lol;",
]

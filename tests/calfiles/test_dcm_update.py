"""A DCM file that was read is written with other numbers and nothing else changed."""

import difflib

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.calfiles import merge, read, write
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map, Scalar
from tests.calfiles.calibration_sets import parameter_sets
from tests.draws import few_or_many

TEXT = """* encoding="UTF-8"
! a remark
KONSERVIERUNG_FORMAT 2.0

FUNKTIONEN
  FKT F1 "1.0" "long name"
END

VARIANTENKODIERUNG
  KRITERIUM Engine 1 2
END


FESTWERT K
\t LANGNAME "a b"  ! no comment
  FUNKTION F1
  NEWKEY 17 "kept"
  WERT 1.50
END

FESTWERT V
  VAR Engine=1
  WERT 10
END
FESTWERT V
  VAR Engine=2
  WERT 20
END

FESTWERT W
  WERT 25.0
  VAR A=27.5,B=28
END
KENNFELD M 3 2
  EINHEIT_W "Nm"
  ST/X  1.0  2.0
  ST/X  3.0
  ST/Y  1\x20\x20
  WERT  0.10  0.20  0.30\x20\x20\x20
  ST/Y  2
  WERT  1e-1
  WERT  0.20  0.30
END
KENNLINIE T 2
  ST_TX/X "low" "high"
  WERT 1 2
END
GRUPPENKENNLINIE G 2
*SSTX\tAxisG
  ST/X 1.00 2.00
  WERT 5 6
END
GRUPPENKENNLINIE H 2
* SSTX AxisG
  ST/X 1.0 2.0
  WERT 7 8
END
STUETZSTELLENVERTEILUNG AxisG 2
*SST
  ST/X 1 2
END
TEXTSTRING S
  TEXT "old \\"word\\""
END"""


def changed(path, parameters, target):
    """The lines that differ between a file and what a set read from it becomes."""
    write(parameters, target)
    before, after = (file.read_bytes().decode().splitlines(keepends=True) for file in (path, target))
    return [line for line in difflib.ndiff(before, after) if line[0] in "+-"]


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be", "cp1252"])
def test_an_unchanged_file_is_the_same_to_the_byte(tmp_path, newline, encoding):
    text = TEXT.replace("a b", "°C ä").replace("\n", newline)
    text = text if encoding != "cp1252" else text.replace('* encoding="UTF-8"', "* none")
    raw = b"\xfe\xff" * (encoding == "utf-16-be") + text.encode(encoding)
    (tmp_path / "a.dcm").write_bytes(raw)
    write(read(tmp_path / "a.dcm"), tmp_path / "b.dcm")
    assert (tmp_path / "b.dcm").read_bytes() == raw


@pytest.mark.parametrize(
    "file",
    [
        "pydcm_DEMO.DCM",
        "dcmReader_Sample.dcm",
        "MatlabDCMParser_MapToDcm.DCM",
        "MatlabDCMParser_SplitTestDCM.dcm",
        "MatlabDCMParser_TestDCM1.dcm",
        "MatlabDCMParser_TestDCM2.dcm",
    ],
)
def test_real_files_are_the_same_to_the_byte(shared_data, tmp_path, file):
    parameters = read(shared_data / "dcm" / file)
    write(parameters, tmp_path / "a.dcm")
    raw = (shared_data / "dcm" / file).read_bytes()
    assert (tmp_path / "a.dcm").read_bytes() == raw
    for name, member in parameters.items():
        last = member.values.copy().ravel()
        last[-1] += 0.5
        moved = parameters.with_parameters(member.with_values(last))
        write(moved, tmp_path / "b.dcm")
        words, now = raw.split(), (tmp_path / "b.dcm").read_bytes().split()
        assert sum(one != other for one, other in zip(words, now, strict=True)) == 1, name
        assert read(tmp_path / "b.dcm") == moved


@pytest.mark.parametrize(
    ("name", "values", "lines"),
    [
        ("K", 2.25, ["-   WERT 1.50\n", "+   WERT 2.25\n"]),
        ("V", 11, ["-   WERT 10\n", "+   WERT 11\n"]),
        ("W", 26.5, ["-   WERT 25.0\n", "+   WERT 26.5\n"]),
        ("M", [[0.1, 0.1], [0.2, 7.5], [0.3, 0.3]], ["-   WERT  0.20  0.30\n", "+   WERT  7.5  0.30\n"]),
        (
            "M",
            [[0.1, 0.1], [0.25, 0.2], [0.3, 0.3]],
            ["-   WERT  0.10  0.20  0.30   \n", "+   WERT  0.10  0.25  0.30   \n"],
        ),
        ("G", [5, 6.5], ["-   WERT 5 6\n", "+   WERT 5 6.5\n"]),
    ],
)
def test_a_changed_value_changes_that_number_alone(written, tmp_path, name, values, lines):
    path = written(TEXT)
    parameters = read(path)
    member = parameters[name].with_values(np.array(values, float))
    lines_changed = changed(path, parameters.with_parameters(member), tmp_path / "b.dcm")
    assert lines_changed == lines
    assert read(tmp_path / "b.dcm")[name] == member


def test_a_group_axis_changes_in_every_copy(written, tmp_path):
    path = written(TEXT)
    parameters = read(path)
    moved = [parameters[name].changed(axes=(Axis([1.0, 2.5], name="AxisG"),)) for name in "GH"]
    lines_changed = changed(path, parameters.with_parameters(*moved), tmp_path / "b.dcm")
    assert [line[4:] for line in lines_changed if line[0] == "+"] == [
        "ST/X 1.00 2.5\n",
        "ST/X 1.0 2.5\n",
        "ST/X 1 2.5\n",
    ]
    assert read(tmp_path / "b.dcm").axes[0].breakpoints.tolist() == [1.0, 2.5]


def test_the_chosen_variant_is_the_one_that_changes(written, tmp_path):
    path = written(TEXT)
    parameters = read(path).in_variant("Engine=2")
    lines_changed = changed(path, parameters.with_parameters(Scalar("V", 21)), tmp_path / "b.dcm")
    assert lines_changed == ["-   WERT 20\n", "+   WERT 21\n"]
    parameters = read(path).in_variant("B")
    lines_changed = changed(path, parameters.with_parameters(Scalar("W", 29)), tmp_path / "b.dcm")
    assert lines_changed == ["-   VAR A=27.5,B=28\n", "+   VAR A=27.5,B=29\n"]


def test_values_of_variants_keep_their_blanks(written, tmp_path):
    path = written("FESTWERT W\n  WERT 1\n\tVAR BA = 2 , A=  3,C=4  \nEND\n")
    parameters = read(path).in_variant("A").with_parameters(Scalar("W", 3.5))
    parameters = parameters.in_variant("C").with_parameters(Scalar("W", 44))
    lines_changed = changed(path, parameters, tmp_path / "b.dcm")
    assert lines_changed[-1] == "+ \tVAR BA = 2 , A=  3.5,C=44  \n"
    assert read(tmp_path / "b.dcm").everything == parameters.everything


def test_a_new_description_replaces_the_old_one_or_is_added(written, tmp_path):
    path = written(TEXT)
    parameters = read(path)
    described = [parameters[name].changed(description="what it is for") for name in "KM"]
    lines_changed = changed(path, parameters.with_parameters(*described), tmp_path / "b.dcm")
    assert [line for line in lines_changed if line[0] == "+"] == [
        '+ \t LANGNAME "what it is for"  ! no comment\n',
        '+    LANGNAME "what it is for"\n',
    ]
    silent = parameters["K"].changed(description="")
    assert changed(path, parameters.with_parameters(silent), tmp_path / "c.dcm") == []


def test_a_changed_text_changes_between_its_quotes(written, tmp_path):
    path = written(TEXT)
    parameters = read(path)
    moved = ParameterSet(
        parameters.parameters,
        [parameters.texts[0].__class__("S", 'a "new" one')],
        parameters.axes,
        parameters.others,
        origin=parameters.origin,
    )
    assert changed(path, moved, tmp_path / "b.dcm")[1] == '+   TEXT "a \\"new\\" one"\n'
    assert read(tmp_path / "b.dcm").texts[0].text == 'a "new" one'


def test_a_table_of_another_size_is_written_anew_with_its_comments(written, tmp_path):
    path = written(TEXT.replace('  EINHEIT_W "Nm"\n', '  EINHEIT_W "Nm"\n* a comment\n  STRANGE 1\n'))
    parameters = read(path)
    smaller = Map("M", [1, 2], [1, 2], [[1, 2], [3, 4]], unit="Nm")
    write(parameters.with_parameters(smaller), tmp_path / "b.dcm")
    text = (tmp_path / "b.dcm").read_text()
    assert text.index("KENNFELD M 2 2") < text.index("* a comment\n  STRANGE 1\nEND\nKENNLINIE T 2")
    assert read(tmp_path / "b.dcm")["M"] == smaller


def test_new_blocks_are_appended_and_missing_ones_removed(written, tmp_path):
    path = written(TEXT)
    parameters = read(path).with_parameters(Curve("New", Axis([1, 2], name="AxisN"), [3, 4])).without(["K"])
    write(parameters, tmp_path / "b.dcm")
    text = (tmp_path / "b.dcm").read_text()
    assert "FESTWERT K" not in text
    assert (
        text.index('TEXT "old') < text.index("GRUPPENKENNLINIE New 2") < text.index("STUETZSTELLENVERTEILUNG AxisN 2")
    )
    assert read(tmp_path / "b.dcm") == parameters


def test_a_part_of_a_file_holds_nothing_that_was_not_asked_for(written, tmp_path):
    write(read(written(TEXT)).select(["K", "V"]), tmp_path / "b.dcm")
    text = (tmp_path / "b.dcm").read_text()
    assert "ST_TX/X" not in text
    assert read(tmp_path / "b.dcm").variants == ("Engine=1", "Engine=2")


def test_merging_writes_into_the_first_file(written, tmp_path):
    path, other = written(TEXT), written("FESTWERT K\n WERT 3\nEND", "b.dcm")
    merged = merge([("a", read(path)), ("b", read(other))]).parameters
    assert changed(path, merged, tmp_path / "c.dcm") == ["-   WERT 1.50\n", "+   WERT 3.0\n"]


def test_another_format_gives_the_variants_again(written, tmp_path):
    parameters = read(written(TEXT))
    write(parameters, tmp_path / "a.json")
    assert read(tmp_path / "a.json") == parameters
    write(read(tmp_path / "a.json"), tmp_path / "a.dcm")
    again = read(tmp_path / "a.dcm")
    assert again.everything == parameters.everything
    assert again.axes == parameters.axes


@pytest.mark.slow
@few_or_many(data=st.data(), few=10, many=100)
def test_any_change_is_read_back_and_touches_no_other_word(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("sets")
    write(data.draw(parameter_sets()), folder / "a.dcm")
    parameters = read(folder / "a.dcm")
    write(parameters, folder / "b.dcm")
    assert (folder / "a.dcm").read_bytes() == (folder / "b.dcm").read_bytes()
    if not parameters:
        return
    member = data.draw(st.sampled_from(parameters.parameters))
    values = member.values.copy().ravel()
    at = data.draw(st.integers(0, values.size - 1))
    values[at] = data.draw(st.floats(-1e6, 1e6))
    moved = parameters.with_parameters(member.with_values(values))
    write(moved, folder / "c.dcm")
    assert read(folder / "c.dcm") == moved
    words = [(folder / name).read_bytes().split() for name in ("a.dcm", "c.dcm")]
    assert sum(word != moved_word for word, moved_word in zip(*words, strict=True)) <= 1


def test_another_display_name_and_other_functions_are_written(written, tmp_path):
    before = read(written('FESTWERT K\n LANGNAME "gain"\n FUNKTION F1\n WERT 1.50\nEND\n'))
    after = before.with_parameters(before["K"].changed(display_name="k", functions=("F1", "F2")))
    write(after, tmp_path / "new.dcm")
    assert read(tmp_path / "new.dcm") == after


def test_a_rewritten_block_keeps_what_the_set_does_not_state(written, tmp_path):
    path = written('FESTWERT K\n LANGNAME "gain"\n FUNKTION F1\n DISPLAYNAME k\n WERT 1.50\nEND\n')
    before = read(path)
    write(before.with_parameters(Scalar("K", 2.0, unit="Nm")), tmp_path / "new.dcm")
    assert read(tmp_path / "new.dcm")["K"] == before["K"].changed(values=np.array(2.0), unit="Nm")


def test_a_set_without_functions_leaves_those_of_the_file(written, tmp_path):
    path = written("FESTWERT K\n FUNKTION F1\n WERT 1.50\nEND\n")
    write(read(path).with_parameters(Scalar("K", 2.0)), tmp_path / "new.dcm")
    assert (tmp_path / "new.dcm").read_text(encoding="utf-8") == path.read_text(encoding="utf-8").replace("1.50", "2.0")

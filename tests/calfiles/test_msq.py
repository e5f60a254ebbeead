"""Tunes of TunerStudio: tables with the axes of a definition file, and the same file with other numbers."""

import re

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles import describe, merge, read, write
from kennfeld.calfiles.files import unwritable
from kennfeld.calfiles.msq.reader import Pair, pairs_of, usual_pairs
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Curve, Map, Scalar
from kennfeld.domain.texts import Text

TUNE = """<?xml version="1.0" encoding="ISO-8859-1"?>
<msq xmlns="http://www.msefi.com/:msq">
<!-- <constant name="old">1.0</constant> -->
<versionInfo fileFormat="5.0" nPages="2" signature="mine 1"/>
<page>
<pcVariable digits="0" name="rpmhigh" units="rpm">8000.0</pcVariable>
</page>
<page number="1" size="288">
<constant cols="3" digits="1" name="veTable" rows="2" units="%">
         39.0 40.0 41.0
         50.0 51.0 52.0
      </constant>
<constant cols="1" digits="0" name="rpmBins" rows="3" units="RPM">
         500.0
         700.0
         1000.0
      </constant>
<constant cols="1" digits="0" name="fuelLoadBins" rows="2" units="kPa">
         16.0
         100.0
      </constant>
<constant cols="1" digits="0" name="odd" rows="2">1.0 2.0</constant>
<constant name="mode">"Speed &amp; \xe4"</constant>
<constant name="gain">0.25</constant>
</page>
</msq>
"""
INI = """[MegaTune]
   signature = "mine 1" ; of the firmware
[Constants]
   table = nothing
[TableEditor]
   table = veTbl, veMap, "VE Table", 1
      #if LAMBDA
      xBins = rpmBins, rpm
      #endif
      ;yBins = other
      yBins = fuelLoadBins, {load + 1}
      zBins = veTable
[CurveEditor]
   curve = c, "Odd; curve"
      xBins = fuelLoadBins, map
      yBins = odd
      yBins = missing
"""
ZEROS = np.zeros((3, 2))
SPEED, LOAD = Axis([500, 700, 1000], "rpm", "RPM", "rpmBins"), Axis([16, 100], "", "kPa", "fuelLoadBins")


@pytest.fixture
def tune(written):
    return lambda text=TUNE: written(text, "tune.msq", "latin-1")


def refused(path):
    with pytest.raises(InputError) as caught:
        read(path)
    return str(caught.value)


def test_a_tune_is_read_with_the_axes_of_its_definition_file(tune, written):
    path = tune()
    written(INI, "some.ini")
    written(INI.replace("mine 1", "other"), "mainController.ini")
    parameters = read(path)
    ve = Map(
        "veTable", SPEED, LOAD, [[39, 50], [40, 51], [41, 52]], unit="%", description="VE Table", functions=["page 1"]
    )
    assert parameters["veTable"] == ve
    assert parameters["odd"].kind == "curve"
    assert parameters["odd"].description == "Odd; curve"
    assert list(parameters) == ["rpmhigh", "veTable", "odd", "gain"]
    assert parameters["rpmhigh"] == Scalar("rpmhigh", 8000, unit="rpm")
    assert parameters.texts == (Text("mode", "Speed & \xe4", functions=("page 1",), kind="enumeration"),)
    assert describe(path).kind == "MSQ tune of mine 1"
    assert describe(path).findings == ()


def test_the_usual_pairs_are_used_without_a_definition_file(tune):
    parameters = read(tune())
    assert [axis.name for axis in parameters["veTable"].axes] == ["rpmBins", "fuelLoadBins"]
    assert parameters["odd"] == Block("odd", [1, 2], functions=["page 1"])


def test_a_definition_file_of_another_firmware_is_reported(tune, written):
    written(INI.replace("mine 1", "other"), "mainController.ini")
    [warning] = describe(tune()).findings
    assert "mainController.ini is for the firmware 'other', but the tune for 'mine 1'" in str(warning)


def test_breakpoints_that_do_not_increase_make_blocks(tune):
    path = tune(TUNE.replace("700.0", "500.0"))
    assert (read(path)["veTable"].kind, read(path)["rpmBins"].kind) == ("block", "block")
    assert read(path)["veTable"].values.shape == (3, 2)
    [warning] = describe(path).findings
    assert "line 9 (veTable): is read as a value block: its breakpoints rpmBins neither rise nor fall: " in str(warning)


def test_an_unchanged_tune_is_the_same_file(tune, tmp_path):
    path = tune(TUNE.replace("\n", "\r\n"))
    assert write(read(path), tmp_path / "new.msq") == ()
    assert (tmp_path / "new.msq").read_bytes() == path.read_bytes()


def test_only_changed_entries_differ(tune, tmp_path):
    path = tune()
    before = read(path)
    ve = before["veTable"]
    speed = ve.axes[0].changed(breakpoints=[500, 700, 1200])
    changed = ve.changed(values=ve.values + np.array([[0, 0], [0, 1], [0, 0]]), axes=(speed, ve.axes[1]))
    new = before.with_parameters(changed).merged(
        ParameterSet(texts=[Text("mode", "a <b>", functions=("page 1",), kind="enumeration")])
    )
    assert write(new, tmp_path / "new.msq") == ()
    text = (tmp_path / "new.msq").read_text(encoding="latin-1")
    expected = TUNE.replace("51.0", "52.0").replace("1000.0", "1200.0").replace("Speed &amp; \xe4", "a &lt;b&gt;")
    assert text == expected
    assert read(tmp_path / "new.msq") == new


def test_numbers_are_rounded_to_their_digits_with_a_remark(tune, tmp_path):
    before = read(tune())
    values = before["veTable"].values + np.array([[0.04, 0], [0, 0.26], [0, 0]])
    remarks = write(before.with_parameters(before["veTable"].with_values(values)), tmp_path / "new.msq")
    assert [str(warning) for warning in remarks] == [
        "new.msq veTable: rounded to 1 digit, as the tune stores it; the largest change is 0.04"
    ]
    assert read(tmp_path / "new.msq")["veTable"].values.tolist() == [[39, 50], [40, 51.3], [41, 52]]
    write(before.with_parameters(Scalar("gain", 1 / 3, functions=["page 1"])), tmp_path / "new.msq")
    assert read(tmp_path / "new.msq")["gain"].value == 1 / 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (Scalar("new", 1.0), "new.msq new: is not a parameter of the tune. Leave it out."),
        (Block("gain", [1.0, 2.0]), "is a block 2, but a scalar in the tune"),
        (Curve("odd", [1, 2], [1, 2]), "is a curve 2, but a block 2 in the tune"),
        (Scalar("gain", np.nan), "cannot store non-finite values"),
        (
            Map("veTable", SPEED.changed(breakpoints=[500, 500.1, 1000]), LOAD, np.zeros((3, 2))),
            "after rounding to 0 digits",
        ),
        (Map("veTable", [1, 2, 3], LOAD, np.zeros((3, 2))), "Change the group axis rpmBins"),
    ],
)
def test_parameters_that_the_tune_cannot_hold_are_refused(tune, tmp_path, change, message):
    with pytest.raises(InputError, match=re.escape(message)):
        write(read(tune()).with_parameters(change), tmp_path / "new.msq")


def test_values_from_elsewhere_are_merged_into_a_tune(tune, tmp_path):
    with pytest.raises(InputError, match=r"kennfeld merge tune\.msq"):
        write(ParameterSet([Scalar("gain", 2.0)]), tmp_path / "new.msq")
    write(
        merge([("tune.msq", read(tune())), ("new.dcm", ParameterSet([Scalar("gain", 2.0)]))]).parameters,
        tmp_path / "new.msq",
    )
    assert read(tmp_path / "new.msq")["gain"].value == 2.0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("51.0 ", "", "tune.msq line 9 (veTable): has 5 values, but its rows and columns state 2 x 3"),
        ("51.0", "x", "line 9 (veTable): must be a number, got 'x'"),
        ("51.0", "5-1", "line 9 (veTable): must be a finite number, got '5-1'"),
        (' name="gain"', "", "a constant has no name"),
        ("</msq>", "", "is not well-formed XML"),
        ("<msq", '<!DOCTYPE m [<!ENTITY e SYSTEM "file:///etc/passwd">]><msq', "declares the entity e"),
    ],
)
def test_errors_are_named(tune, old, new, message):
    assert message in refused(tune(TUNE.replace(old, new, 1)))


def test_a_definition_file_names_the_pairs():
    assert pairs_of(INI) == [
        Pair("veTable", ("rpmBins", "fuelLoadBins"), ("rpm", ""), "VE Table"),
        Pair("odd", ("fuelLoadBins",), ("map", ""), "Odd; curve"),
        Pair("missing", ("fuelLoadBins",), ("map", ""), "Odd; curve"),
    ]
    assert all(1 <= len(pair.axes) <= 2 for pair in usual_pairs())


def test_a_real_tune_is_read_and_written_back(shared_data, tmp_path):
    path = shared_data / "ecu_logs" / "from_v2_mlg_speeduino_tune.msq"
    parameters = read(path)
    assert (len(parameters), parameters["veTable"].kind, parameters["veTable"].values[0, -1]) == (332, "map", 70)
    assert parameters["iacOLPWMVal"].axes[0].name == parameters["iacCLValues"].axes[0].name == "iacBins"
    write(parameters, tmp_path / "same.msq")
    assert (tmp_path / "same.msq").read_bytes() == path.read_bytes()
    changed = parameters["veTable"].values.copy()
    changed[0, -1] = 71
    write(parameters.with_parameters(parameters["veTable"].with_values(changed)), tmp_path / "new.msq")
    before, after = path.read_bytes().splitlines(), (tmp_path / "new.msq").read_bytes().splitlines()
    assert [(b, a) for b, a in zip(before, after, strict=True) if a != b] == [
        (before[653], before[653].replace(b"70.0", b"71.0", 1))
    ]


def findings(path):
    """Return the message that refuses a file; any other exception fails the test."""
    try:
        read(path)
    except InputError as error:
        return error.findings
    return ()


@pytest.mark.parametrize("seed", range(3))
def test_damaged_tunes_are_read_or_refused(tune, seed):
    generator = np.random.default_rng(seed)
    path = tune()
    raw = path.read_bytes()
    for _ in range(60):
        first, last = sorted(generator.integers(0, len(raw), 2))
        inserts = [b"", b'"', b"<", b" 1e999 ", b"&lol;", b"-", b'rows="999999"', raw[first:last]]
        path.write_bytes(raw[:first] + inserts[generator.integers(len(inserts))] + raw[last if first % 2 else first :])
        assert all(finding.message for finding in findings(path))


def test_a_unit_and_a_kind_that_differ_from_the_tune_are_reported(tune, tmp_path):
    before = read(tune())
    other = ParameterSet([before["rpmhigh"].changed(unit="1/s")], [Text("mode", "Speed & \xe4")])
    messages = [str(one) for one in write(before.merged(other), tmp_path / "new.msq")]
    assert messages == [
        "new.msq mode: is of kind text, but enumeration in the tune",
        "new.msq: written without conversion, since the tune has another unit: 1 label (rpmhigh). "
        "Check that this is intended.",
    ]


def test_a_constant_that_the_definition_file_declares_as_string_is_free_text(tune, written):
    path = tune()
    written(INI + "\n[Constants]\nmode = string, ASCII, 0, 32\n", "some.ini")
    assert [text.kind for text in read(path).texts] == ["text"]


def test_only_labels_that_the_tune_lacks_are_unwritable(tune):
    more = read(tune()).with_parameters(Scalar("TimeConstant", 0.3))
    assert list(unwritable(more, ".msq")) == ["TimeConstant"]

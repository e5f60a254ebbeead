import gzip
import os

import numpy as np
import pytest

import kennfeld.calfiles
from kennfeld.base.errors import ArgumentError, InputError, InputWarning
from kennfeld.calfiles import describe, endings, read, write
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.domain.texts import Text

ONE = ParameterSet([Scalar("K", 2.0)])


def test_the_public_names_are_pinned():
    assert kennfeld.calfiles.__all__ == [
        "A2lFile",
        "CalibrationFile",
        "Change",
        "Comparison",
        "Difference",
        "Merged",
        "ParameterSummary",
        "Tolerance",
        "changed",
        "compare",
        "describe",
        "describe_a2l",
        "endings",
        "losses",
        "merge",
        "read",
        "read_several",
        "read_with_findings",
        "recognise",
        "unwritable",
        "write",
    ]
    assert set(endings()) >= {".json", ".csv", ".cdfx", ".dcm", ".msq", ".par", ".xlsx", ".mat", ".m", ".hex", ".s19"}


@pytest.mark.parametrize("ending", [".dcm", ".json", ".csv", ".cdfx", ".xlsx", ".mat", ".m", ".DCM"])
def test_the_content_decides_the_format_when_reading(tmp_path, ending):
    write(ONE, tmp_path / f"a{ending}")
    (tmp_path / f"a{ending}").rename(tmp_path / "renamed.txt")
    assert read(str(tmp_path / "renamed.txt")) == ONE


def test_a_set_saves_itself(tmp_path):
    ONE.save(tmp_path / "a.dcm")
    assert read(tmp_path / "a.dcm") == ONE


def test_an_unknown_ending_is_refused_with_the_known_ones(tmp_path):
    with pytest.raises(ArgumentError, match=r"DCM \(\.dcm\).*Did you mean \.dcm\?"):
        write(ONE, tmp_path / "a.dcmx")
    assert not list(tmp_path.iterdir())


def test_a_file_is_replaced_as_a_whole(tmp_path, monkeypatch):
    path = tmp_path / "a.dcm"
    write(ONE, path)
    before = path.read_bytes()

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", full_disk)
    with pytest.raises(InputError, match="cannot be written: No space left"):
        write(ParameterSet([Scalar("K", 3.0)]), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_reported(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write(ONE, tmp_path / "nowhere" / "a.dcm")


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
def test_a_link_stays_a_link(tmp_path):
    write(ONE, tmp_path / "a.dcm")
    (tmp_path / "link.dcm").symlink_to(tmp_path / "a.dcm")
    write(ParameterSet([Scalar("K", 3.0)]), tmp_path / "link.dcm")
    assert (tmp_path / "link.dcm").is_symlink()
    assert read(tmp_path / "a.dcm")["K"].value == 3.0


def test_a_description_lists_the_contents_of_a_file(tmp_path):
    speed = Axis([1, 2], unit="rpm", name="AxisSpeed")
    parameters = ParameterSet([Curve("C", speed, [3, np.nan], unit="Nm", description="d")], [Text("T", "a")])
    write(parameters, tmp_path / "a.json")
    description = describe(tmp_path / "a.json")
    assert (description.kind, description.axes, description.texts, description.findings) == (
        "JSON",
        (speed,),
        (Text("T", "a"),),
        (),
    )
    summary = description.parameters[0]
    assert (summary.name, summary.kind, summary.shape, summary.unit) == ("C", "curve", (2,), "Nm")
    assert (summary.description, summary.minimum, summary.maximum) == ("d", 3.0, 3.0)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"", "is empty"),
        (b" \n ", "is empty"),
        (b"\x1c\x1d\n", "is empty"),
        (gzip.compress(b"\xef\xbb\xbf", mtime=0), "is empty"),
        (b"FESTWERT K\n\0\0", "it holds binary data"),
        (b"MDF     4.10\0\0", "it looks like an MDF measurement"),
        (b"PK\x03\x04\0\0", "it looks like a ZIP archive"),
        (b"\xef\xbb\xbf<?xml version='1.0'?>", "it looks like XML"),
        (b"<?xml version='1.0'?>\n<!-- <a> --><PaCo><x/></PaCo>", "it looks like XML with the root PaCo"),
        (b"time,Torque\n0,1\n", "it begins with 'time,Torque'"),
    ],
)
def test_a_file_of_another_kind_is_refused(tmp_path, raw, message):
    path = tmp_path / "start.dcm"
    path.write_bytes(raw)
    with pytest.raises(InputError, match=r"Expected .*DCM \(\.dcm\)") as caught:
        read(path)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("name", "raw", "message"),
    [
        (
            "a.par",
            b"Kp 1.0\n",
            "is a parameter file (.par) that does not begin as those of CANape, which cannot be read. Export it from",
        ),
        ("a.PAR", b"<?xml version='1.0'?><a/>", "is a parameter file (.par)"),
        ("a.cdm", b"\0\1", "is an INCA calibration data file (.cdm), which cannot be read. Export it from that tool"),
        (
            "a.sldd",
            b"PK\3\4",
            "is a Simulink data dictionary (.sldd): which axes its tables have is stated in the model",
        ),
        ("a.lab", b"[Label]\nK\n", "is a list of labels (.lab), which contains no values"),
        ("a.bin", b"\0\1", "is a raw memory dump (.bin), which contains no addresses. Convert it to Intel HEX"),
    ],
)
def test_calibration_data_that_cannot_be_read_are_named_with_a_way_out(tmp_path, name, raw, message):
    (tmp_path / name).write_bytes(raw)
    with pytest.raises(InputError) as caught:
        read(tmp_path / name)
    assert str(caught.value).startswith(f"{name}: {message}")


def test_a_known_format_is_read_whatever_its_ending(tmp_path):
    write(ONE, tmp_path / "a.dcm")
    (tmp_path / "a.dcm").rename(tmp_path / "a.par")
    assert read(tmp_path / "a.par") == ONE


def test_a_missing_file_is_refused_with_the_nearest_name(tmp_path):
    write(ONE, tmp_path / "start.dcm")
    with pytest.raises(InputError, match=r"there is no such file\. Did you mean start\.dcm\?"):
        read(tmp_path / "strat.dcm")


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path)


SKIPPING = """KONSERVIERUNG_FORMAT 2.0
KENNLINIE C 2
 ST/X 1 1
 WERT 5 6
END
FESTWERT K
 WERT 3
END
"""


def test_a_skipped_table_is_a_warning_in_python(written):
    with pytest.warns(InputWarning, match=r"line 3 \(C\): the x axis neither rises nor falls"):
        assert list(kennfeld.read_parameters(written(SKIPPING))) == ["K"]
    with pytest.warns(InputWarning, match="neither rises nor falls"):
        kennfeld.simulate("y = K * x", {"x": [1.0]}, written(SKIPPING))

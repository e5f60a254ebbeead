"""MATLAB data files of all versions: what MATLAB users save, and what hostile files claim."""

import struct
import zlib
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from kennfeld.calfiles import describe, read, write
from kennfeld.calfiles.matlab_reader import holds_calibration
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Curve, Map, Scalar
from kennfeld.domain.texts import Text
from kennfeld.files.containers import MATLAB
from kennfeld.files.head import FileHead, read_head
from tests.importers.simulink.simulink_data import Thing, matfile

SET = ParameterSet(
    [
        Scalar("K", 0.08, unit="Nm", description="gain"),
        Map("MapX", Axis([1, 2, 3], "n", "rpm", "Speed"), [0, 50], np.arange(6.0).reshape(3, 2), unit="Nm"),
        Block("B", [[1.0], [2.0]]),
        Scalar("a.b[0]", 1.0),
    ],
    [Text("T", "täxt", functions=("f",))],
    [Axis([1, 2, 3], "n", "rpm", "Speed")],
)
PEOPLE = {
    "K": 1.5,
    "row": [1, 2, 3],
    "column": np.array([[1.0], [2.0]]),
    "matrix": np.array([[1, 2], [3, 4]], dtype=np.int16),
    "flag": np.array([[True]]),
    "LUT": {
        "Breakpoints": np.array([{"Value": [1.0, 2.0]}, {"Value": [5.0, 6.0, 7.0]}], dtype=object),
        "Table": {"Value": np.ones((2, 3))},
    },
    "curve": {"x": [1, 2], "Data": [3, 4], "Unit": "Nm"},
    "gov": {"Kp": 0.1, "Ki": 0.2},
    "word": "abc",
    "mixed": np.array([1, "a"], dtype=object),
    "empty": np.zeros((0, 0)),
    "phase": np.array([1 + 2j]),
}


def saved(tmp_path, variables, **options):
    scipy.io.savemat(tmp_path / "start.mat", variables, oned_as="row", **options)
    return tmp_path / "start.mat"


def refused(path):
    with pytest.raises(InputError) as caught:
        read(path)
    return str(caught.value)


@pytest.mark.parametrize("packed", [True, False])
def test_files_of_other_programs_are_read(tmp_path, packed):
    path = saved(tmp_path, PEOPLE, do_compression=packed)
    parameters = read(path)
    assert parameters["K"] == Scalar("K", 1.5)
    assert (parameters["row"].values.tolist(), parameters["column"].values.tolist()) == ([1, 2, 3], [1, 2])
    assert parameters["matrix"].values.tolist() == [[1, 2], [3, 4]]
    assert parameters["flag"].value == 1
    assert parameters["LUT"] == Map("LUT", [1, 2], [5, 6, 7], np.ones((2, 3)))
    assert parameters["curve"] == Curve("curve", [1, 2], [3, 4], unit="Nm")
    assert (parameters["gov.Kp"].value, parameters["gov.Ki"].value) == (0.1, 0.2)
    assert parameters.texts == (Text("word", "abc"),)
    remarks = "\n".join(map(str, describe(path).findings))
    assert "start.mat mixed: is a cell array" in remarks
    assert "start.mat empty: is empty" in remarks
    assert "start.mat phase: is a complex number" in remarks


def test_scipy_reads_the_written_file(tmp_path):
    write(SET, tmp_path / "a.mat")
    contents = scipy.io.loadmat(tmp_path / "a.mat", squeeze_me=True)
    assert contents["K"] == 0.08
    assert contents["MapX"]["values"].item().tolist() == [[0, 1], [2, 3], [4, 5]]
    assert str(contents["a_b_0_"]["name"]) == "a.b[0]"
    assert read(tmp_path / "a.mat") == SET


def test_version_4_is_read(tmp_path):
    path = saved(tmp_path, {"K": 1.5, "M": np.arange(6.0).reshape(2, 3), "word": "abc"}, format="4")
    parameters = read(path)
    assert describe(path).kind == "MATLAB 4"
    assert (parameters["K"].value, parameters["M"].values.tolist(), parameters.texts[0].text) == (
        1.5,
        [[0, 1, 2], [3, 4, 5]],
        "abc",
    )


@pytest.fixture
def newest(tmp_path):
    """Write a file as MATLAB 7.3 does: HDF5 behind a block of 512 bytes, arrays turned, texts as numbers."""

    def make(fill):
        path = tmp_path / "start.mat"
        with h5py.File(path, "w", userblock_size=512) as file:
            fill(file)
        raw = path.read_bytes()
        path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + raw[512:])
        return path

    return make


def put(group, name, value, kind="double", **attributes):
    dataset = group.create_dataset(name, data=value)
    dataset.attrs["MATLAB_class"] = np.bytes_(kind)
    for key, attribute in attributes.items():
        dataset.attrs[key] = attribute
    return dataset


def fill(file):
    put(file, "K", np.array([[1.5]]))
    put(file, "M", np.array([[1.0, 4.0], [2.0, 5.0], [3.0, 6.0]]))  # a matrix of 2 x 3, turned
    put(file, "word", np.array([[97], [98]], dtype=np.uint16), "char")
    put(file, "none", np.zeros(2, dtype=np.uint64), "double", MATLAB_empty=np.int32(1))
    put(file, "object", np.zeros((1, 6), dtype=np.uint32), "Simulink.Parameter", MATLAB_object_decode=np.int32(3))
    table = file.create_group("MapX")
    table.attrs["MATLAB_class"] = np.bytes_("struct")
    put(table, "x", np.array([[1.0], [2.0]]))
    put(table, "values", np.array([[7.0], [8.0]]))
    lookup = file.create_group("LUT")
    put(lookup, "Table", np.ones((3, 2)))
    points = lookup.create_group("Breakpoints")
    hidden = file.create_group("#refs#")
    ends = [put(hidden, "a", np.array([[1.0], [2.0]])), put(hidden, "b", np.array([[1.0], [2.0], [3.0]]))]
    points.create_dataset("Value", data=np.array([end.ref for end in ends], dtype=h5py.ref_dtype))


def test_version_7_3_is_read(newest):
    path = newest(fill)
    parameters = read(path)
    assert parameters["K"].value == 1.5
    assert parameters["M"].values.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert parameters["MapX"] == Curve("MapX", [1, 2], [7, 8])
    assert parameters["LUT"] == Map("LUT", [1, 2], [1, 2, 3], np.ones((2, 3)))
    assert parameters.texts == (Text("word", "ab"),)
    assert any(" object: is a Simulink.Parameter, which only MATLAB" in str(one) for one in describe(path).findings)


def test_a_file_of_7_3_that_claims_gigabytes_is_refused(newest):
    sizes = {"shape": (50_000, 50_000), "dtype": "f8", "chunks": True, "compression": "gzip"}
    assert "/K claims 2500000000 values in 0 bytes" in refused(newest(lambda file: file.create_dataset("K", **sizes)))


def test_recorded_samples_are_not_calibration_data(tmp_path):
    path = saved(tmp_path, {"log": {"time": np.arange(100.0), "n": np.ones(100)}})
    assert "contains recorded samples (log.time), not a calibration. Use it as a dataset file." in refused(path)
    assert not holds_calibration(read_head(path))
    write(SET, path)
    assert holds_calibration(read_head(path))


def test_the_beginning_of_a_file_decides_its_format(tmp_path):
    for version in ("4", "5"):
        raw = saved(tmp_path, {"K": np.ones((200, 200))}, format=version).read_bytes()
        assert MATLAB.recognises(FileHead(Path("a"), raw[:65536]))
    assert not MATLAB.recognises(FileHead(Path("a"), b"\0" * 100))


def packed(content):
    """A file of version 5 with one compressed variable."""
    compressed = zlib.compress(content, 9)
    return (
        b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + b"\0\1IM" + struct.pack("<II", 15, len(compressed)) + compressed
    )


def element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(kind, shape, *rest, name=b"K"):
    sizes = element(5, struct.pack(f"<{len(shape)}i", *shape))
    return element(14, element(6, struct.pack("<II", kind, 0)) + sizes + element(1, name) + b"".join(rest))


def nested(depth):
    inner = matrix(6, (1, 1), element(9, bytes(8)), name=b"")
    for _ in range(depth):
        inner = matrix(1, (1, 1), inner, name=b"K")
    return inner


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (matrix(6, (100_000, 100_000), element(9, bytes(8))), "an array claims 100000 x 100000 values in 8 bytes"),
        (matrix(1, (2_000_000_000, 1)), "an array claims 2000000000 x 1 values"),
        (
            matrix(2, (2_000_000_000, 1), element(5, struct.pack("<i", 4)), element(1, b"abc\0")),
            "an array claims 2000000000 x 1 x 1 values",
        ),
        (matrix(6, (-1, 5), element(9, bytes(8))), "an array claims -1 x 5 values"),
        (matrix(6, (1, 1), element(99, bytes(8))), "stored in an unknown type 99"),
        (nested(60), "arrays are nested more than 50 deep"),
        (struct.pack("<II", 14, 4_000_000_000), "claims 4000000000 bytes"),
    ],
)
def test_hostile_claims_are_refused(tmp_path, content, message):
    path = tmp_path / "a.mat"
    path.write_bytes(packed(content))
    assert message in refused(path)


@pytest.mark.slow
def test_a_variable_that_unpacks_to_gigabytes_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("kennfeld.calfiles.matlab_reader._MAX_UNPACKED_BYTES", 10_000_000)
    path = tmp_path / "a.mat"
    path.write_bytes(packed(matrix(6, (1, 5_000_000), element(9, bytes(40_000_000)))))
    assert path.stat().st_size < 100_000
    assert "claims 40000056 bytes" in refused(path)


def findings(path):
    """Return the message that refuses a file, else its contents; any other exception fails the test."""
    try:
        return (), set(read(path))
    except InputError as error:
        return error.findings, set()


def test_a_file_that_is_cut_off_is_refused(tmp_path):
    write(SET, tmp_path / "a.mat")
    raw = (tmp_path / "a.mat").read_bytes()
    for size in range(120, len(raw) - 1, 7):
        (tmp_path / "b.mat").write_bytes(raw[:size])
        refusal, names = findings(tmp_path / "b.mat")
        assert refusal or names < set(SET)  # cut between two variables


@pytest.mark.parametrize("count", [30, pytest.param(150, marks=pytest.mark.slow)])
def test_damaged_files_of_7_3_are_read_or_refused(newest, count):
    path = newest(fill)
    raw = path.read_bytes()
    generator = np.random.default_rng(7)
    for _ in range(count):
        damaged = bytearray(raw)
        at = int(generator.integers(512, len(raw)))
        damaged[at : at + int(generator.integers(1, 9))] = generator.bytes(int(generator.integers(0, 9)))
        path.write_bytes(bytes(damaged))
        assert all(finding.message for finding in findings(path)[0])


def test_objects_of_parameters_are_read(tmp_path):
    axis = Thing("Simulink.lookuptable.Breakpoint", {"Value": [[700.0, 1500.0]], "Unit": "rpm"})
    table = Thing("Simulink.lookuptable.Table", {"Value": [[1.0, 2.0]], "Unit": "Nm"})
    variables = {
        "P": Thing(
            "Simulink.Parameter", {"Value": 3.0, "Min": 0.0, "Unit": "", "DocUnits": "Nm", "Description": "gain"}
        ),
        "L": Thing("Simulink.LookupTable", {"Table": table, "Breakpoints": [axis]}),
        "S": Thing("Simulink.Parameter", {"Value": {"A": 7.0, "in": {"B": 2.0}}}),
    }
    (tmp_path / "a.mat").write_bytes(matfile(variables))
    parameters = read(tmp_path / "a.mat")
    assert (parameters["S.A"].value, parameters["S.in.B"].value) == (7.0, 2.0)
    assert parameters["P"] == Scalar("P", 3.0, unit="Nm", description="gain")
    assert parameters["L"] == Curve("L", Axis([700, 1500], unit="rpm"), [1, 2], unit="Nm")
    assert describe(tmp_path / "a.mat").findings == ()


def test_a_stream_is_the_same_as_a_file():
    stream = BytesIO()
    scipy.io.savemat(stream, {"K": 1.0})
    assert MATLAB.recognises(FileHead(Path("a"), stream.getvalue()))


def test_the_same_set_gives_the_same_bytes(tmp_path, monkeypatch):
    write(SET, tmp_path / "a.mat")
    before = (tmp_path / "a.mat").read_bytes()
    monkeypatch.setattr("time.time", lambda: 1e9)
    monkeypatch.setattr("time.asctime", lambda *_: "never")
    write(SET, tmp_path / "a.mat")
    assert (tmp_path / "a.mat").read_bytes() == before

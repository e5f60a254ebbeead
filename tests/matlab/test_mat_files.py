"""Data files of versions 4, 5 and 7.3 as a tree: what is in them, and how far damage reaches."""

import random
import struct
import tracemalloc
import zlib
from io import BytesIO

import h5py
import numpy as np
import pytest
import scipy

from kennfeld.matlab.mat_nodes import MatFileError, MatNumbers, MatStruct, MatText, MatUnreadable
from kennfeld.matlab.mat_reader import load_nodes, read_nodes
from kennfeld.matlab.mcos import read_array, read_workspace
from tests.importers.simulink.simulink_data import CELL, CHAR, DOUBLE, STRUCT, array, element, numbers, struct_of, text
from tests.measurement.matlab_files import save73

SPARSE, COMPRESSED, LOGICAL = 5, 15, 0x200


def five(*parts, order="<"):
    """A file of version 5 with these elements."""
    mark = b"\0\1IM" if order == "<" else b"\1\0MI"
    return b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + mark + b"".join(parts)


def packed(content):
    stream = zlib.compress(content, 9)
    return struct.pack("<II", COMPRESSED, len(stream)) + stream


def saved(variables, **options):
    stream = BytesIO()
    scipy.io.savemat(stream, variables, **options)
    return stream.getvalue()


def sparse(shape, rows, starts, values, flags=0):
    head = element(6, struct.pack("<II", SPARSE | flags, 0)) + element(5, np.array(shape, "<i4").tobytes())
    parts = [element(5, np.array(integers, "<i4").tobytes()) for integers in (rows, starts)]
    return element(14, head + element(1, b"z") + b"".join(parts) + element(9, np.array(values, "<f8").tobytes()))


SPARSE_VALUES = np.array([[0.0, 2.0, 0.0], [3.0, 0.0, -1.5]])


def save_sparse73(path, full, name="z"):
    """A sparse matrix as MATLAB lays it out in HDF5: no rows nor numbers where all of it is 0."""
    save73(path, {"K": 1.0})
    compressed = scipy.sparse.csc_array(full)
    with h5py.File(path, "r+") as file:
        group = file.create_group(name)
        group.attrs["MATLAB_class"], group.attrs["MATLAB_sparse"] = np.bytes_("double"), np.uint64(full.shape[0])
        group["jc"] = compressed.indptr.astype(np.uint64)
        if compressed.nnz:
            group["ir"], group["data"] = compressed.indices.astype(np.uint64), compressed.data
    return path.read_bytes()


@pytest.mark.parametrize("options", [{"format": "4"}, {}, {"do_compression": True}])
def test_sparse_matrices_are_written_out(options):
    nodes = read_nodes(
        saved({"z": scipy.sparse.csc_array(SPARSE_VALUES), "empty": scipy.sparse.csc_array((2, 3))}, **options)
    )
    np.testing.assert_array_equal(nodes["z"].values, SPARSE_VALUES)
    np.testing.assert_array_equal(nodes["empty"].values, np.zeros((2, 3)))


@pytest.mark.parametrize("full", [SPARSE_VALUES, np.zeros((2, 3))])
def test_sparse_matrices_of_the_newest_version_are_written_out(full, tmp_path):
    np.testing.assert_array_equal(read_nodes(save_sparse73(tmp_path / "a.mat", full))["z"].values, full)


def test_sparse_logical_arrays_stay_logical():
    node = read_nodes(five(sparse((2, 2), [1], [0, 1, 1], [1.0], LOGICAL)))["z"]
    assert (node.kind, node.whole, node.values.tolist()) == ("logical", True, [[0, 0], [1, 0]])


def test_sparse_logical_arrays_may_be_bytes_that_are_labelled_as_doubles():
    """MATLAB saves them so."""
    content = bytearray(sparse((3, 2), [0, 2, 1], [0, 2, 3], [], LOGICAL)[8:-8])
    array = read_nodes(five(element(14, bytes(content) + struct.pack("<II", 9, 3) + b"\1\1\1".ljust(8, b"\0"))))["z"]
    assert array.values.tolist() == [[1, 0], [0, 1], [1, 0]]


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (((2, 2), [2], [0, 1, 1], [1.0]), "rows of a sparse matrix"),
        (((2, 2), [-1], [0, 1, 1], [1.0]), "rows of a sparse matrix"),
        (((2, 2), [0], [0, 2, 2], [1.0]), "rows of a sparse matrix"),
        (((2, 2), [0], [0, 1], [1.0]), "columns of a sparse matrix"),
        (((2, 2), [0], [1, 1, 1], [1.0]), "columns of a sparse matrix"),
        (((2, 2), [0], [0, 1, 0], [1.0]), "columns of a sparse matrix"),
        (((2, 2, 2), [0], [0, 1, 1], [1.0]), "unknown form"),
    ],
)
def test_sparse_matrices_that_do_not_fit_together_are_refused(parts, message):
    with pytest.raises(MatFileError, match=message):
        read_nodes(five(sparse(*parts)))


def test_sparse_matrices_take_no_more_memory_than_they_deserve():
    tracemalloc.start()
    try:
        nodes = read_nodes(five(sparse((2_000_000_000, 1), [0], [0, 1], [1.0])))
        triples = saved({"z": np.array([[1.0, 1.0, 1.0], [2e9, 2e9, 0.0]])}, format="4")
        old = read_nodes(struct.pack("<i", 2) + triples[4:])
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()
    assert nodes["z"] == old["z"] == MatUnreadable("sparse matrix")


@pytest.mark.parametrize(
    ("triples", "message"),
    [
        ([[3.0, 1.0, 1.0], [2.0, 2.0, 0.0]], "are inconsistent"),
        ([[0.5, 1.0, 1.0], [2.0, 2.0, 0.0]], "are inconsistent"),
        ([[np.nan, 1.0, 1.0], [2.0, 2.0, 0.0]], "are inconsistent"),
        ([[1.0, 1.0, 1.0], [-2.0, 2.0, 0.0]], "are inconsistent"),
        ([[1.0, 1.0]], "are inconsistent"),
    ],
)
def test_sparse_matrices_of_version_4_that_do_not_fit_are_refused(triples, message):
    with pytest.raises(MatFileError, match=message):
        read_nodes(struct.pack("<i", 2) + saved({"z": np.array(triples)}, format="4")[4:])


@pytest.mark.parametrize("version", ["4", "5"])
def test_complex_numbers_are_reported(version):
    nodes = read_nodes(saved({"z": np.array([[1 + 2j]]), "K": 1.0}, format=version))
    assert nodes["z"] == MatUnreadable("complex numbers")
    assert nodes["K"].values.tolist() == [[1.0]]
    assert read_nodes(saved({"z": scipy.sparse.csc_array(np.array([[1 + 2j]]))}, format=version))["z"] == MatUnreadable(
        "complex numbers"
    )


@pytest.mark.parametrize("kind", [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)])
def test_integers_of_all_kinds_keep_their_kind(kind):
    extremes = np.array([[np.iinfo(kind).min, 5, np.iinfo(kind).max]], dtype=kind)
    node = read_nodes(saved({"k": extremes}))["k"]
    assert (node.kind, node.whole, node.values.tolist()) == (kind, True, extremes.tolist())


def test_files_of_the_other_byte_order_are_read():
    def part(kind, raw):
        return struct.pack(">II", kind, len(raw)) + raw + bytes(-len(raw) % 8)

    head = part(6, struct.pack(">II", DOUBLE, 0)) + part(5, struct.pack(">ii", 1, 2)) + part(1, b"K")
    word = part(6, struct.pack(">II", CHAR, 0)) + part(5, struct.pack(">ii", 1, 2)) + part(1, b"w")
    written = part(14, head + part(9, struct.pack(">dd", 2.5, -4))) + part(
        14, word + part(17, "aé".encode("utf-16-be"))
    )
    nodes = read_nodes(five(written, order=">"))
    assert (nodes["K"].values.tolist(), nodes["w"]) == ([[2.5, -4]], MatText("aé"))


def test_a_header_may_say_anything_before_the_mark_of_its_byte_order():
    assert read_nodes(b"written by a test".ljust(124) + five()[124:] + numbers([[2.5]], name="K"))["K"].values == 2.5


@pytest.mark.parametrize("version", ["4", "5", "7.3"])
def test_rows_of_characters_stay_rows(version, tmp_path):
    if version == "7.3":
        save73(tmp_path / "a.mat", {"name": "x"})
        with h5py.File(tmp_path / "a.mat", "r+") as file:
            del file["name"]
            file["name"] = np.array([[ord(letter) for letter in row] for row in ("ab", "cd", "e ")], np.uint16).T
            file["name"].attrs["MATLAB_class"] = np.bytes_("char")
        node = read_nodes((tmp_path / "a.mat").read_bytes())["name"]
    else:
        node = read_nodes(saved({"name": np.array(["ab", "cd", "e "])}, format=version))["name"]
    assert (node.rows, node.text) == (("ab", "cd", "e"), "ab\ncd\ne")


def test_a_line_end_within_a_text_makes_no_rows():
    assert read_nodes(five(text("one\ntwo", "note")))["note"] == MatText("one\ntwo")


def broken(name):
    """An array that has fewer numbers than it claims."""
    return array(DOUBLE, (3, 3), element(9, bytes(8)), name=name)


def test_a_damaged_variable_does_not_take_the_others_with_it():
    content = five(numbers([[1.0]], name="A"), broken("B"), numbers([[3.0]], name="C"))
    loaded = load_nodes(content)
    assert loaded.variables["B"] == MatUnreadable("damaged value", why="an array claims 3 x 3 values in 8 bytes")
    assert [loaded.variables[name].values.item() for name in "AC"] == [1.0, 3.0]
    assert (loaded.damage, loaded.lost) == ("an array claims 3 x 3 values in 8 bytes", "")
    with pytest.raises(MatFileError, match="claims 3 x 3 values"):
        read_nodes(content)


def test_damage_within_a_struct_stays_within_its_field():
    loaded = load_nodes(five(struct_of({"a": numbers([[1.0]]), "b": broken(""), "c": text("x")}, name="S")))
    fields = loaded.variables["S"].fields
    assert (fields["a"].values.item(), fields["c"]) == (1.0, MatText("x"))
    assert isinstance(fields["b"], MatUnreadable)
    assert loaded.damage


def test_a_corrupt_compressed_variable_does_not_affect_the_others():
    garbled = bytearray(packed(numbers(np.arange(50.0), name="B")))
    garbled[40] ^= 255
    loaded = load_nodes(five(packed(numbers([[1.0]], name="A")), bytes(garbled), packed(numbers([[3.0]], name="C"))))
    assert set(loaded.variables) == {"A", "C"}
    assert "compressed element at byte" in loaded.lost


@pytest.mark.parametrize("version", ["4", "5"])
def test_the_variables_before_a_cut_are_read(version):
    content = saved({"A": 1.0, "B": np.arange(100.0)}, format=version)
    loaded = load_nodes(content[:-40])
    assert loaded.variables["A"].values.item() == 1.0
    assert "claims" in loaded.lost
    assert set(loaded.variables) == {"A"}


def test_a_damaged_variable_of_the_newest_version_does_not_take_the_others_with_it(tmp_path):
    content = save_sparse73(tmp_path / "a.mat", SPARSE_VALUES)
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file["z/ir"][0] = 7
    content = (tmp_path / "a.mat").read_bytes()
    loaded = load_nodes(content)
    assert (loaded.variables["K"].values.item(), loaded.lost) == (1.0, "")
    assert "rows of a sparse matrix" in loaded.variables["z"].why
    assert "truncated" in load_nodes(content[: len(content) // 2]).lost


@pytest.mark.parametrize("content", [b"", b"no data file at all, but a text", b"\0" * 19 + b"\1", b"short"])
def test_invalid_data_files_are_rejected(content):
    with pytest.raises(MatFileError):
        read_nodes(content)


@pytest.mark.parametrize("shape", [(1,), (), (1,) * 40])
def test_sizes_that_no_array_has_are_refused(shape):
    with pytest.raises(MatFileError, match="dimensions"):
        read_nodes(five(array(DOUBLE, shape, element(9, bytes(8)), name="K")))
    with pytest.raises(MatFileError, match="claims 0 x 2147483647"):
        read_nodes(five(array(DOUBLE, (0, 2**31 - 1, 2**31 - 1), element(9, b""), name="K")))


def test_a_bomb_of_compressed_zeros_is_rejected_and_variables_before_it_are_read():
    bomb = packed(numbers(np.zeros(3_000_000), name="B"))
    tracemalloc.start()
    try:
        loaded = load_nodes(five(packed(numbers([[1.0]], name="A")), *[bomb] * 3), 10_000_000)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()
    assert set(loaded.variables) == {"A"}
    assert "claims 24000056 bytes" in loaded.lost


def test_a_packed_array_may_lack_the_end_of_its_stream():
    packer = zlib.compressobj()
    stream = packer.compress(numbers(np.arange(50.0), name="K")) + packer.flush(zlib.Z_SYNC_FLUSH)
    nodes = read_nodes(five(struct.pack("<II", COMPRESSED, len(stream)) + stream))
    np.testing.assert_array_equal(nodes["K"].values, [np.arange(50.0)])
    with pytest.raises(MatFileError, match=r"corrupt|truncated"):
        read_nodes(five(struct.pack("<II", COMPRESSED, 40) + stream[:40]))


def test_more_arrays_are_read_if_requested():
    content = five(array(CELL, (120_000, 1), *[element(14, b"")] * 120_000, name="c"))
    assert "claims 120000 x 1 values" in load_nodes(content).variables["c"].why
    content = five(array(CELL, (1_200, 1), *[element(14, b"")] * 1_200, name="c"))
    assert "claims 1200 x 1 values" in load_nodes(content, max_nodes=1_000).variables["c"].why
    assert len(load_nodes(content, max_nodes=2_000).variables["c"].cells) == 1_200


def test_compressed_arrays_share_the_size_limit():
    one = packed(numbers(np.zeros(100_000), name="A"))
    loaded = load_nodes(five(one, packed(numbers(np.zeros(100_000), name="B"))), 1_000_000)
    assert set(loaded.variables) == {"A"}
    assert "claims 800056 bytes" in loaded.lost


@pytest.mark.parametrize("kind", [CELL, STRUCT])
def test_arrays_of_nothing_are_counted(kind):
    names = (element(5, struct.pack("<i", 8)), element(1, b"")) if kind == STRUCT else ()
    many = [array(kind, (600, 1), *names, *[element(14, b"")] * (600 if kind == CELL else 0), name=n) for n in "ab"]
    loaded = load_nodes(five(*many), max_nodes=1_000)
    assert set(loaded.variables) == {"a"}
    assert "more than 1000 arrays" in loaded.lost


def test_an_array_without_a_header_is_read():
    node = read_array(b"\0\1IM\0\0\0\0" + numbers(np.arange(6.0).reshape(2, 3)))
    np.testing.assert_array_equal(node.values, np.arange(6.0).reshape(2, 3))
    assert read_array(b"\0\1IM\0\0\0\0" + packed(text("x"))) == MatText("x")


@pytest.mark.parametrize("content", [b"", b"\0\1IM\0\0\0\0", b"\0\1IM\0\0\0\0" + numbers([[1.0]])[:-4], b"a" * 90])
def test_bytes_without_an_array_are_rejected(content):
    with pytest.raises(MatFileError):
        read_array(content)


def test_a_damaged_variable_of_a_workspace_does_not_take_the_others_with_it():
    loaded = read_workspace(b"\0\1IM\0\0\0\0" + struct_of({"A": numbers([[1.0]]), "B": broken("")}))
    assert loaded.variables["A"].values.item() == 1.0
    assert isinstance(loaded.variables["B"], MatUnreadable)
    assert loaded.damage
    assert not loaded.lost


@pytest.mark.parametrize("version", ["4", "5", "7"])
def test_corrupt_files_are_read_as_far_as_possible(version):
    contents = {
        "A": np.arange(9.0),
        "S": {"a": 1, "b": "x"},
        "z": scipy.sparse.csc_array(SPARSE_VALUES),
        "name": np.array(["ab", "cd"]),
    }
    if version == "4":
        del contents["S"]
    whole, chance = (
        saved(contents, format="4" if version == "4" else "5", do_compression=version == "7"),
        random.Random(5),
    )
    read = 0
    for _ in range(500):
        raw = bytearray(whole)
        for _ in range(chance.choice((1, 2, 8))):
            raw[chance.randrange(0 if version == "4" else 128, len(raw))] = chance.choice(
                (0, 1, 14, 255, chance.randrange(256))
            )
        if chance.random() < 0.2:
            del raw[chance.randrange(130, len(raw)) :]
        nodes_by_name = load_nodes(bytes(raw), 10_000_000).variables
        read += any(isinstance(node, MatNumbers | MatText | MatStruct) for node in nodes_by_name.values())
    assert read > 150

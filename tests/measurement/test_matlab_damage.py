"""MATLAB files that are cut, garbled or hostile: findings or data, and no more memory than they deserve."""

import contextlib
import random
import struct
import tracemalloc
import zlib

import h5py
import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.matlab_files import HEAD, array5, element, file5, save73
from tests.measurement.mutants import few_or_many_copies

TIME = np.arange(20) * 0.1
VARIABLES = {"time": TIME, "Speed": TIME * 1000, "log": {"a": TIME, "b": {"c": TIME > 1}}, "note": "a test"}


@pytest.fixture
def mat(tmp_path):
    """Writes bytes."""

    def write(content):
        path = tmp_path / "bench.mat"
        path.write_bytes(content)
        return path

    return write


def refused(path, words):
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=words):
            read(path)
        assert tracemalloc.get_traced_memory()[1] < 50_000_000
    finally:
        tracemalloc.stop()


def contents(tmp_path, form):
    path = tmp_path / "whole.mat"
    if form == "7.3":
        save73(path, VARIABLES)
    elif form == "4":
        scipy.io.savemat(path, {"time": TIME, "Speed": TIME * 1000}, format="4")
    else:
        scipy.io.savemat(path, VARIABLES, do_compression=form == "7")
    return path.read_bytes()


@few_or_many_copies
@pytest.mark.parametrize("form", ["4", "5", "7", "7.3"])
def test_mutated_files_give_data_or_findings(tmp_path, mat, form, count):
    chance = random.Random(23)
    whole = contents(tmp_path, form)
    for _ in range(count):
        changed = bytearray(whole)
        for _ in range(chance.randint(1, 4)):
            at = chance.randrange(len(changed))
            changed[at] = chance.choice([0, 1, 14, 127, 255, changed[at] ^ 1 << chance.randrange(8)])
        if chance.random() < 0.3:
            del changed[chance.randrange(len(changed)) :]
        path = mat(bytes(changed))
        with contextlib.suppress(InputError):
            assert read(path, raster=0.1).samples
            describe(path)


def test_arrays_within_arrays_without_end_are_refused(mat):
    inner = array5(6, element(9, struct.pack("<d", 1.0)))
    for _ in range(3_000):
        inner = array5(1, inner)
    refused(mat(file5(inner)), "nested more than 50 deep")
    packed = zlib.compress(inner)
    refused(mat(file5(struct.pack("<II", 15, len(packed)) + packed)), "nested more than 50 deep")


@pytest.mark.parametrize("kind", [1, 2, 6, 9])
def test_an_array_that_claims_too_much_is_refused(mat, kind):
    names = element(5, struct.pack("<i", 8)) + element(1, b"field".ljust(8, b"\0")) if kind == 2 else b""
    path = mat(file5(array5(kind, names + element(9, b"\0" * 64), b"x", (1_000_000_000, 2))))
    refused(path, r"claims 1000000000 x 2( x 1)? values")


def test_a_packed_array_that_claims_more_than_packing_allows_is_refused(mat):
    packed = zlib.compress(struct.pack("<II", 14, 4_000_000_000) + b"\0" * 100)
    refused(mat(file5(struct.pack("<II", 15, len(packed)) + packed)), "claims 4000000000 bytes in")


def many_empty_arrays():
    inner = array5(1, struct.pack("<II", 14, 0) * 99_000, b"", (1, 99_000))
    packed = zlib.compress(array5(1, inner * 2, b"c", (1, 2)))
    return file5(struct.pack("<II", 15, len(packed)) + packed)


@pytest.mark.slow
def test_many_empty_arrays_are_refused(mat):
    with pytest.raises(InputError, match="more than 100000 arrays"):
        read(mat(many_empty_arrays()))


@pytest.mark.slow
def test_many_empty_arrays_are_refused_before_they_take_memory(mat):
    refused(mat(many_empty_arrays()), "more than 100000 arrays")


def test_version_4_that_claims_too_much_is_refused(mat):
    refused(mat(struct.pack("<5i", 0, 500_000_000, 1, 0, 2) + b"x\0" + b"\0" * 80), "claims 500000000 x 1 values")


def test_version_73_that_claims_too_much_is_refused(tmp_path):
    path = tmp_path / "bench.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        dataset = file.create_dataset("x", (1, 400_000_000), "f8", chunks=(1, 1_000_000))
        dataset.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as stream:
        stream.write(HEAD)
    refused(path, "claims 400000000 values in 0 bytes")


def test_version_73_that_refers_to_itself_is_refused(tmp_path):
    path = tmp_path / "bench.mat"
    save73(path, {"time": TIME})
    with h5py.File(path, "r+") as file:
        dataset = file.create_dataset("#refs#/loop", (1, 2), h5py.ref_dtype)
        dataset.attrs["MATLAB_class"] = np.bytes_("cell")
        dataset[0, 0] = dataset[0, 1] = dataset.ref
        file["c"] = dataset
    refused(path, "nested more than 50 deep|more than 100000 arrays")


def test_links_to_other_files_are_not_followed(tmp_path):
    path = tmp_path / "bench.mat"
    save73(tmp_path / "other.mat", {"Secret": TIME})
    save73(path, {"time": TIME, "Speed": TIME})
    with h5py.File(path, "r+") as file:
        file["Secret"] = h5py.ExternalLink("other.mat", "/Secret")
        file["Soft"] = h5py.SoftLink("/Speed")
    assert list(read(path)) == ["Speed"]


def test_a_truncated_hdf5_file_is_refused(tmp_path):
    path = tmp_path / "bench.h5"
    with h5py.File(path, "w") as file:
        file["Speed"] = TIME
    path.write_bytes(path.read_bytes()[:100])
    refused(path, "the HDF5 file is damaged or cut off")


def test_an_object_of_version_73_is_reported(tmp_path):
    path = tmp_path / "bench.mat"
    save73(path, {"time": TIME, "Speed": TIME})
    with h5py.File(path, "r+") as file:
        file["log"] = np.zeros((1, 6), dtype=np.uint32)
        file["log"].attrs["MATLAB_class"] = np.bytes_("timetable")
        file["log"].attrs["MATLAB_object_decode"] = np.int32(3)
        group = file.create_group("sparse")
        group.attrs["MATLAB_class"], group.attrs["MATLAB_sparse"] = np.bytes_("double"), np.uint64(3)
    assert describe(path).tables[0].details == {"only for MATLAB": "log (timetable), sparse (sparse matrix)"}

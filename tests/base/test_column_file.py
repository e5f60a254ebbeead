"""Files of columns: what is written is read again, and everything else is not read at all."""

import os

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kennfeld.base.column_file import read_columns, write_columns
from tests.draws import few_or_many

KINDS = (np.float64, np.int64, np.uint32, np.bool_)
columns = st.lists(st.one_of(arrays(kind, st.integers(0, 50)) for kind in KINDS), max_size=5)


@few_or_many(columns, few=20, many=100)
def test_columns_are_read_as_they_were_written(tmp_path_factory, written):
    path = tmp_path_factory.mktemp("columns") / "folder" / "file.columns"
    write_columns(path, iter(written), {"name": "drive é", "rows": [1, None, 2.5]})
    contents = read_columns(path)
    assert contents.notes == {"name": "drive é", "rows": [1, None, 2.5]}
    for before, after in zip(written, contents.columns, strict=True):
        assert after.dtype == before.dtype
        assert np.array_equal(after, before, equal_nan=before.dtype == np.float64)
        assert not after.flags.writeable
        assert after.ctypes.data % 64 == 0 or not after.size


@pytest.mark.parametrize("damage", [lambda b: b[:-1], lambda b: b[1:], lambda b: b"", lambda b: b"PAR1" * 20])
def test_damaged_files_are_not_read(tmp_path, damage):
    path = tmp_path / "file.columns"
    write_columns(path, [np.arange(5.0)], {})
    path.write_bytes(damage(path.read_bytes()))
    assert read_columns(path) is None
    assert read_columns(tmp_path / "missing.columns") is None


def test_a_failed_writing_leaves_the_file_as_it_was(tmp_path):
    path = tmp_path / "file.columns"
    write_columns(path, [np.arange(5.0)], {})

    def failing():
        yield np.arange(9.0)
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_columns(path, failing(), {})
    assert np.array_equal(read_columns(path).columns[0], np.arange(5.0))
    assert [entry.name for entry in tmp_path.iterdir()] == ["file.columns"]


@pytest.mark.parametrize("place", [3, 100, -60, -30])
def test_one_flipped_bit_anywhere_is_noticed(tmp_path, place):
    path = tmp_path / "file.columns"
    write_columns(path, [np.arange(5.0), np.arange(9)], {"name": "drive"})
    assert read_columns(path) is not None
    content, times = bytearray(path.read_bytes()), path.stat()
    content[place] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert read_columns(path) is None


@pytest.mark.parametrize("kept", [0, 40])
def test_a_file_that_lost_its_end_to_a_power_failure_is_noticed(tmp_path, kept):
    path = tmp_path / "file.columns"
    write_columns(path, [np.arange(5.0), np.arange(9)], {"name": "drive"})
    content = path.read_bytes()
    path.write_bytes(content[:kept] + bytes(len(content) - kept))  # its size is right
    assert read_columns(path) is None
    path.write_bytes(content[:kept])
    assert read_columns(path) is None

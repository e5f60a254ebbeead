import gzip

import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.measurement.channel_groups import split_timelines
from kennfeld.measurement.delimited import first_lines, read_delimited
from kennfeld.measurement.source import locate
from kennfeld.measurement.table import Selection
from kennfeld.measurement.time_column import find_time, time_in_seconds

LOG = "ACME 1\nmade on a bench\n0,5;1;\n1,0;;7\n"


def source_of(folder, content, name="a.csv"):
    path = folder / name
    path.write_bytes(content)
    return locate(path)


def test_cells_become_columns_with_units(tmp_path):
    source = source_of(tmp_path, LOG.encode())
    (table,) = read_delimited(source, Selection(), ["t", "x", "y"], ["s", "V", ""], skip=2, separator=";", decimal=",")
    assert [(column.name, column.unit) for column in table.columns] == [("t", "s"), ("x", "V"), ("y", "")]
    np.testing.assert_array_equal(
        [column.values for column in table.columns], [[0.5, 1.0], [1.0, np.nan], [np.nan, 7.0]]
    )
    assert table.findings == ()


def test_compressed_text_in_another_encoding_is_read(tmp_path):
    source = source_of(tmp_path, gzip.compress("Öl\n1 2\n".encode("cp1252")), "a.csv.gz")
    assert first_lines(source, 5) == ["Öl", "1 2"]
    (table,) = read_delimited(source, Selection(("b",)), ["a", "b"], skip=1)
    assert [column.name for column in table.columns] == ["b"]


def test_rows_of_another_length_are_reported_with_their_lines(tmp_path):
    source = source_of(tmp_path, b"a b\n1 2\n1 2 3\n\n1\n1 2\n")
    (table,) = read_delimited(source, Selection(), ["a", "b"], skip=1)
    assert [finding.location.line for finding in table.findings] == [3, 5]


def test_a_file_without_rows_is_an_error(tmp_path):
    with pytest.raises(InputError, match=r"a\.csv: there are no rows below line 1"):
        read_delimited(source_of(tmp_path, b"a b\n\n"), Selection(), ["a", "b"], skip=1)


def test_units_are_as_many_as_names(tmp_path):
    with pytest.raises(ArgumentError, match=r"units=\['V'\] must be as many as the 2 names"):
        read_delimited(source_of(tmp_path, b"1 2\n"), Selection(), ["a", "b"], ["V"], skip=0)


RASTERS = b"0;0;0;20\n0,05;1;200;21\n0,1;2;;\n0,2;4;;\n"
NAMES, UNITS = ["fast", "n", "slow", "T"], ["s", "rpm", "ms", "degC"]


def rasters(folder, column_units=UNITS, times=("fast", "slow"), **selected):
    source = source_of(folder, RASTERS)
    selection = Selection(**selected)
    (table,) = read_delimited(source, selection, NAMES, column_units, skip=0, times=times, separator=";", decimal=",")
    return split_timelines(table, selection)


def test_times_of_any_name_begin_rasters_of_their_own(tmp_path):
    fast, slow = rasters(tmp_path)
    assert [column.name for column in fast.columns] == ["fast", "n"]
    assert time_in_seconds(find_time(slow)).tolist() == [0, 0.2]
    (slow,) = rasters(tmp_path, channels=("T",))
    assert [column.name for column in slow.columns] == ["slow", "T"]


def test_a_time_in_another_unit_is_reported_unless_the_caller_states_one(tmp_path):
    units = ["s", "rpm", "ticks", "degC"]
    fast, _ = rasters(tmp_path, units)
    assert [str(each) for each in fast.findings] == [
        "a.csv column slow: 'ticks' is not a unit of time. Write s, ms, us, ns, min, h or d."
    ]
    assert not rasters(tmp_path, units, units={"slow": "ms"})[0].findings


@pytest.mark.parametrize("times", [["slow"], ["fast", "clock"]])
def test_times_are_columns_and_one_of_them_is_the_first(times, tmp_path):
    with pytest.raises(
        ArgumentError, match=r"must be names of columns, and the first column, fast, must be one of them"
    ):
        rasters(tmp_path, times=times)

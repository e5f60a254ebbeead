import gzip

import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.measurement.delimited import first_lines, read_delimited
from kennfeld.measurement.source import locate
from kennfeld.measurement.table import Selection

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

"""Tables of numbers read by machine code in several parts, against the exact reader."""

import random

import numpy as np
import pytest

from kennfeld.measurement import plain_csv, text
from kennfeld.measurement.bulk_csv import read_bulk
from kennfeld.measurement.source import locate
from kennfeld.measurement.table import Selection

GAPS = ["", "nan", "NaN", "-", "N/A", "null"]


@pytest.fixture(autouse=True)
def no_arrow(monkeypatch):
    """Leave what the compiled code does not read to the exact reader, and split small files into parts, too."""
    monkeypatch.setattr("kennfeld.measurement.bulk_csv._read_mixed", lambda *_: None)
    monkeypatch.setattr(plain_csv, "_PART", 1000)


def tables(path, channels=None):
    source, selection = locate(path), Selection(channels)
    dialect = text.detect_dialect(source)
    return read_bulk(source, dialect, selection), text.read_exactly(source, dialect, selection)


def written(separator=",", decimal=".", end="\n", rows=500):
    numbers = random.Random(3)

    def cell():
        if numbers.random() < 0.1:
            return numbers.choice(GAPS)
        form = numbers.choice(["{:.6f}", "{!r}", "{:.3e}", "{:.0f}", "{:+.2f}", "{:.25f}", "inf"])
        return form.format(numbers.gauss(0, 1e3)).replace(".", decimal)

    lines = [[f"{k}", *(cell() for _ in range(4))] for k in range(rows)]
    return end.join(separator.join(line) for line in [["time", "a", "b", "c", "d"], *lines]) + end


@pytest.mark.parametrize("separator", [",", ";", "\t", "|"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("decimal", [".", ","])
def test_numbers_and_gaps_are_as_read_line_by_line(csv, separator, end, decimal):
    bulk, exact = tables(csv(written(separator, "." if separator == "," else decimal, end)))
    assert [column.name for column in bulk.columns] == [column.name for column in exact.columns]
    for ours, theirs in zip(bulk.columns, exact.columns, strict=True):
        np.testing.assert_array_equal(ours.values, theirs.values, strict=True)
    assert bulk.rows.tolist() == exact.rows.tolist()


@pytest.mark.parametrize("size", range(1, 200, 7))
def test_parts_end_with_lines_whatever_their_size(csv, monkeypatch, size):
    monkeypatch.setattr(plain_csv, "_PART", size)
    bulk, exact = tables(csv(written(rows=60).rstrip("\n")))
    for ours, theirs in zip(bulk.columns, exact.columns, strict=True):
        np.testing.assert_array_equal(ours.values, theirs.values, strict=True)


def test_columns_that_are_not_read_may_hold_text(csv):
    rows = "".join(f"{k};start at {k};{k + 0.5}\n" for k in range(300))
    bulk, _ = tables(csv(f"time;note;Speed\n{rows}"), ("Speed",))
    assert [column.name for column in bulk.columns] == ["time", "Speed"]
    assert bulk.columns[1].values.tolist() == [k + 0.5 for k in range(300)]


@pytest.mark.parametrize("cell", ['"a;b"', "a\rb", "a;b"])
def test_unbalanced_text_in_columns_that_are_not_read_is_left_to_the_other_readers(csv, cell):
    rows = "".join(f"{k};{cell if k == 280 else 'ok'};{k + 0.5}\n" for k in range(300))
    assert tables(csv(f"time;note;Speed\n{rows}"), ("Speed",))[0] is None


def test_very_many_unusual_cells_are_left_to_the_other_readers(csv, monkeypatch):
    path = csv("time,a\n" + "1,-\n" * 300)
    assert tables(path)[0] is not None
    monkeypatch.setattr(plain_csv, "_MOST_ODD", 10)
    assert tables(path)[0] is None

"""Reader of delimited text whose columns hold nothing but numbers and gaps, by machine code on all processors."""

import itertools
from concurrent.futures import Executor
from threading import Event

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.measurement.cells import Decimal, is_truth, parse_number
from kennfeld.measurement.csv_body import CsvBody, count_lines
from kennfeld.measurement.number_code import ODD_FIELDS, PADDING, compile_parser, powers_of_ten

_PART = 1 << 23  # bytes that a thread reads at once
_MOST_ODD = 4096  # cells of a part that Python parses one by one


def read_numbers(body: CsvBody, pool: Executor) -> dict[int, Float] | None:
    """Read the columns of `body.types`, Float[rows] by their number; None if a row or a cell does not fit.

    Each value is the double nearest to the number in the text. No byte within a character of the encoding may be equal
    to the separator.
    """
    parts = body.split(max(len(body.data) // _PART, 1))
    # the parser may load bytes behind a part, which the next one has to hold
    if len(parts[-1]) < PADDING:
        parts = [body.data]
    counts = list(pool.map(count_lines, parts))
    ends = list(itertools.accumulate(counts))
    # threads write into rows of their own, as the lines before each part are counted
    columns = {i: np.empty(ends[-1]) for i in body.types}

    compile_parser()  # once, before the threads call it
    failed = Event()

    def read(number: int) -> bool:
        if failed.is_set():
            return False
        part = _pad(parts[number]) if number == len(parts) - 1 else parts[number]
        rows = slice(ends[number] - counts[number], ends[number])
        fits = _read_part(part, body, {i: values[rows] for i, values in columns.items()})
        body.release(parts[number])
        if not fits:
            failed.set()
        return fits

    return columns if all(pool.map(read, range(len(parts)))) else None


def _pad(part: memoryview) -> memoryview:
    """Return a copy that ends with a line feed, with `PADDING` bytes behind it."""
    text = bytes(part).removesuffix(b"\n") + b"\n"
    return memoryview(text + bytes(PADDING))[: len(text)]


def _read_part(part: memoryview, body: CsvBody, columns: dict[int, Float]) -> bool:
    """Fill the columns with the numbers of whole lines; return whether all rows and cells fit."""
    text = np.frombuffer(part, np.uint8)
    addresses = np.zeros(body.width, dtype=np.int64)
    for column, values in columns.items():
        addresses[column] = values.ctypes.data
    odd = np.empty((_MOST_ODD, ODD_FIELDS), dtype=np.int64)
    state, powers = np.empty(1, dtype=np.int64), powers_of_ten()
    compile_parser()(
        *(text.ctypes.data, text.size, addresses.ctypes.data, body.width),
        *(ord(body.dialect.separator), ord(body.dialect.decimal)),
        *(odd.ctypes.data, _MOST_ODD, powers.ctypes.data, state.ctypes.data),
    )
    count = int(state[0])
    return count >= 0 and _parse_odd(part, odd[:count], body.dialect.decimal, columns)


def _parse_odd(part: memoryview, odd: Int, decimal: Decimal, columns: dict[int, Float]) -> bool:
    """Parse cells such as `-`, `N/A`, `inf` or 30 digits one by one; return whether all are numbers or gaps."""
    for row, column, begin, end in odd.tolist():
        cell = bytes(part[begin:end]).decode("ascii", "replace")
        value = parse_number(cell, decimal)
        # a switch among numbers makes a column of another type
        if value is None or is_truth(cell):
            return False
        columns[column][row] = value
    return True

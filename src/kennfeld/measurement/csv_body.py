"""The rows of a large text file, in parts of whole lines for several threads."""

import itertools
import mmap

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.csv_dialect import Dialect

_WINDOW = 4096  # bytes that are searched at once for the end of a line
_CHUNK = 1 << 24
_LINE_FEED = ord("\n")


@dataclass(frozen=True)
class CsvBody:
    """The rows of a table below its header."""

    data: memoryview
    dialect: Dialect
    width: int  # cells of a row
    types: dict[int, str]  # of the columns to read, as Arrow calls them: "double", "bool", or "binary" for text

    def split(self, count: int) -> list[memoryview]:
        """Return at most so many parts of similar size, each of whole lines."""
        # a line longer than a part puts several ends at one place
        ends = {_line_end(self.data, len(self.data) * k // count) for k in range(1, count)} | {len(self.data)}
        bounds = [0, *sorted(ends)]
        return [self.data[begin:end] for begin, end in itertools.pairwise(bounds)]

    def release(self, part: memoryview) -> None:
        """Take a part out of the memory of this process; reading it again loads it again."""
        file = self.data.obj
        if isinstance(file, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
            begin = _address(part) - _address(memoryview(file))
            # `madvise` takes whole pages
            start = begin - begin % mmap.PAGESIZE
            file.madvise(mmap.MADV_DONTNEED, start, begin + len(part) - start)


def _address(data: memoryview) -> int:
    return int(np.frombuffer(data, np.uint8).ctypes.data)


def _line_end(data: memoryview, position: int) -> int:
    """Return where the line that holds this position ends, behind its line feed."""
    while position < len(data):
        # a copy of a window, as a memoryview cannot be searched
        feed = bytes(data[position : position + _WINDOW]).find(b"\n")
        if feed >= 0:
            return position + feed + 1
        position += _WINDOW
    return len(data)


def count_lines(data: memoryview) -> int:
    """Return the number of lines; the last one may lack a line feed."""
    chunks = (np.frombuffer(data[k : k + _CHUNK], np.uint8) for k in range(0, len(data), _CHUNK))
    feeds = sum(int(np.count_nonzero(chunk == _LINE_FEED)) for chunk in chunks)  # bytes.count is 7 times slower
    return feeds + (bytes(data[-1:]) != b"\n")

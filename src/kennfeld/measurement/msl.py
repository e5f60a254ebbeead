"""Reads MSL files, the text logs of TunerStudio and MegaTune.

Lines of information in quotes, a line of names and one of units with tabs between, rows, and markers among the rows.
After a restart of the ECU the time may start anew and the lines of names and units may come once more.
"""

from dataclasses import replace

from kennfeld.measurement.columns import Selection, Table
from kennfeld.measurement.doubts import with_doubts
from kennfeld.measurement.sniff import Source
from kennfeld.measurement.text import dialect_of, lines_of, read_exactly

__all__ = ["read_tables"]


def read_tables(source: Source, selection: Selection) -> list[Table]:
    """The one table of a text log; each restart of its time begins a new piece."""
    dialect = dialect_of(source)
    above = []
    for _, line in zip(range(dialect.header.data), lines_of(source, dialect.encoding), strict=False):
        above.append(line[1])
    heads, names = above[: dialect.header.row], above[dialect.header.row :]
    repeated = frozenset(line for line in (*heads, *names) if line.strip())
    table = read_exactly(source, replace(dialect, repeated=repeated), selection)
    first = next((line.strip('" ') for line in heads if line.strip('" ')), "")
    by = (("by", " ".join(first.split())[:80]),) if first else ()
    return [with_doubts(source, dialect, replace(table, details=(*by, *table.details), restarts=True))]

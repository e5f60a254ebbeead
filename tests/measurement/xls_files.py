"""Writes .xls files byte by byte: records of BIFF8 in a compound file ([MS-XLS], [MS-CFB])."""

import struct

FREE, END, FAT = 0xFFFFFFFF, 0xFFFFFFFE, 0xFFFFFFFD
SECTOR, SHORT_SECTOR, SHORT = 512, 64, 4096
BOF = struct.pack("<HHHHII", 0x0600, 0x0010, 0, 0, 0, 0)
BOF_BOOK = struct.pack("<HHHHII", 0x0600, 0x0005, 0, 0, 0, 0)


class Formula:
    """A cell with the formula =1+1 and the value that was saved with it, None where there is none."""

    def __init__(self, value=None):
        self.value = value


def part(kind, content=b""):
    """A record."""
    return struct.pack("<HH", kind, len(content)) + content


def wide(text, width="H"):
    """A text as BIFF8 keeps it, with its length in front."""
    return struct.pack(f"<{width}B", len(text), 1) + text.encode("utf-16-le")


def cell(row, column, value, texts):
    """The record of a cell; texts go into the shared list."""
    at = struct.pack("<HHH", row, column, 0)
    if isinstance(value, bool):
        return part(0x0205, at + bytes([value, 0]))
    if isinstance(value, str):
        texts.append(value)
        return part(0x00FD, at + struct.pack("<I", len(texts) - 1))
    if isinstance(value, Formula):
        kept = b"\x03\0\0\0\0\0\xff\xff" if value.value is None else struct.pack("<d", value.value)
        tokens = b"\x1e\x01\x00\x1e\x01\x00\x03"
        return part(0x0006, at + kept + struct.pack("<HIH", 0, 0, len(tokens)) + tokens)
    if float(value).is_integer() and abs(value) < 1 << 28:
        return part(0x027E, at + struct.pack("<i", int(value) << 2 | 2))
    return part(0x0203, at + struct.pack("<d", value))


def sheet_records(rows, texts, dimensions=None):
    """A sheet from rows of cells; `dimensions` is what it claims (first row, end, first column, end)."""
    claimed = dimensions or (0, len(rows), 0, max(map(len, rows), default=0))
    cells = [cell(i, k, value, texts) for i, row in enumerate(rows) for k, value in enumerate(row) if value is not None]
    return part(0x0809, BOF) + part(0x0200, struct.pack("<IIHHH", *claimed, 0)) + b"".join(cells) + part(0x000A)


def records(sheets, texts=None, dimensions=None):
    """The stream of a workbook from rows by the name of their sheet; `texts` is how many shared ones it claims."""
    shared = []
    bodies = [sheet_records(rows, shared, dimensions) for rows in sheets.values()]
    count = len(shared) if texts is None else texts
    table = part(0x00FC, struct.pack("<ii", count, count) + b"".join(wide(text) for text in shared))
    begin = len(part(0x0809, BOF_BOOK)) + sum(12 + 2 * len(name) for name in sheets) + len(table) + 4
    listed = b""
    for name, body in zip(sheets, bodies, strict=True):
        listed += part(0x0085, struct.pack("<IBB", begin, 0, 0) + wide(name, "B"))
        begin += len(body)
    return part(0x0809, BOF_BOOK) + listed + table + part(0x000A) + b"".join(bodies)


def compound(stream, name="Workbook", short=False):
    """A compound file with one stream, in short sectors if asked and small enough."""
    short = short and len(stream) < SHORT
    if not short:
        stream = stream.ljust(SHORT, b"\0")
    content, table = _padded(stream), b""
    if short:
        count = -(-len(stream) // SHORT_SECTOR)
        table = _padded(struct.pack(f"<{count}I", *range(1, count), END), b"\xff")
    first = len(content) // SECTOR
    chains = [END if i == first - 1 else i + 1 for i in range(first)]
    chains += [END] * (1 + short)  # the directory, the table of short sectors
    tables = 1
    while tables * 128 < len(chains) + tables:
        tables += 1
    at = len(chains)
    chains += [FAT] * tables
    fat = _padded(struct.pack(f"<{len(chains)}I", *chains), b"\xff")
    root = _entry("Root Entry", 5, 0 if short else END, len(content) if short else 0, child=1)
    directory = _padded(root + _entry(name, 2, 0, len(stream)))
    head = struct.pack("<8s16xHHHHH6x", bytes.fromhex("d0cf11e0a1b11ae1"), 0x3E, 3, 0xFFFE, 9, 6)
    head += struct.pack("<IIIIIIIII", 0, tables, first, 0, SHORT, first + 1 if short else END, int(short), END, 0)
    head += struct.pack(f"<{tables}I", *range(at, at + tables))
    return head.ljust(SECTOR, b"\xff") + content + directory + table + fat


def xls(sheets, short=False, **claims):
    """A whole workbook."""
    return compound(records(sheets, **claims), short=short)


def _padded(content, filler=b"\0"):
    return content + filler * (-len(content) % SECTOR)


def _entry(name, kind, start, size, child=FREE):
    raw = (name + "\0").encode("utf-16-le")
    links = struct.pack("<III", FREE, FREE, child)
    return struct.pack("<64sHBB", raw, len(raw), kind, 1) + links + bytes(36) + struct.pack("<IQ", start, size)

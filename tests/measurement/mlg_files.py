"""Writes MLG files byte by byte."""

import struct

SIZES = {0: "B", 1: "b", 2: "H", 3: "h", 4: "I", 5: "i", 6: "q", 7: "f", 10: "B", 11: "H", 12: "I", 16: "B", 17: "H"}


def number(name, kind=7, unit="", scale=1.0, transform=0.0, digits=0, style=0, category=""):
    """A field of numbers."""
    return {"kind": kind, "name": name, "unit": unit, "style": style, "category": category} | {
        "rest": struct.pack(">ffb", scale, transform, digits)
    }


def bits(name, *names, kind=10, style=2, count=None):
    """A field of bits; the names stand elsewhere in the file."""
    return {"kind": kind, "name": name, "unit": "bits", "style": style, "category": "", "bits": names, "count": count}


def mark(text, stamp=0):
    """A block that is a marker."""
    return struct.pack(">BBH50s", 1, 0, stamp, text.encode())


def record(fields, values, stamp=0, wrong_sum=False):
    """A block that is a record of raw values."""
    body = b"".join(struct.pack(">" + SIZES[f["kind"]], v) for f, v in zip(fields, values, strict=True))
    return struct.pack(">BBH", 0, 0, stamp) + body + bytes([(sum(body) + wrong_sum) % 256])


def mlg(fields, blocks, version=1, info="", created=0, length=None, count=None):
    """The whole file."""
    head, size = (22, 55) if version == 1 else (24, 89)
    end = head + len(fields) * size
    described, names = b"", b""
    for field in fields:
        rest = field.get("rest")
        if rest is None:
            field_count = field["count"] if field["count"] is not None else len(field["bits"])
            rest = struct.pack(">BIB3x", 0, end + len(names), field_count)
            names += b"".join(name.encode() + b"\0" for name in field["bits"])
        part = struct.pack(">B34s10sB", field["kind"], field["name"].encode(), field["unit"].encode(), field["style"])
        described += part + rest + (struct.pack("34s", field["category"].encode()) if version == 2 else b"")
    begin = end + len(names) + len(info)
    measured = sum(struct.calcsize(">" + SIZES.get(f["kind"], "B")) for f in fields)
    rest = (end + len(names), begin, measured if length is None else length, len(fields) if count is None else count)
    first = struct.pack(">6shI" + ("H" if version == 1 else "I") + "IHH", b"MLVLG", version, created, *rest)
    return first + described + names + info.encode() + b"".join(blocks)

"""Encoding of a text file, detected from its first bytes."""

import codecs
import re
from collections.abc import Container

from kennfeld.base.lazy_dataclass import dataclass

_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_DECLARED = re.compile(rb'\s*\*\s*encoding\s*=\s*"?([A-Za-z0-9_.:-]+)')  # in the first line of a calibration file
# Python also knows codecs that are no character sets (zip, unicode_escape, ...); a file must not reach them.
_CHARACTER_SET = re.compile(r"(utf|cp\d|windows|iso|latin|ascii|us-ascii|gb|big5|shift|euc|koi)", re.IGNORECASE)
_MOST_COMMON = 0.8  # of the characters of two bytes
_SAMPLE = 65536  # bytes in which they are counted


@dataclass(frozen=True)
class _DoubleByteEncoding:
    """An encoding of two bytes a character: which first and second bytes its common characters have."""

    name: str
    leads: Container[int]
    trails: Container[int]
    single: Container[int] = ()  # bytes above 0x7f that are characters by themselves


_DOUBLE_BYTE = (
    # symbols, Greek and the 3755 common characters; the others are as rare as adjacent umlauts are likely
    _DoubleByteEncoding("gb18030", frozenset((*range(0xA1, 0xAA), *range(0xB0, 0xD8))), range(0xA1, 0xFF)),
    # symbols, kana and the 2965 common characters; katakana of half width
    _DoubleByteEncoding("cp932", range(0x81, 0x98), range(0x40, 0xFD), range(0xA1, 0xE0)),
)
# names of those that may be wrong
GUESSED_ENCODINGS = {"gb18030": "GB18030 (Chinese)", "cp932": "Shift JIS (Japanese)"}


def detect_encoding(start: bytes, whole: bool) -> str:
    """Return the encoding of a file that begins with these bytes.

    By its mark; else as a first line `* encoding="..."` says; else UTF-8 if it is valid; else GB18030 or Shift JIS if
    it is valid and most characters are common ones, for nearly any bytes are valid there; else cp1252.

    >>> detect_encoding("Öl [°C]".encode("cp1252"), True), detect_encoding("Öl [°C]".encode(), True)
    ('cp1252', 'utf-8')
    >>> detect_encoding("转速 [rpm]".encode("gbk"), True), detect_encoding("回転数 [rpm]".encode("cp932"), True)
    ('gb18030', 'cp932')
    """
    for mark, name in _MARKS:
        if start.startswith(mark):
            return name
    declared = declared_encoding(start)
    if declared and _is_valid(start, declared, whole):
        return declared
    if _is_valid(start, "utf-8", whole):
        return "utf-8"
    likely = (e.name for e in _DOUBLE_BYTE if _is_valid(start, e.name, whole) and _has_common_characters(start, e))
    return next(likely, "cp1252")


def declared_encoding(start: bytes) -> str:
    """Return the encoding that the first line of a file states, as INCA writes it; empty if there is none."""
    match = _DECLARED.match(start)
    name = match[1].decode("ascii") if match else ""
    return name if _CHARACTER_SET.match(name) else ""


def decode(start: bytes, *, whole: bool) -> str:
    """Return a text, or the beginning of one, with LF line ends and without its mark."""
    text = start.decode(detect_encoding(start, whole), errors="replace")
    return text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")


def _is_valid(start: bytes, encoding: str, whole: bool) -> bool:
    try:
        # the end of these bytes may cut a character
        codecs.getincrementaldecoder(encoding)().decode(start, final=whole)
    except (UnicodeDecodeError, LookupError):
        return False
    return True


def _has_common_characters(start: bytes, encoding: _DoubleByteEncoding) -> bool:
    """Return whether most characters of two bytes are common ones."""
    common = total = at = 0
    while at + 1 < min(len(start), _SAMPLE):
        lead, trail = start[at], start[at + 1]
        if lead < 0x80 or lead in encoding.single:
            at += 1
            continue
        total += 1
        common += lead in encoding.leads and trail in encoding.trails
        at += 2
    return total > 0 and common >= _MOST_COMMON * total

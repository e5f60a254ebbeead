"""Record layouts: which parts an object has in the memory, and in what order."""

import re

from kennfeld.calfiles.a2l.blocks import Block, is_text
from kennfeld.calfiles.a2l.cursor import Cursor, UnusableError
from kennfeld.calfiles.a2l.objects import Component, RecordLayout

__all__ = ["record_layout"]

_KEYWORD = re.compile(
    r"(FNC_VALUES|IDENTIFICATION|RESERVED"
    r"|(?:AXIS_PTS|AXIS_RESCALE|NO_AXIS_PTS|NO_RESCALE|SRC_ADDR|RIP_ADDR|SHIFT_OP|OFFSET|DIST_OP)(?=_[WXYZ45]$))"
    r"(?:_([WXYZ45]))?"
)
_FIXED = re.compile(r"FIX_NO_AXIS_PTS_([XYZ45])")
_ALIGNMENT = re.compile(r"ALIGNMENT_(BYTE|WORD|LONG|INT64|FLOAT16_IEEE|FLOAT32_IEEE|FLOAT64_IEEE)")
_FLAGS = ("STATIC_RECORD_LAYOUT", "STATIC_ADDRESS_OFFSETS")
_MOST = 1000  # parts


def record_layout(block: Block) -> RecordLayout:
    """A RECORD_LAYOUT with its parts in the order of their positions. Raises `UnusableError`."""
    cursor = Cursor(block)
    name = cursor.word("name")
    components: list[Component] = []
    fixed: dict[str, int] = {}
    alignments: dict[str, int] = {}
    flags: list[str] = []
    unknown: list[str] = []
    while cursor.left():
        text = is_text(cursor.tokens[cursor.at])
        keyword = cursor.word("keyword")
        if text:
            unknown.append(keyword[:40])
        elif found := _KEYWORD.fullmatch(keyword):
            components.append(_component(cursor, found[1], found[2] or ""))
        elif found := _FIXED.fullmatch(keyword):
            fixed[found[1]] = cursor.whole(keyword)
        elif found := _ALIGNMENT.fullmatch(keyword):
            alignments[found[1]] = _border(cursor, keyword)
        elif keyword in _FLAGS:
            flags.append(keyword)
        else:
            unknown.append(keyword[:40])
        if len(components) + len(unknown) > _MOST:
            raise UnusableError(f"has more than {_MOST} parts")
    ordered = tuple(sorted(components, key=lambda component: component.position))
    return RecordLayout(name, ordered, fixed, alignments, _FLAGS[0] in flags, _FLAGS[1] in flags, tuple(unknown))


def _border(cursor: Cursor, keyword: str) -> int:
    border = cursor.whole(keyword)
    if not 1 <= border <= 64:
        raise UnusableError(f"has {keyword} {border}, which is no number of bytes")
    return border


def _component(cursor: Cursor, kind: str, direction: str) -> Component:
    position, data_type = cursor.whole("position"), cursor.word("data type")
    mode, addressing, pairs = "", "DIRECT", 0
    if kind == "AXIS_RESCALE":
        pairs = cursor.whole("number of pairs")
    if kind in ("FNC_VALUES", "AXIS_PTS", "AXIS_RESCALE"):
        mode, addressing = cursor.word("index mode"), cursor.word("addressing")
    return Component(kind, direction, position, data_type, mode, addressing, pairs)

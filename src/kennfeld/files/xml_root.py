"""The root of an XML document."""

import re

_PROLOG = 20_000  # characters before the root
_SPACE = re.compile(r"\s*")
_DOCTYPE = re.compile(r"<!DOCTYPE\b[^\[>]*+(?:\[[^\]]*+\][^>]*+)?>", re.IGNORECASE)
_ROOT = re.compile(r"<(?:[\w.-]+:)?([A-Za-z_][\w.-]{0,60})(?=[\s/>])")
_ENCLOSED = (("<?", "?>"), ("<!--", "-->"))  # what may precede the root: begin and end


def xml_root(text: str) -> str:
    r"""Return the name of the root of an XML document, without its prefix; empty for other texts.

    Declaration, document type and comments may precede it.

    >>> xml_root("<?xml version='1.0'?>\n<!-- <a> -->\n<usi:tdm version='1.0'>"), xml_root("time,<a>")
    ('tdm', '')
    """
    text, at = text[:_PROLOG], 0
    # each round skips blanks, and one declaration, document type or comment
    while True:
        at = _end(_SPACE.match(text, at))
        after = _end(_DOCTYPE.match(text, at))
        for begin, end in _ENCLOSED:
            if text.startswith(begin, at):
                closing = text.find(end, at + len(begin))
                after = closing + len(end) if closing >= 0 else 0
        if not after:
            match = _ROOT.match(text, at)
            return match[1] if match else ""
        at = after


def _end(match: re.Match[str] | None) -> int:
    return match.end() if match else 0

"""The root of an XML document."""

import re

_PROLOG = 20_000  # characters before the root
_BEFORE = re.compile(r"<\?.*?\?>|<!--.*?-->|<!DOCTYPE\b(?:[^\[>]++|\[.*?\])*+>", re.DOTALL | re.IGNORECASE)
_ROOT = re.compile(r"\s*<(?:[\w.-]+:)?([A-Za-z_][\w.-]{0,60})(?=[\s/>])")


def xml_root(text: str) -> str:
    r"""Return the name of the root of an XML document, without its prefix; empty for other texts.

    Declaration, document type and comments may precede it.

    >>> xml_root("<?xml version='1.0'?>\n<!-- <a> -->\n<usi:tdm version='1.0'>"), xml_root("time,<a>")
    ('tdm', '')
    """
    start = text[:_PROLOG].lstrip()
    if not start.startswith("<"):
        return ""
    match = _ROOT.match(_BEFORE.sub("", start))
    return match[1] if match else ""

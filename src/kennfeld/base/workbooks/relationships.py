"""Reads which parts of a workbook its relationships name; layout: ECMA-376, part 2."""

import re
import zipfile
from collections.abc import Iterator
from html import unescape

_RELATIONSHIP = re.compile(r"<(?:\w+:)?Relationship\s[^>]*>")
_ATTRIBUTE = re.compile(r"""([\w:]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")


def relationship_targets(archive: zipfile.ZipFile, member: str) -> dict[str, str]:
    """Return the members of the archive that a part with relationships of a workbook names, by their identifier."""
    attributes = list(attributes_of(_RELATIONSHIP, archive, member))
    return {each.get("Id", ""): _member_of(each.get("Target", "")) for each in attributes}


def attributes_of(element: re.Pattern[str], archive: zipfile.ZipFile, member: str) -> Iterator[dict[str, str]]:
    """Yield the attributes of each element of a part of the archive."""
    for tag in element.findall(archive.read(member).decode("utf-8", "replace")):
        yield {key: unescape(double or single) for key, double, single in _ATTRIBUTE.findall(tag)}


def _member_of(target: str) -> str:
    return target.lstrip("/") if target.startswith("/") else f"xl/{target}"

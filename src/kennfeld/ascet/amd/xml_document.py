"""Parses the XML of `.amd` files.

The position of an element is kept so that a number in one of its attributes can be replaced in the text.
"""

from typing import Final

from kennfeld.base.xml_document import XmlElement, XmlLimits, parse_xml

MAX_BYTES: Final = 64_000_000  # of a file
_MAX_ELEMENTS: Final = 2_000_000
_LIMITS: Final = XmlLimits(MAX_BYTES, 200, _MAX_ELEMENTS, _MAX_ELEMENTS)  # hierarchies of diagrams take three levels


def parse_amd(raw: bytes, name: str) -> XmlElement:
    """Return the root of an `.amd` file.

    Args:
        raw: the file.
        name: its name in messages.

    Raises:
        InputError: it is not well-formed, too large, or declares entities.

    >>> parse_amd(b'<ComponentData><DataSet name="Data"/></ComponentData>', "a.data.amd").first("DataSet").get("name")
    'Data'
    """
    return parse_xml(raw, name, _LIMITS)

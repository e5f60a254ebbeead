"""Data dictionaries in the text format of R2026b and later: JSON, as the sections of the older format.

Numbers are written as JSON has them, or with their class and, row by row, their size: `Matrix(2,2)` and the rows.
"""

import json
import re
from collections.abc import Mapping
from typing import Any

from kennfeld.models.simulink.files.section import Section
from kennfeld.models.simulink.files.trouble import Trouble

__all__ = ["is_text_dictionary", "text_chunks"]

_PARTS, _PART, _CONTENT = "__MW_TEXT_PARTS__", "__MW_TEXT_PART__/data/chunk", "__MW_TEXT_content"
_MATRIX = re.compile(r"\s*Matrix\((\d{1,9}),(\d{1,9})\)(.*)", re.DOTALL)
_NUMBER = re.compile(  # with the mark of its class behind it, `60000U` or `2.5F`
    r"([-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+|inf|nan|true|false))[UFL]*", re.IGNORECASE
)
_BETWEEN = re.compile(r"[\s,;\[\]]*")  # what stands between the numbers of a matrix
_HEAD = 65536


def is_text_dictionary(raw: bytes) -> bool:
    """Whether bytes look like a data dictionary that is text."""
    return _PARTS.encode() in raw[:_HEAD]


def text_chunks(raw: bytes, trouble: Trouble) -> list[Section]:
    """The chunks of a dictionary; what is wrong is noted."""
    try:
        parts = json.loads(raw)[_PARTS]
        contents = [parts[name][_CONTENT] for name in sorted(parts) if name.startswith(_PART)]
        if not contents:
            trouble.error("", "is no data dictionary: it has no part data/chunk0", "Take a complete copy of the file.")
        return [_chunk(content) for content in contents]
    except RecursionError:
        trouble.error("", "is nested too deeply", "Take a complete copy of the file.")
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        trouble.error("", f"is no data dictionary: {str(error)[:80]}", "Take a complete copy of the file.")
    return []


def _chunk(content: Mapping[str, Any]) -> Section:
    entries = [_object("DD.ENTRY", _text("Name", one["name"]), _value("Value", one["value"]))
               for one in content.get("entries", ())]  # fmt: skip
    references = [_object("DD.DICTIONARYREFERENCE", _text("Subdictionary", name))
                  for name in content.get("Dictionary References", ())]  # fmt: skip
    return Section("DataSource", 0, parts=[*entries, *references])


def _object(kind: str, *parts: Section) -> Section:
    return Section("Object", 0, {"Class": kind}, [*parts])


def _text(name: str, text: object) -> Section:
    return _section(name, "char", str(text))


def _section(name: str, kind: str, text: str = "", size: str = "", parts: list[Section] | None = None) -> Section:
    """A property with a name, or an element without one."""
    keys = {key: value for key, value in (("Name", name), ("Class", kind), ("Dimension", size)) if value}
    return Section("P" if name else "Element", 0, keys, parts or [], text=text)


def _value(name: str, value: Any) -> Section:
    """A value of JSON as a property, or as an element where it has no name."""
    if isinstance(value, bool):
        return _section(name, "logical", str(int(value)))
    if isinstance(value, int | float):
        return _section(name, "double", repr(value))
    if isinstance(value, str):
        return _section(name, "char", value)
    if isinstance(value, list):
        return _listed(name, value)
    return _made(name, value) if isinstance(value, dict) else _section(name, "")


def _listed(name: str, values: list[Any]) -> Section:
    """A row of numbers, a text that is a string, or a cell array of anything else."""
    if len(values) == 1 and isinstance(values[0], str):
        return _section(name, "string", values[0])
    if not all(isinstance(one, int | float) for one in values):
        return _section(name, "cell", "", "", [_value("", one) for one in values])
    numbers = " ".join(repr(float(one)) for one in values)
    return _section(name, "double", numbers, f"1*{len(values)}" if values else "0*0")


def _made(name: str, value: dict[str, Any]) -> Section:
    """Numbers of a class, an array of structs, cells or objects, or an object."""
    if "_type" in value:
        return _typed(name, str(value["_type"]), str(value.get("_value", "")))
    size = "*".join(str(int(n)) for n in value.get("_dimensions", ()))
    elements = value.get("_elements", [])
    if "_object_class" in value:
        return _section(name, "", parts=[_properties(str(value["_object_class"]), value.get("_properties", {}))])
    if "_array_class" in value:
        kind = str(value["_array_class"])
        made = [_properties(str(one.get("_object_class", kind)), one.get("_properties", {})) for one in elements]
        return _section(name, "", size=size, parts=made)
    if value.get("_array_type") == "Struct":
        return _section(name, "struct", size=size, parts=[_properties("", one) for one in elements])
    if value.get("_array_type") in ("Cell", "String"):
        return _section(name, "cell", size=size, parts=[_value("", one) for one in elements])
    return _section(name, str(value.get("_array_type", "unknown")))


def _properties(kind: str, properties: Mapping[str, Any]) -> Section:
    return _section("", kind, parts=[_value(key, one) for key, one in properties.items()])


def _typed(name: str, kind: str, written: str) -> Section:
    """Numbers with their class: row by row in the file, column by column in a section.

    What holds more than numbers stays as it is written, for others to refuse.
    """
    found = _MATRIX.match(written)
    body = found[3] if found else written
    if not _BETWEEN.fullmatch(_NUMBER.sub("", body)):
        return _section(name, kind, body)
    numbers = [number.lower() for number in _NUMBER.findall(body)]
    if found is None:
        return _section(name, kind, " ".join(numbers), "" if len(numbers) == 1 else f"1*{len(numbers)}")
    rows, columns = int(found[1]), int(found[2])
    if rows * columns == len(numbers):
        numbers = [numbers[row * columns + column] for column in range(columns) for row in range(rows)]
    return _section(name, kind, " ".join(numbers), f"{rows}*{columns}")

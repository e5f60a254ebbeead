"""JSON parts of the newest Simulink files as sections: what stood in XML before stands there under the same names."""

import json
from typing import Any

from kennfeld.models.simulink.files.section import DEEPEST, MOST_SECTIONS, Section
from kennfeld.models.simulink.files.trouble import Trouble

__all__ = ["json_section"]

_DAMAGED = "The file may be cut off or damaged: take a complete copy."
_CLASS, _NUMBER, _PROPERTIES, _ELEMENTS, _VALUE = "_object_class", "_id", "_properties", "_elements", "_value"


def json_section(raw: bytes, part: str, trouble: Trouble) -> Section | None:
    """The root of a JSON part as a section; None with an error noted where it is broken.

    A root that holds one thing only is that thing: `{"BlockDiagram": {...}}`.
    """
    try:
        root = json.loads(raw)
    except (ValueError, RecursionError) as error:
        trouble.error(part, f"is no well-formed JSON: {str(error)[:120]}", _DAMAGED)
        return None
    if not isinstance(root, dict):
        trouble.error(part, "is no JSON object", _DAMAGED)
        return None
    converter = _Converter(part, trouble)
    if len(root) == 1 and isinstance(inner := next(iter(root.values())), dict):
        return converter.section(next(iter(root)), inner)
    return converter.section("", root)


class _Converter:
    def __init__(self, part: str, trouble: Trouble) -> None:
        self.part = part
        self.trouble = trouble
        self.count = 0

    def section(self, kind: str, given: dict[str, Any], depth: int = 0) -> Section:
        self.count += 1
        if depth > DEEPEST or self.count > MOST_SECTIONS:
            raise self.trouble.refuse(self.part, f"holds more than {MOST_SECTIONS} things or {DEEPEST} levels of them")
        section = Section(kind, 0)
        for key, value in given.items():
            if key == _PROPERTIES and isinstance(value, dict):
                inner = self.section(kind, value, depth + 1)
                section.keys |= inner.keys
                section.parts += inner.parts
            else:
                self._add(section, key, value, depth)
        return section

    def _add(self, section: Section, key: str, value: Any, depth: int) -> None:
        if key in (_CLASS, _NUMBER):
            section.keys["ClassName" if key == _CLASS else "ObjectID"] = str(value)
        elif isinstance(value, dict) and _VALUE in value:
            section.keys[key] = _text(value[_VALUE])
        elif isinstance(value, dict):
            elements = value.get(_ELEMENTS)
            if isinstance(elements, list):
                section.parts.append(self._array(key, elements, depth))
            else:
                section.parts.append(self._named(key, value, depth))
        elif isinstance(value, list) and any(isinstance(inner, dict) for inner in value):
            section.parts += [self.section(key, inner, depth + 1) for inner in value if isinstance(inner, dict)]
        else:
            section.keys[key] = _text(value)

    def _named(self, key: str, value: dict[str, Any], depth: int) -> Section:
        made = self.section(key, value, depth + 1)
        made.keys.setdefault("PropName", key)
        return made

    def _array(self, key: str, elements: list[Any], depth: int) -> Section:
        objects = [self.section("Object", inner, depth + 1) for inner in elements if isinstance(inner, dict)]
        return Section("Array", 0, {"PropName": key}, objects)


def _text(value: Any) -> str:
    """A value as the XML of other releases writes it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return value if isinstance(value, str) else "" if value is None else json.dumps(value)

"""Data dictionaries in the text format of R2026b and later: JSON, as the sections of the older format.

Numbers are written as JSON has them, or with their class and, row by row, their size: `Matrix(2,2)` and the rows.

Data dictionaries (`.sldd`): a zip whose `data/chunk*.xml` state the variables of a design, or the same as text.

The format is not published; what is read here is what dictionaries of R2014a and later hold. Matrices are written
column by column, in the text format row by row.
"""

import binascii
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.arrays import readonly
from kennfeld.errors import InputError
from kennfeld.matlab.mat_nodes import MatFileError
from kennfeld.models.simulink.reader.document import solver_from
from kennfeld.models.simulink.reader.model_package import is_zip, zip_package
from kennfeld.models.simulink.reader.model_tree import StoredSolver
from kennfeld.models.simulink.reader.section_tree import ReadDiagnostics, SectionNode
from kennfeld.models.simulink.variables.m_files import enumerals
from kennfeld.models.simulink.variables.stored_variables import (
    StoredVariable,
    StoredVariables,
    Value,
    mxarray_value,
    stored_variable,
)

__all__ = ["Dictionary", "read_dictionary"]

_PARTS, _PART, _CONTENT = "__MW_TEXT_PARTS__", "__MW_TEXT_PART__/data/chunk", "__MW_TEXT_content"
_MATRIX = re.compile(r"\s*Matrix\((\d{1,9}),(\d{1,9})\)(.*)", re.DOTALL)
_NUMBER = re.compile(  # with the mark of its class behind it, `60000U` or `2.5F`
    r"([-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+|inf|nan|true|false))[UFL]*", re.IGNORECASE
)
_BETWEEN = re.compile(r"[\s,;\[\]]*")  # what stands between the numbers of a matrix
_HEAD = 65536

_NUMBERS = {"double", "single", "logical", "boolean", "bool"} | {
    f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64)
}
_TEXTS = {"char", "string"}
_NOT_DATA = ("Simulink.ConfigSet", "Simulink.ConfigSetRef", "Simulink.VariantConfigurationData")
_TRUTH = {"true": "1", "false": "0"}
_DEEPEST = 50
_LARGEST = 1_000_000_000  # values along one dimension
_MEND = "Data dictionaries end in .sldd."

_ENUMERATION = "Simulink.data.dictionary.EnumTypeDefinition"
_TYPE_CLASSES = frozenset(
    {
        "Simulink.AliasType",
        "Simulink.Bus",
        "Simulink.NumericType",
        "Simulink.ValueType",
        _ENUMERATION,
    }
)


def is_text_dictionary(raw: bytes) -> bool:
    """Whether bytes look like a data dictionary that is text."""
    return _PARTS.encode() in raw[:_HEAD]


def text_chunks(raw: bytes, diagnostics: ReadDiagnostics) -> list[SectionNode]:
    """The chunks of a dictionary; what is wrong is noted."""
    try:
        parts = json.loads(raw)[_PARTS]
        contents = [parts[name][_CONTENT] for name in sorted(parts) if name.startswith(_PART)]
        if not contents:
            diagnostics.error(
                "", "is no data dictionary: it has no part data/chunk0", "Take a complete copy of the file."
            )
        return [_chunk(content) for content in contents]
    except RecursionError:
        diagnostics.error("", "is nested too deeply", "Take a complete copy of the file.")
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        diagnostics.error("", f"is no data dictionary: {str(error)[:80]}", "Take a complete copy of the file.")
    return []


def _chunk(content: Mapping[str, Any]) -> SectionNode:
    entries = [_object("DD.ENTRY", _text("Name", one["name"]), _text_value("Value", one["value"]))
               for one in content.get("entries", ())]  # fmt: skip
    references = [_object("DD.DICTIONARYREFERENCE", _text("Subdictionary", name))
                  for name in content.get("Dictionary References", ())]  # fmt: skip
    return SectionNode("DataSource", 0, parts=[*entries, *references])


def _object(kind: str, *parts: SectionNode) -> SectionNode:
    return SectionNode("Object", 0, {"Class": kind}, [*parts])


def _text(name: str, text: object) -> SectionNode:
    return _section(name, "char", str(text))


def _section(
    name: str, kind: str, text: str = "", size: str = "", parts: list[SectionNode] | None = None
) -> SectionNode:
    """A property with a name, or an element without one."""
    keys = {key: value for key, value in (("Name", name), ("Class", kind), ("Dimension", size)) if value}
    return SectionNode("P" if name else "Element", 0, keys, parts or [], text=text)


def _text_value(name: str, value: Any) -> SectionNode:
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


def _listed(name: str, values: list[Any]) -> SectionNode:
    """A row of numbers, a text that is a string, or a cell array of anything else."""
    if len(values) == 1 and isinstance(values[0], str):
        return _section(name, "string", values[0])
    if not all(isinstance(one, int | float) for one in values):
        return _section(name, "cell", "", "", [_text_value("", one) for one in values])
    numbers = " ".join(repr(float(one)) for one in values)
    return _section(name, "double", numbers, f"1*{len(values)}" if values else "0*0")


def _made(name: str, value: dict[str, Any]) -> SectionNode:
    """Numbers of a class, an array of structs, cells or objects, or an object."""
    if "_type" in value:
        return _typed(name, str(value["_type"]), str(value.get("_value", "")))
    size = "*".join(str(int(n)) for n in value.get("_dimensions", ()))
    elements = value.get("_elements", [])
    if "_object_class" in value:
        return _section(name, "", parts=[_text_properties(str(value["_object_class"]), value.get("_properties", {}))])
    if "_array_class" in value:
        kind = str(value["_array_class"])
        made = [_text_properties(str(one.get("_object_class", kind)), one.get("_properties", {})) for one in elements]
        return _section(name, "", size=size, parts=made)
    if value.get("_array_type") == "Struct":
        return _section(name, "struct", size=size, parts=[_text_properties("", one) for one in elements])
    if value.get("_array_type") in ("Cell", "String"):
        return _section(name, "cell", size=size, parts=[_text_value("", one) for one in elements])
    return _section(name, str(value.get("_array_type", "unknown")))


def _text_properties(kind: str, properties: Mapping[str, Any]) -> SectionNode:
    return _section("", kind, parts=[_text_value(key, one) for key, one in properties.items()])


def _typed(name: str, kind: str, written: str) -> SectionNode:
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


@dataclass(frozen=True)
class Dictionary:
    """A data dictionary.

    `references` are the names of further dictionaries whose entries belong to it; `solvers` are the configurations
    kept in it, by name; `types` are the names of its enumerated types, buses and aliases, `enumerations` the members of
    those that are enumerated, by name.
    """

    path: Path
    data: StoredVariables = field(default_factory=StoredVariables)
    references: tuple[str, ...] = ()
    solvers: Mapping[str, StoredSolver] = field(default_factory=dict)
    types: tuple[str, ...] = ()
    enumerations: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def over(self, further: "Dictionary") -> "Dictionary":
        """This dictionary with what a further one holds besides; of two entries of one name its own wins."""
        return replace(
            self,
            data=StoredVariables(
                {**further.data.entries, **self.data.entries}, {**further.data.unreadable, **self.data.unreadable}
            ),
            solvers={**further.solvers, **self.solvers},
            types=tuple(dict.fromkeys((*self.types, *further.types))),
            enumerations={**further.enumerations, **self.enumerations},
        )


class _Unreadable(Exception):  # noqa: N818 - says of one entry why it is left aside
    pass


def read_dictionary(path: str | Path, follow: bool = True) -> Dictionary:
    """The variables of a `.sldd` file and, with `follow`, of the dictionaries beside it that it refers to.

    An entry of the file itself wins over one of the same name further down. What cannot be decoded is told by name in
    `data.unreadable`, a reference to a file that is missing or broken among it. Raises `InputError` where the file
    itself is no dictionary.
    """
    path = Path(path)
    read, seen = _one(path), {path.resolve()}
    waiting = [(path.parent, name) for name in read.references] if follow else []
    while waiting:
        folder, name = waiting.pop(0)
        file = folder / name
        if file.resolve() in seen:
            continue
        seen.add(file.resolve())
        further = _referred(file, name)
        read = read.over(further)
        waiting += [(folder, reference) for reference in further.references]
    return read


def _referred(file: Path, name: str) -> Dictionary:
    """A dictionary that another one refers to; where it cannot be read, one without entries that says why."""
    why = "this dictionary, which the other refers to, is not beside it"
    if Path(name).name == name and file.is_file():
        try:
            return _one(file)
        except InputError as error:
            why = f"this dictionary, which the other refers to: {error.findings[0].message}"
    return Dictionary(file, StoredVariables({}, {name: why}))


def _one(path: Path) -> Dictionary:
    """The dictionary in a file alone; raises `InputError` where it is none."""
    diagnostics = ReadDiagnostics(path.name)
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError.of(str(path), f"cannot be read: {error.strerror or error}") from None
    if not is_zip(raw) and not is_text_dictionary(raw):
        raise InputError.of(path.name, "is no data dictionary", _MEND)
    roots = _packed(raw, diagnostics) if is_zip(raw) else text_chunks(raw, diagnostics)
    diagnostics.settle()
    return _dictionary(path, roots)


def _packed(raw: bytes, diagnostics: ReadDiagnostics) -> list[SectionNode]:
    """The chunks in a zip; what is wrong is noted."""
    package = zip_package(raw, diagnostics)
    chunks = sorted(name for name in package.names() if name.startswith("data/chunk") and name.endswith(".xml"))
    if not chunks and not diagnostics.errors:
        diagnostics.error("", "is no data dictionary: it has no part data/chunk0.xml", _MEND)
    read = [package.section(name, fold=False) for name in chunks]
    return [root for root in read if root is not None]


def _dictionary(path: Path, roots: list[SectionNode]) -> Dictionary:
    """The dictionary of its chunks: entries that are data, types or configurations, and references."""
    entries: dict[str, StoredVariable] = {}
    unreadable: dict[str, str] = {}
    references: list[str] = []
    solvers: dict[str, StoredSolver] = {}
    types: list[str] = []
    enumerations: dict[str, Mapping[str, float]] = {}
    for thing in (part for root in roots for part in root.all("Object")):
        kind, said = thing.keys.get("Class", ""), _properties(thing)
        if kind == "DD.DICTIONARYREFERENCE":
            references += [said[key].text for key in ("Subdictionary", "Name") if key in said][:1]
        if kind != "DD.ENTRY" or "Value" not in said:
            continue
        name, given = _stated(said, "Name"), said["Value"]
        classes = _classes(given)
        if not classes.isdisjoint(_NOT_DATA):
            solvers[name] = solver_from(given)
        elif not classes.isdisjoint(_TYPE_CLASSES):
            types.append(name)
            enumerations |= {name: enumerals(given)} if _ENUMERATION in classes else {}
        else:
            _add(name, given, entries, unreadable)
    return Dictionary(
        path, StoredVariables(entries, unreadable), tuple(references), solvers, tuple(types), enumerations
    )


def _add(name: str, given: SectionNode, entries: dict[str, StoredVariable], unreadable: dict[str, str]) -> None:
    try:
        value = _value(given)
    except _Unreadable as why:
        unreadable[name] = str(why)
        return
    if isinstance(value, StoredVariable):
        entries[name] = replace(value, name=name)
    else:
        word = "char" if isinstance(value, str) else "cell" if isinstance(value, tuple) else "struct"
        entries[name] = StoredVariable(name, value, given.keys.get("Class") or word)


def _properties(section: SectionNode) -> dict[str, SectionNode]:
    return {part.keys["Name"]: part for part in section.all("P") if "Name" in part.keys}


def _stated(said: Mapping[str, SectionNode], key: str) -> str:
    return said[key].text if key in said else ""


def _classes(value: SectionNode) -> set[str]:
    """The class of a value, written at it or at what it holds."""
    return {part.keys.get("Class", "") for part in (value, *value.all("Element"))}


def _value(section: SectionNode, depth: int = 0) -> Value:
    """The value of a property or an element of an array."""
    kind = section.keys.get("Class", "")
    if depth > _DEEPEST:
        raise _Unreadable(f"it is more than {_DEEPEST} levels deep")
    if section.keys.get("Encoding"):
        return _encoded(section)
    if kind in _NUMBERS:
        return _numbers(section)
    if kind in _TEXTS:
        return section.text
    if kind == "cell":
        return tuple(_value(part, depth + 1) for part in section.all("Element"))
    if kind == "struct":
        return _several(tuple(_struct(part, depth) for part in section.all("Element")), section)
    inner = tuple(_value(part, depth + 1) for part in section.all("Element"))
    if not kind and not inner and not section.text.strip():
        return None
    if inner:
        return _several(inner, section)
    if section.first("P") is not None:
        return stored_variable("", kind, _struct(section, depth)) if kind else _struct(section, depth)
    if "." in kind:
        # an enumeration says the name of its member, an object of which all is default says nothing
        return section.text.strip() or stored_variable("", kind, {})
    raise _Unreadable(f"it is of the unknown class {kind[:60] or 'none'}")


def _struct(section: SectionNode, depth: int) -> dict[str, Value]:
    return {name: _value(part, depth + 1) for name, part in _properties(section).items()}


def _several(values: tuple[Value, ...], section: SectionNode) -> Value:
    """One value by itself, several as a tuple."""
    return values[0] if len(values) == 1 and section.keys.get("Dimension", "1*1") == "1*1" else values


def _numbers(section: SectionNode) -> Value:
    """An array in the order of the file, which is column by column."""
    if section.keys.get("IsComplex") in ("1", "true") or "i" in section.text.replace("Inf", "").replace("inf", ""):
        raise _Unreadable("it is complex")
    written = section.text.split()
    try:
        values = np.array([float(_TRUTH.get(number, number)) for number in written])
        shape = tuple(int(n) for n in section.keys["Dimension"].split("*")) if "Dimension" in section.keys else None
    except ValueError:
        raise _Unreadable(f"its numbers cannot be read: {section.text.strip()[:40]}") from None
    shape = shape or ((1, 1) if values.size == 1 else (min(values.size, 1), values.size))
    if len(shape) > 30 or min(shape) < 0 or max(shape) > _LARGEST or values.size != int(np.prod(shape, dtype=float)):
        raise _Unreadable(f"it has {values.size} numbers for the size {section.keys.get('Dimension', '')[:40]}")
    return readonly(values.reshape(shape, order="F"))


def _encoded(section: SectionNode) -> Value:
    """A value that has no text: the bytes of an array."""
    try:
        return mxarray_value(binascii.unhexlify("".join(section.text.split())))
    except (binascii.Error, ValueError):
        raise _Unreadable("its bytes cannot be decoded") from None
    except MatFileError as error:
        raise _Unreadable(f"its bytes cannot be decoded: {error}") from None

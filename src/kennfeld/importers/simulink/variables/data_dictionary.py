"""Data dictionaries (`.sldd`): a zip archive with `data/chunk*.xml`, or text.

The format is not published; dictionaries of R2014a and later are supported. The text format (R2026b and later) is JSON,
here converted to sections of the XML format. Its numbers are plain, or have a class and size followed by the rows:
`Matrix(2,2)`. Matrices are stored by columns in XML, by rows in text.
"""

import binascii
import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.arrays import readonly
from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import file_name
from kennfeld.importers.simulink.reader.document import solver_from
from kennfeld.importers.simulink.reader.model_package import is_zip, zip_package
from kennfeld.importers.simulink.reader.model_tree import StoredSolver
from kennfeld.importers.simulink.reader.section_tree import COMPLETE_COPY, ReadDiagnostics, SectionNode
from kennfeld.importers.simulink.variables.enumerations import enumerals
from kennfeld.importers.simulink.variables.stored_variables import (
    ENUMERATED,
    StoredVariable,
    StoredVariables,
    UnusableValueError,
    Value,
    mxarray_value,
    stored_variable,
)
from kennfeld.matlab.mat_nodes import MatFileError
from kennfeld.matlab.simulink_types import TYPE_CLASSES
from kennfeld.matlab.values import INTEGERS

_PARTS, _PART, _CONTENT = "__MW_TEXT_PARTS__", "__MW_TEXT_PART__/data/chunk", "__MW_TEXT_content"
_MATRIX = re.compile(r"\s*Matrix\((\d{1,9}),(\d{1,9})\)(.*)", re.DOTALL)
_NUMBER = re.compile(  # with its class suffix, `60000U` or `2.5F`
    r"([-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+|inf|nan|true|false))[UFL]*", re.IGNORECASE
)
_BETWEEN = re.compile(r"[\s,;\[\]]*")  # separators of the numbers in a matrix
_MEMBER = re.compile(r"([A-Za-z][\w.]*)\.[A-Za-z]\w*")
_HEAD = 65536

_NUMBERS = {"double", "single", "logical", "boolean", "bool", *INTEGERS}
_TEXTS = {"char", "string"}
_NOT_DATA = ("Simulink.ConfigSet", "Simulink.ConfigSetRef", "Simulink.VariantConfigurationData")
_TRUTH = {"true": "1", "false": "0"}
_MAX_DEPTH = 50
_MAX_DIMENSION = 1_000_000_000  # values along one dimension
_EXTENSION_REMEDY = "The extension of data dictionaries is .sldd."

_ENUMERATION = "Simulink.data.dictionary.EnumTypeDefinition"


def text_chunks(raw: bytes, diagnostics: ReadDiagnostics) -> list[SectionNode]:
    """Parse the chunks of a text dictionary; errors are recorded."""
    try:
        parts = json.loads(raw)[_PARTS]
        contents = [parts[name][_CONTENT] for name in sorted(parts) if name.startswith(_PART)]
        if not contents:
            diagnostics.error("", "is not a data dictionary: part data/chunk0 is missing", COMPLETE_COPY)
        return [_chunk(content) for content in contents]
    except RecursionError:
        diagnostics.error("", "is nested too deeply", COMPLETE_COPY)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        diagnostics.error("", f"is not a data dictionary: {str(error)[:80]}", COMPLETE_COPY)
    return []


def _chunk(content: Mapping[str, Any]) -> SectionNode:
    entries = [_object("DD.ENTRY", _text("Name", entry["name"]), _text_value("Value", entry["value"]))
               for entry in content.get("entries", ())]  # fmt: skip
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
    """Return a property section, or an element section if the name is empty."""
    keys = {key: value for key, value in (("Name", name), ("Class", kind), ("Dimension", size)) if value}
    return SectionNode("P" if name else "Element", 0, keys, parts or [], text=text)


def _text_value(name: str, value: Any) -> SectionNode:
    # before int, of which bool is a subclass
    if isinstance(value, bool):
        return _section(name, "logical", str(int(value)))
    if isinstance(value, int | float):
        return _section(name, "double", repr(value))
    if isinstance(value, str):
        return _section(name, "char", value)
    if isinstance(value, list):
        return _list_section(name, value)
    return _object_section(name, value) if isinstance(value, dict) else _section(name, "")


def _list_section(name: str, values: list[Any]) -> SectionNode:
    """Return the section of a row of numbers, a text, or a cell array."""
    # ["text"] is a string of MATLAB, which is not a cell array
    if len(values) == 1 and isinstance(values[0], str):
        return _section(name, "string", values[0])
    if not all(isinstance(value, int | float) for value in values):
        return _section(name, "cell", "", "", [_text_value("", value) for value in values])
    numbers = " ".join(repr(float(value)) for value in values)
    return _section(name, "double", numbers, f"1*{len(values)}" if values else "0*0")


def _object_section(name: str, value: dict[str, Any]) -> SectionNode:
    """Return the section of typed numbers, an array of structs, cells or objects, or an object."""
    if "_type" in value:
        return _typed_numbers(name, str(value["_type"]), str(value.get("_value", "")))
    size = "*".join(str(int(n)) for n in value.get("_dimensions", ()))
    elements = value.get("_elements", [])
    if "_object_class" in value:
        return _section(name, "", parts=[_text_properties(str(value["_object_class"]), value.get("_properties", {}))])
    if "_array_class" in value:
        kind = str(value["_array_class"])
        sections = [
            _text_properties(str(element.get("_object_class", kind)), element.get("_properties", {}))
            for element in elements
        ]
        return _section(name, "", size=size, parts=sections)
    if value.get("_array_type") == "Struct":
        return _section(name, "struct", size=size, parts=[_text_properties("", element) for element in elements])
    if value.get("_array_type") in ("Cell", "String"):
        return _section(name, "cell", size=size, parts=[_text_value("", element) for element in elements])
    return _section(name, str(value.get("_array_type", "unknown")))


def _text_properties(kind: str, properties: Mapping[str, Any]) -> SectionNode:
    return _section("", kind, parts=[_text_value(key, element) for key, element in properties.items()])


def _typed_numbers(name: str, kind: str, written: str) -> SectionNode:
    """Return the section of typed numbers, converted from row to column order.

    Other content stays as written, to be rejected later.
    """
    match = _MATRIX.match(written)
    body = match[3] if match else written
    # what remains without the numbers must be separators: `1 + 2i` is not the row 1, 2
    if not _BETWEEN.fullmatch(_NUMBER.sub("", body)):
        return _section(name, kind, body)
    numbers = [number.lower() for number in _NUMBER.findall(body)]
    if match is None:
        return _section(name, kind, " ".join(numbers), "" if len(numbers) == 1 else f"1*{len(numbers)}")
    rows, columns = int(match[1]), int(match[2])
    if rows * columns == len(numbers):
        # element (row, column) is at row * columns + column in the text, at column * rows + row in XML
        numbers = [numbers[row * columns + column] for column in range(columns) for row in range(rows)]
    return _section(name, kind, " ".join(numbers), f"{rows}*{columns}")


@dataclass(frozen=True)
class Dictionary:
    """A data dictionary.

    `references` are the names of referenced dictionaries; `solvers` are the configurations by name; `types` are the
    names of enumerated types, buses and aliases, `enumerations` the members of enumerated types by name, and
    `definitions` the objects of the other types.
    """

    path: Path
    data: StoredVariables = field(default_factory=StoredVariables)
    references: tuple[str, ...] = ()
    solvers: Mapping[str, StoredSolver] = field(default_factory=dict)
    types: tuple[str, ...] = ()
    enumerations: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    definitions: StoredVariables = field(default_factory=StoredVariables)

    def merged_with(self, further: "Dictionary") -> "Dictionary":
        """Add the entries of another dictionary to those of this one, which take precedence."""
        return replace(
            self,
            data=self.data.merged_with(further.data),
            definitions=self.definitions.merged_with(further.definitions),
            solvers={**further.solvers, **self.solvers},
            types=tuple(dict.fromkeys((*self.types, *further.types))),
            enumerations={**further.enumerations, **self.enumerations},
        )


def read_dictionary(
    path: str | Path,
    follow: bool = True,
    folders: Sequence[Path] = (),
    given: Collection[str] = (),
    known: dict[Path, Dictionary] | None = None,
) -> Dictionary:
    """Read the variables of a `.sldd` file.

    Args:
        path: the dictionary.
        follow: read referenced dictionaries next to it, too; entries of the file itself take precedence.
        folders: further folders to search for referenced dictionaries.
        given: names of files that the user gives; references to these are not followed.
        known: files that have been read, to which those read here are added.

    Returns:
        The dictionary; `data.unreadable` lists undecodable entries and missing or damaged references.

    Raises:
        InputError: if the file itself is not a dictionary.
    """
    path, known = Path(path), {} if known is None else known
    read, seen = _read_once(path, known), {path.resolve()}
    waiting = [(path.parent, name) for name in read.references] if follow else []
    while waiting:
        # breadth first: of several entries with one name, that with the fewest references in between wins
        folder, name = waiting.pop(0)
        file = find_beside(name, (folder, *folders)) or folder / file_name(name)
        # dictionaries may refer to each other in a circle
        if file.resolve() in seen or file.name in given:
            continue
        seen.add(file.resolve())
        further = _read_referenced(file, name, known)
        read = read.merged_with(further)
        waiting += [(folder, reference) for reference in further.references]
    return read


def find_beside(name: str, folders: Iterable[Path]) -> Path | None:
    """Find the file of a name in the first folder that contains it; folders within the name are ignored."""
    # a folder within the name could lead to any file of the machine
    plain = file_name(name)
    return next((path for folder in folders if plain and (path := folder / plain).is_file()), None)


def _read_referenced(file: Path, name: str, known: dict[Path, Dictionary]) -> Dictionary:
    """Return a referenced dictionary; if it cannot be read, one without entries that gives the reason."""
    why = "this referenced dictionary was not found next to it"
    if file.is_file():
        try:
            return _read_once(file, known)
        except InputError as error:
            why = f"this referenced dictionary: {error.findings[0].message}"
    return Dictionary(file, StoredVariables({}, {name: why}))


def _read_once(path: Path, known: dict[Path, Dictionary]) -> Dictionary:
    if path not in known:
        known[path] = _read_file(path)
    return known[path]


def _read_file(path: Path) -> Dictionary:
    """Return the dictionary of one file; raise `InputError` if it is not one."""
    diagnostics = ReadDiagnostics(path.name)
    with convert_errors(path, "cannot be read"):
        raw = path.read_bytes()
    if not is_zip(raw) and _PARTS.encode() not in raw[:_HEAD]:
        raise InputError.of(Location(path.name), "is not a data dictionary", _EXTENSION_REMEDY)
    roots = _packed(raw, diagnostics) if is_zip(raw) else text_chunks(raw, diagnostics)
    diagnostics.raise_if_errors()
    return _dictionary(path, roots)


def is_chunk(name: str) -> bool:
    """Return True if a member of the archive of a dictionary, without leading slash, holds entries."""
    return name.startswith("data/chunk") and name.endswith(".xml")


def _packed(raw: bytes, diagnostics: ReadDiagnostics) -> list[SectionNode]:
    """Return the chunks of a zip archive; errors are recorded."""
    package = zip_package(raw, diagnostics)
    chunks = sorted(filter(is_chunk, package.names()))
    if not chunks and not diagnostics.errors:
        diagnostics.error("", "is not a data dictionary: part data/chunk0.xml is missing", _EXTENSION_REMEDY)
    read = [package.section(name, fold=False) for name in chunks]
    return [root for root in read if root is not None]


def _dictionary(path: Path, roots: list[SectionNode]) -> Dictionary:
    """Return the dictionary of its chunks: variables, types, configurations and references."""
    entries: dict[str, StoredVariable] = {}
    unreadable: dict[str, str] = {}
    definitions, undefined = dict[str, StoredVariable](), dict[str, str]()
    references: list[str] = []
    solvers: dict[str, StoredSolver] = {}
    types: list[str] = []
    enumerations: dict[str, Mapping[str, float]] = {}
    for entry in (part for root in roots for part in root.all("Object")):
        kind, properties = entry.keys.get("Class", ""), _properties(entry)
        if kind == "DD.DICTIONARYREFERENCE":
            references += [properties[key].text for key in ("Subdictionary", "Name") if key in properties][:1]
        if kind != "DD.ENTRY" or "Value" not in properties:
            continue
        name, section = properties["Name"].text if "Name" in properties else "", properties["Value"]
        # an object is the value itself, or its only element
        classes = {part.keys.get("Class", "") for part in (section, *section.all("Element"))}
        if not classes.isdisjoint(_NOT_DATA):
            solvers[name] = solver_from(section)
        elif _ENUMERATION in classes:
            types.append(name)
            enumerations[name] = enumerals(section)
        elif not classes.isdisjoint(TYPE_CLASSES):
            types.append(name)
            _add(name, section, definitions, undefined)
        else:
            _add(name, section, entries, unreadable)
    data, objects = StoredVariables(entries, unreadable), StoredVariables(definitions, undefined)
    return Dictionary(path, data, tuple(references), solvers, tuple(types), enumerations, objects)


def _add(name: str, section: SectionNode, entries: dict[str, StoredVariable], unreadable: dict[str, str]) -> None:
    try:
        value = _value(section)
    except UnusableValueError as why:
        unreadable[name] = str(why)
        return
    if isinstance(value, StoredVariable):
        entries[name] = replace(value, name=name)
    else:
        word = "char" if isinstance(value, str) else "cell" if isinstance(value, tuple) else "struct"
        entries[name] = StoredVariable(name, value, section.keys.get("Class") or word)


def _properties(section: SectionNode) -> dict[str, SectionNode]:
    return {part.keys["Name"]: part for part in section.all("P") if "Name" in part.keys}


def _value(section: SectionNode, depth: int = 0) -> Value:
    kind = section.keys.get("Class", "")
    if depth > _MAX_DEPTH:
        raise UnusableValueError(f"it is more than {_MAX_DEPTH} levels deep")
    if section.keys.get("Encoding"):
        return _encoded(section)
    if section.keys.get("IsEnum") or _is_member(kind, section):
        return _members(kind, section)
    if kind in _NUMBERS:
        return _numbers(section)
    if kind in _TEXTS:
        return section.text
    if kind == "cell":
        return tuple(_value(part, depth + 1) for part in section.all("Element"))
    if kind == "struct":
        return _several(tuple(_struct(part, depth) for part in section.all("Element")), section)
    if kind == "embedded.fi":
        return _fixed_point(section)
    inner = tuple(_value(part, depth + 1) for part in section.all("Element"))
    if not kind and not inner and not section.text.strip():
        return None
    if inner:
        return _several(inner, section)
    if section.first("P") is not None:
        return stored_variable(kind, _struct(section, depth)) if kind else _struct(section, depth)
    if "." in kind:
        # an enumeration stores the name of its member, an object with only defaults stores nothing
        return section.text.strip() or stored_variable(kind, {})
    raise UnusableValueError(f"its class {kind[:60] or 'none'} is unknown")


def _is_member(kind: str, section: SectionNode) -> bool:
    """Return True if a value is the full name of a member of its class, `Switch.ON`."""
    match = _MEMBER.fullmatch(section.text.strip())
    return match is not None and match[1] == kind and not section.parts


def _members(kind: str, section: SectionNode) -> Value:
    """Return enumerated values: their numbers if the file gives them, else the names of their members.

    They are the text of the section itself or of its elements, which then give the class.
    """
    elements = [*section.all("Element")] or [section]
    kind = kind or elements[0].keys.get("Class", "")
    words = " ".join(part.text.strip() or part.keys.get("EnumerationName", "") for part in elements).split()
    try:
        value: Value = _numbers(replace(section, text=" ".join(words), parts=[]))
    except UnusableValueError:
        names = tuple(word.rpartition(".")[2] for word in words)
        value = names[0] if len(names) == 1 else names
    return StoredVariable("", value, kind, f"{ENUMERATED} {kind}")


def _struct(section: SectionNode, depth: int) -> dict[str, Value]:
    return {name: _value(part, depth + 1) for name, part in _properties(section).items()}


def _several(values: tuple[Value, ...], section: SectionNode) -> Value:
    """Return a single value, or several as a tuple."""
    return values[0] if len(values) == 1 and section.keys.get("Dimension", "1*1") == "1*1" else values


def _numbers(section: SectionNode) -> Value:
    """Return an array stored by columns."""
    # the i of an imaginary part, not that of Inf
    if section.keys.get("IsComplex") in ("1", "true") or "i" in section.text.replace("Inf", "").replace("inf", ""):
        raise UnusableValueError("it is complex")
    written = section.text.split()
    try:
        values = np.array([float(_TRUTH.get(number, number)) for number in written])
        shape = tuple(int(n) for n in section.keys["Dimension"].split("*")) if "Dimension" in section.keys else None
    except ValueError:
        raise UnusableValueError(f"its numbers cannot be read: {section.text.strip()[:40]}") from None
    # without a size: a number, a row, or nothing
    shape = shape or ((1, 1) if values.size == 1 else (min(values.size, 1), values.size))
    if (
        len(shape) > 30
        or min(shape) < 0
        or max(shape) > _MAX_DIMENSION
        # as a float, which cannot overflow
        or values.size != int(np.prod(shape, dtype=float))
    ):
        raise UnusableValueError(f"it has {values.size} numbers for a size of {section.keys.get('Dimension', '')[:40]}")
    return readonly(values.reshape(shape, order="F"))


def _fixed_point(section: SectionNode) -> Value:
    """Return the values of a fixed-point object: slope adjustment x 2^exponent x stored integer + bias."""
    parts = _properties(section)
    texts = {name: part.text.strip() for name, part in parts.items()}
    if texts.get("DataType") != "Fixed" or "intarray" not in parts:
        raise UnusableValueError(f"it is a fi object of the data type {texts.get('DataType', '')[:40] or 'none'}")
    try:
        bits, exponent, slope, bias = (
            float(texts[name]) for name in ("WordLength", "FixedExponent", "SlopeAdjustmentFactor", "Bias")
        )
    except (KeyError, ValueError):
        raise UnusableValueError("the scaling of its fi object cannot be read") from None
    # longer words are stored in several integers
    if bits > 32 or abs(exponent) > 1000:
        raise UnusableValueError(f"it is a fi object of {bits:g} bits, which is not supported")
    stored = _numbers(parts["intarray"])
    assert isinstance(stored, np.ndarray)
    return readonly(np.asarray(slope * 2.0**exponent * stored + bias))


def _encoded(section: SectionNode) -> Value:
    """Return an array stored as bytes."""
    try:
        return mxarray_value(binascii.unhexlify("".join(section.text.split())))
    except (binascii.Error, ValueError):
        raise UnusableValueError("its bytes cannot be decoded") from None
    except MatFileError as error:
        raise UnusableValueError(f"its bytes cannot be decoded: {error}") from None

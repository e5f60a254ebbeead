"""Formats of functions, of what is read with them, and of projects.

Files of other tools are described by the record of their importer.
"""

import re
from itertools import islice

from kennfeld.files.file_format import FileFormat, Role, call, holds_line
from kennfeld.files.head import FileHead
from kennfeld.files.rows import is_row

PART_BEGIN = "__MWOPC_PART_BEGIN__"  # of a Simulink model that is stored as text
CLASSIC = re.compile(r"\s*(?:#[^\n]*\n\s*)*(?:Model|Library|Subsystem)\s*\{")
SURROGATE_KINDS = {
    "static": "kennfeld-static-surrogate",
    "dynamic": "kennfeld-dynamic-surrogate",
    "filtered": "kennfeld-filtered-surrogate",
}
_SURROGATE_HEAD = 200  # characters in which a surrogate states its kind
_DICTIONARY_PART = re.compile(r"data/chunk\d+\.xml")
_CLASS = re.compile(r"^[ \t]*classdef\b", re.MULTILINE)
_SECTION = r"\[{1,2}(?:model|surrogate|dataset|calibration|criterion|optimizer|parameters\.\S+)\]"
_FORMULA_LINES = 20  # that tell formula text
_FORMULA_LINE = re.compile(
    r"\s*(?:(?:\d+\s+)?(?:[A-Za-z_]\w*|%[^%]+%)\s*(?:\[[^\]]*\])?\s*=[^=]"
    r"|(?:input|output|scalar|curve|map|cube|rbf|step|solver|def)\s+\S)"
)


def recognises_surrogate(text: str) -> bool:
    """Return whether a text begins as a stored surrogate does."""
    return any(f'"{kind}"' in text[:_SURROGATE_HEAD] for kind in SURROGATE_KINDS.values())


def recognises_simulink(text: str) -> bool:
    """Return whether a text begins as a Simulink model that is not an archive."""
    return CLASSIC.match(text) is not None or PART_BEGIN in text


def _is_simulink(head: FileHead) -> bool:
    members = {"simulink/blockdiagram.xml", "simulink/blockDiagram.json"}
    return not members.isdisjoint(head.members) or recognises_simulink(head.text)


def _is_enumeration(head: FileHead) -> bool:
    # the importer is loaded only for a file that defines a class
    if head.ending != ".m" or not _CLASS.search(head.text):
        return False
    return call("kennfeld.matlab.enumerations:enumeration_of", head.text) is not None


def _is_formula(head: FileHead) -> bool:
    """Return whether most lines are statements of formula text, and none is a row of numbers."""
    lines = (line.strip() for line in head.text.split("\n"))
    first = list(islice((line for line in lines if line and not line.startswith("#")), _FORMULA_LINES))
    statements = sum(_FORMULA_LINE.match(line) is not None for line in first)
    return 2 * statements > len(first) and not any(map(is_row, first))


def _function(name: str, *endings: str, **settings: object) -> FileFormat:
    return FileFormat(name, endings, role=Role.FUNCTION, **settings)  # type: ignore[arg-type]


_ONE_FUNCTION = "one function, with those that it calls"
_DESCRIBERS = "kennfeld.terminal.describers"
FORMULA = _function(
    "formula text", ".kf", describe=f"{_DESCRIBERS}:describe_formula_file", notes="the [formula language](formula.md)"
)
SIMULINK = _function(
    "Simulink model",
    ".slx",
    ".mdl",
    recognises=_is_simulink,
    notes="`.slx` of all releases: one part for all systems (up to about R2018b) or one part per system; since R2026b "
    "with the block diagram in JSON. `.mdl`: the classic text, including files without block identifiers, in the "
    "encoding that the file states, and the packaged text of R2021b and later; see [below](#simulink)",
)
PROTECTED = _function(
    "protected Simulink model",
    ".slxp",
    description="a protected model; its blocks cannot be read",
    remedy="Obtain the unprotected model, .slx or .mdl.",
    notes="recognised, but its blocks cannot be read",
)
FMU = _function(
    "FMU",
    ".fmu",
    recognises=lambda head: "modelDescription.xml" in head.members,
    notes="functional mock-up units of FMI 2.0 and 3.0; see [FMU](functions.md#fmu)",
)
ONNX = _function("ONNX network", ".onnx", notes="networks and tree ensembles; see [ONNX](functions.md#onnx-networks)")
C = _function("C source", ".c", notes=_ONE_FUNCTION)
PYTHON = _function("Python source", ".py", notes=_ONE_FUNCTION)
APPLICATION = FileFormat("ASCET application", (".app",), role=Role.PROGRAM, notes="task schedules of ASCET-DEVELOPER 7")
HEADER = FileFormat(
    "C header",
    (".h",),
    role=Role.COMPANION,
    description="a C header",
    remedy="Name the C file.",
    notes="declarations that a C file includes",
)
DICTIONARY = FileFormat(
    "Simulink data dictionary",
    (".sldd",),
    lambda head: any(_DICTIONARY_PART.match(member) for member in head.members),
    role=Role.COMPANION,
    description="a Simulink data dictionary (.sldd): which axes its tables have is stated in the model",
    remedy="Convert the model: `kennfeld convert engine.slx engine.kf` writes its values to engine.json.",
    notes="numbers, texts, structs, cells, `Simulink.Parameter`, `Simulink.LookupTable` and `Simulink.Breakpoint` with "
    "limits, units and types. Referenced dictionaries are searched for in the same folder. The text format of R2026b "
    "is also supported. `kennfeld convert` [writes values](how-to/export.md#simulink-data-dictionaries) into a copy of "
    "the XML format",
)
ENUMERATION = FileFormat(
    "enumeration class of MATLAB",
    (".m",),
    _is_enumeration,
    role=Role.COMPANION,
    notes="words and their numbers, for Simulink models",
)
SURROGATE = FileFormat(
    "surrogate",
    (".json",),
    lambda head: recognises_surrogate(head.text),
    role=Role.SURROGATE,
    describe=f"{_DESCRIBERS}:describe_surrogate_file",
)
PROJECT = FileFormat(
    "project file",
    (".toml",),
    role=Role.PROJECT,
    describe=f"{_DESCRIBERS}:describe_toml",
    description="a project file",
)
# texts without a signature, under another ending
PROJECT_TEXT = FileFormat(
    PROJECT.name,
    (),
    holds_line(_SECTION),
    role=PROJECT.role,
    describe=PROJECT.describe,
    description=PROJECT.description,
)
FORMULA_TEXT = FileFormat(FORMULA.name, (), _is_formula, role=FORMULA.role, describe=FORMULA.describe)

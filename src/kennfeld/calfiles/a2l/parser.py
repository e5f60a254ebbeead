"""Parser of A2L files.

Keywords and their order follow ASAM MCD-2 MC (ASAP2) 1.3 to 1.71. A malformed object is skipped with a warning;
a file with unbalanced blocks is refused.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, TypeVar

from kennfeld.calfiles.a2l.definitions import (
    Instances,
    compu_method,
    compu_tab,
    compu_vtab,
    compu_vtab_range,
    record_layout,
)
from kennfeld.calfiles.a2l.objects import A2l, A2lFunction, AxisDescr, AxisPts, Characteristic, ModCommon
from kennfeld.calfiles.a2l.syntax import (
    A2lBlock,
    A2lError,
    Cursor,
    Include,
    parse_blocks,
    parse_integer,
    parse_number,
    unquote,
)
from kennfeld.calfiles.format import Findings

TYPES = ("VALUE", "CURVE", "MAP", "CUBOID", "CUBE_4", "CUBE_5", "VAL_BLK", "ASCII")
AXIS_KINDS = ("STD_AXIS", "COM_AXIS", "FIX_AXIS", "RES_AXIS", "CURVE_AXIS")
_SHARED_OPTIONS = {
    "BYTE_ORDER": 1,
    "DEPOSIT": 1,
    "DISPLAY_IDENTIFIER": 1,
    "ECU_ADDRESS_EXTENSION": 1,
    "EXTENDED_LIMITS": 2,
    "FORMAT": 1,
    "MODEL_LINK": 1,
    "PHYS_UNIT": 1,
    "READ_ONLY": 0,
    "STEP_SIZE": 1,
    "SYMBOL_LINK": 2,
    "REF_MEMORY_SEGMENT": 1,
    "CALIBRATION_ACCESS": 1,
    "MAX_REFRESH": 2,
    "MONOTONY": 1,
    "MAX_GRAD": 1,
}
_CHARACTERISTIC_OPTIONS = _SHARED_OPTIONS | {
    "BIT_MASK": 1,
    "COMPARISON_QUANTITY": 1,
    "ENCODING": 1,
    "MATRIX_DIM": -1,
    "NUMBER": 1,
}
_AXIS_OPTIONS = _SHARED_OPTIONS | {"AXIS_PTS_REF": 1, "CURVE_AXIS_REF": 1, "FIX_AXIS_PAR": 3, "FIX_AXIS_PAR_DIST": 3}
_ALIGNMENTS = ("BYTE", "WORD", "LONG", "INT64", "FLOAT16_IEEE", "FLOAT32_IEEE", "FLOAT64_IEEE")
_COMMON_OPTIONS = dict.fromkeys((f"ALIGNMENT_{name}" for name in _ALIGNMENTS), 1) | {
    "BYTE_ORDER": 1,
    "DATA_SIZE": 1,
    "DEPOSIT": 1,
    "S_REC_LAYOUT": 1,
}

Made = TypeVar("Made", bound=Any)


def parse_a2l(raw: bytes, name: str, findings: Findings, include: Include | None = None) -> A2l:
    """Return the objects of an A2L file. `include` gives the content of a file that the text includes, by its name.

    Notes an error if the blocks do not fit together or no module is there, and a remark for each object that is
    skipped. Call `findings.finish()` before using the result.
    """
    root, sound = parse_blocks(raw, name, findings, include)
    projects = list(root.inner("PROJECT"))
    modules = [module for project in projects for module in project.inner("MODULE")] or list(root.inner("MODULE"))
    if not modules and not sound:
        return A2l(name)
    if not modules:
        findings.error(0, "", "has no MODULE", "Export it as ASAP2 1.3 to 1.71.")
        return A2l(name)
    chosen = next((module for module in modules if any(module.inner("CHARACTERISTIC"))), modules[0])
    for module in modules:
        if module is not chosen:
            findings.warning(module.line, _first_word(module), "is an additional MODULE; skipped")
    return _Module(chosen, findings).read(name, _version(root), _first_word(projects[0]) if projects else "")


def _version(root: A2lBlock) -> str:
    words = root.tokens
    if "ASAP2_VERSION" not in words:
        return ""
    return ".".join(words[words.index("ASAP2_VERSION") + 1 :][:2])


def _first_word(block: A2lBlock) -> str:
    return unquote(block.tokens[0])[:80] if block.tokens else ""


class _Module:
    def __init__(self, module: A2lBlock, findings: Findings) -> None:
        self.module, self.findings = module, findings
        self.by_label: dict[str, list[str]] = {}  # the functions of each label

    def read(self, file: str, version: str, project: str) -> A2l:
        functions = self._all("FUNCTION", _parse_function)
        for function in functions.values():
            for label in function.labels:
                self.by_label.setdefault(label, []).append(function.name)
        axis_pts = self._all("AXIS_PTS", self._axis_pts)
        characteristics = self._all("CHARACTERISTIC", self._characteristic)
        instances = Instances(self.module, self.findings, typedef_characteristic, typedef_axis, self.by_label)
        more, more_axes = instances.expanded()
        return A2l(
            file=file,
            version=version,
            project=project,
            module=_first_word(self.module),
            common=self._common(),
            characteristics=self._joined(characteristics, more),
            axis_pts=self._joined(axis_pts, more_axes),
            compu_methods=self._all("COMPU_METHOD", compu_method),
            compu_tabs=self._all("COMPU_TAB", compu_tab),
            compu_vtabs=self._all("COMPU_VTAB", compu_vtab) | self._all("COMPU_VTAB_RANGE", compu_vtab_range),
            record_layouts=self._all("RECORD_LAYOUT", record_layout),
            functions=functions,
            measurements=sum(1 for _ in self.module.inner("MEASUREMENT")),
            variant_coded=self._variant_coded(),
            epk=self._identity("EPK"),
            epk_addresses=tuple(
                place for word in self._words("ADDR_EPK") if (place := parse_integer(word)) is not None
            ),
        )

    def _all(self, keyword: str, make: Callable[[A2lBlock], Made]) -> dict[str, Made]:
        """Return the objects of one keyword by name; of two with one name the first counts."""
        result: dict[str, Made] = {}
        for block in self.module.inner(keyword):
            try:
                found = make(block)
            except A2lError as error:
                self.findings.warning(block.line, _first_word(block) or keyword, f"{keyword} {error}; skipped")
                continue
            if found.name in result:
                message = f"duplicate {keyword}; the first one is used"
                self.findings.warning(block.line, found.name, message)
            else:
                result[found.name] = found
        return result

    def _joined(self, given: dict[str, Made], more: Mapping[str, Made]) -> dict[str, Made]:
        for name, result in more.items():
            if name in given:
                self.findings.warning(result.line, name, "is the name of an instance and of another label; skipped")
        return given | {name: result for name, result in more.items() if name not in given}

    def _common(self) -> ModCommon:
        for block in self.module.inner("MOD_COMMON"):
            try:
                options = Cursor(block).options(_COMMON_OPTIONS)
            except A2lError as error:
                self.findings.warning(block.line, "MOD_COMMON", f"{error}; skipped")
                continue
            return ModCommon(
                byte_order=options.get("BYTE_ORDER", [""])[0],
                deposit=options.get("DEPOSIT", [""])[0],
                alignments=_alignments(options),
            )
        return ModCommon()

    def _variant_coded(self) -> frozenset[str]:
        found = [one for block in self.module.inner("VARIANT_CODING") for one in block.inner("VAR_CHARACTERISTIC")]
        return frozenset(_first_word(one) for one in found)

    def _identity(self, keyword: str) -> str:
        return next((unquote(word)[:200] for word in self._words(keyword)), "")

    def _words(self, keyword: str) -> list[str]:
        """Return the word after each occurrence of a keyword in MOD_PAR."""
        words = [word for block in self.module.inner("MOD_PAR") for word in block.tokens]
        return [after for word, after in pairwise(words) if word == keyword]

    def _axis_pts(self, block: A2lBlock) -> AxisPts:
        cursor = Cursor(block)
        name, description, address = cursor.word("name"), cursor.text("description"), cursor.whole("address")
        result = _axis_pts(block, cursor, name, description, address)
        return _with_functions(result, self.by_label, block)

    def _characteristic(self, block: A2lBlock) -> Characteristic:
        cursor = Cursor(block)
        name, description, kind = cursor.word("name"), cursor.text("description"), cursor.word("type")
        result = _characteristic(block, cursor, name, description, kind, cursor.whole("address"))
        return _with_functions(result, self.by_label, block)


def typedef_characteristic(block: A2lBlock) -> Characteristic:
    """Return a TYPEDEF_CHARACTERISTIC: a characteristic at address 0."""
    cursor = Cursor(block)
    name, description, kind = cursor.word("name"), cursor.text("description"), cursor.word("type")
    return _characteristic(block, cursor, name, description, kind, 0)


def typedef_axis(block: A2lBlock) -> AxisPts:
    """Return a TYPEDEF_AXIS: breakpoints at address 0."""
    cursor = Cursor(block)
    name, description = cursor.word("name"), cursor.text("description")
    return _axis_pts(block, cursor, name, description, 0)


def _axis_pts(block: A2lBlock, cursor: Cursor, name: str, description: str, address: int) -> AxisPts:
    input_quantity, layout = cursor.word("input quantity"), cursor.word("record layout")
    cursor.number("largest difference")
    conversion, most = cursor.word("conversion"), cursor.whole("number of axis points")
    lower, upper = cursor.number("lower limit"), cursor.number("upper limit")
    shared = _shared_attributes(cursor.options(_SHARED_OPTIONS))
    return AxisPts(
        name, description, address, input_quantity, layout, conversion, most, lower, upper, line=block.line, **shared
    )


def _characteristic(
    block: A2lBlock, cursor: Cursor, name: str, description: str, kind: str, address: int
) -> Characteristic:
    if kind not in TYPES:
        raise A2lError(f"has the unknown type {kind[:40]!r}")
    layout = cursor.word("record layout")
    cursor.number("largest difference")
    conversion = cursor.word("conversion")
    lower, upper = cursor.number("lower limit"), cursor.number("upper limit")
    options = cursor.options(_CHARACTERISTIC_OPTIONS)
    shared = _shared_attributes(options)
    del shared["deposit"]
    return Characteristic(
        name,
        description,
        kind,
        address,
        layout,
        conversion,
        lower,
        upper,
        axes=tuple(_axis_descr(axis) for axis in block.inner("AXIS_DESCR")),
        number=_integer_option(options, "NUMBER") or 0,
        matrix_dim=_matrix_sizes(options),
        bit_mask=_integer_option(options, "BIT_MASK"),
        encoding=options.get("ENCODING", [""])[0],
        dependent_on=_formula_inputs(block),
        virtual=any(block.inner("VIRTUAL_CHARACTERISTIC")),
        line=block.line,
        **shared,
    )


def _axis_descr(block: A2lBlock) -> AxisDescr:
    cursor = Cursor(block)
    kind, input_quantity, conversion = cursor.word("kind"), cursor.word("input quantity"), cursor.word("conversion")
    if kind not in AXIS_KINDS:
        raise A2lError(f"has an axis of the unknown kind {kind[:40]!r}")
    most = cursor.whole("number of axis points")
    lower, upper = cursor.number("lower limit"), cursor.number("upper limit")
    options = cursor.options(_AXIS_OPTIONS)
    shared = _shared_attributes(options)
    del shared["display_identifier"]
    return AxisDescr(
        kind,
        input_quantity,
        conversion,
        most,
        lower,
        upper,
        axis_pts_ref=options.get("AXIS_PTS_REF", [""])[0],
        curve_axis_ref=options.get("CURVE_AXIS_REF", [""])[0],
        fix_axis_par=_parse_shifted_axis(options),
        fix_axis_par_dist=_parse_spaced_axis(options),
        fix_axis_par_list=tuple(point for inner in block.inner("FIX_AXIS_PAR_LIST") for point in _parse_points(inner)),
        **shared,
    )


def _parse_points(block: A2lBlock) -> tuple[float, ...]:
    cursor = Cursor(block)
    return tuple(cursor.number("axis point") for _ in range(cursor.left()))


def _parse_shifted_axis(options: Mapping[str, list[str]]) -> tuple[float, int, int] | None:
    given = options.get("FIX_AXIS_PAR")
    if given is None:
        return None
    offset, shift, count = parse_number(given[0]), parse_integer(given[1]), parse_integer(given[2])
    if offset is None or shift is None or count is None or not -64 <= shift <= 64:
        raise A2lError("has an invalid FIX_AXIS_PAR: must be offset, shift and number")
    return offset, shift, count


def _parse_spaced_axis(options: Mapping[str, list[str]]) -> tuple[float, float, int] | None:
    given = options.get("FIX_AXIS_PAR_DIST")
    if given is None:
        return None
    offset, distance, count = parse_number(given[0]), parse_number(given[1]), parse_integer(given[2])
    if offset is None or distance is None or count is None:
        raise A2lError("has an invalid FIX_AXIS_PAR_DIST: must be offset, distance and number")
    return offset, distance, count


def _shared_attributes(options: Mapping[str, list[str]]) -> dict[str, Any]:
    limits = [parse_number(word) for word in options.get("EXTENDED_LIMITS", [])]
    return {
        "byte_order": options.get("BYTE_ORDER", [""])[0],
        "deposit": options.get("DEPOSIT", [""])[0],
        "phys_unit": options.get("PHYS_UNIT", [""])[0],
        "display_identifier": options.get("DISPLAY_IDENTIFIER", [""])[0],
        "extended_limits": (limits[0], limits[1]) if limits and None not in limits else None,
        "read_only": "READ_ONLY" in options or options.get("CALIBRATION_ACCESS") == ["NO_CALIBRATION"],
    }


def _integer_option(options: Mapping[str, list[str]], keyword: str) -> int | None:
    given = options.get(keyword)
    value = None if given is None else parse_integer(given[0])
    if given is not None and value is None:
        raise A2lError(f"has {given[0][:40]!r} after {keyword}, which must be an integer")
    return value


def _matrix_sizes(options: Mapping[str, list[str]]) -> tuple[int, ...]:
    sizes = tuple(size for word in options.get("MATRIX_DIM", []) if (size := parse_integer(word)) is not None)
    if any(size < 0 for size in sizes) or len(sizes) > 5:
        raise A2lError(f"has an invalid MATRIX_DIM: {' '.join(map(str, sizes))[:60]}")
    # ASAP2 1.6 writes three sizes, zeros and ones for what is not there
    return tuple(size or 1 for size in sizes) if any(sizes) else ()


def _alignments(options: Mapping[str, list[str]]) -> dict[str, int]:
    prefix = "ALIGNMENT_"
    found = {
        key.removeprefix(prefix): parse_integer(given[0]) for key, given in options.items() if key.startswith(prefix)
    }
    return {name: size for name, size in found.items() if size is not None and 1 <= size <= 64}


def _formula_inputs(block: A2lBlock) -> tuple[str, ...]:
    found = (inner for inner in block.inner("DEPENDENT_CHARACTERISTIC"))
    return tuple(unquote(word) for inner in found for word in inner.tokens[1:])


def _with_functions(made: Made, by_label: Mapping[str, list[str]], block: A2lBlock) -> Made:
    own = [unquote(word) for inner in block.inner("FUNCTION_LIST") for word in inner.tokens]
    functions = tuple(dict.fromkeys([*by_label.get(made.name, ()), *own]))
    return replace(made, functions=functions) if functions else made


def _parse_function(block: A2lBlock) -> A2lFunction:
    cursor = Cursor(block)
    name, description = cursor.word("name"), cursor.text("description")
    inner = block.inner("DEF_CHARACTERISTIC")
    return A2lFunction(name, description, tuple(unquote(word) for one in inner for word in one.tokens))

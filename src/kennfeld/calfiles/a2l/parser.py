"""Parser of A2L files.

Keywords and their order follow ASAM MCD-2 MC (ASAP2) 1.3 to 1.71. A malformed object is skipped with a warning;
a file with unbalanced blocks is refused.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, TypeVar

from kennfeld.calfiles.a2l import definitions
from kennfeld.calfiles.a2l.characteristics import parse_axis_pts, parse_characteristic
from kennfeld.calfiles.a2l.instances import Instances
from kennfeld.calfiles.a2l.objects import A2l, A2lFunction, ModCommon
from kennfeld.calfiles.a2l.syntax import A2lBlock, A2lError, Cursor, Include, parse_blocks, parse_integer, unquote
from kennfeld.calfiles.format import FileFindings

_ALIGNMENTS = ("BYTE", "WORD", "LONG", "INT64", "FLOAT16_IEEE", "FLOAT32_IEEE", "FLOAT64_IEEE")
_COMMON_WORDS = ("BYTE_ORDER", "DATA_SIZE", "DEPOSIT", "S_REC_LAYOUT")
_COMMON_OPTIONS = dict.fromkeys((*(f"ALIGNMENT_{name}" for name in _ALIGNMENTS), *_COMMON_WORDS), 1)

Object = TypeVar("Object", bound=Any)


def parse_a2l(raw: bytes, name: str, findings: FileFindings, include: Include | None = None) -> A2l:
    """Return the objects of an A2L file. `include` gives the content of a file that the text includes, by its name.

    Reports an error if the blocks do not fit together or no module is there, and a warning for each object that is
    skipped. Call `findings.finish()` before using the result.
    """
    root, sound = parse_blocks(raw, name, findings, include)
    projects = list(root.inner("PROJECT"))
    modules = [module for project in projects for module in project.inner("MODULE")] or list(root.inner("MODULE"))
    if not modules:
        if sound:
            findings.error(0, "", "has no MODULE", "Export it as ASAP2 1.3 to 1.71.")
        return A2l(name)
    # a module without labels may come first
    chosen = next((module for module in modules if any(module.inner("CHARACTERISTIC"))), modules[0])
    for module in modules:
        if module is not chosen:
            findings.warning(module.line, module.name, "is an additional MODULE; skipped")
    # ASAP2_VERSION stands outside of all blocks
    words = root.tokens
    version = words[words.index("ASAP2_VERSION") + 1 :][:2] if "ASAP2_VERSION" in words else []
    return _Module(chosen, findings).read(name, ".".join(version), projects[0].name if projects else "")


class _Module:
    def __init__(self, module: A2lBlock, findings: FileFindings) -> None:
        self.module, self.findings = module, findings
        self.by_label: dict[str, list[str]] = {}  # the functions of each label

    def read(self, file: str, version: str, project: str) -> A2l:
        functions = self._all("FUNCTION", _parse_function)
        for function in functions.values():
            for label in function.labels:
                self.by_label.setdefault(label, []).append(function.name)
        axis_pts = self._all("AXIS_PTS", lambda block: self._with_functions(parse_axis_pts(block), block))
        characteristics = self._all(
            "CHARACTERISTIC", lambda block: self._with_functions(parse_characteristic(block), block)
        )
        # after the functions, as instances refer to them as well
        instances = Instances(self.module, self.findings, self.by_label)
        coded = (inner for block in self.module.inner("VARIANT_CODING") for inner in block.inner("VAR_CHARACTERISTIC"))
        addresses = map(parse_integer, self._parameter_words("ADDR_EPK"))
        return A2l(
            file=file,
            version=version,
            project=project,
            module=self.module.name,
            common=self._common(),
            characteristics=self._join(characteristics, instances.characteristics),
            axis_pts=self._join(axis_pts, instances.axis_pts),
            compu_methods=self._all("COMPU_METHOD", definitions.parse_compu_method),
            compu_tabs=self._all("COMPU_TAB", definitions.parse_compu_tab),
            compu_vtabs=self._all("COMPU_VTAB", definitions.parse_compu_vtab)
            | self._all("COMPU_VTAB_RANGE", definitions.parse_compu_vtab),
            record_layouts=self._all("RECORD_LAYOUT", definitions.parse_record_layout),
            functions=functions,
            measurements=sum(1 for _ in self.module.inner("MEASUREMENT")),
            variant_coded=frozenset(block.name for block in coded),
            epk=next((unquote(word)[:200] for word in self._parameter_words("EPK")), ""),
            epk_addresses=tuple(address for address in addresses if address is not None),
        )

    def _all(self, keyword: str, parse: Callable[[A2lBlock], Object]) -> dict[str, Object]:
        """Return the objects of one keyword by name; of two with one name the first counts."""
        objects: dict[str, Object] = {}
        for block in self.module.inner(keyword):
            try:
                item = parse(block)
            except A2lError as error:
                self.findings.warning(block.line, block.name, f"{keyword} {error}; skipped")
                continue
            if objects.setdefault(item.name, item) is not item:
                self.findings.warning(block.line, item.name, f"duplicate {keyword}; the first one is used")
        return objects

    def _with_functions(self, item: Object, block: A2lBlock) -> Object:
        # a function may list its labels, and a label its functions
        own = [unquote(word) for inner in block.inner("FUNCTION_LIST") for word in inner.tokens]
        return replace(item, functions=tuple(dict.fromkeys([*self.by_label.get(item.name, ()), *own])))

    def _join(self, labels: dict[str, Object], more: Mapping[str, Object]) -> dict[str, Object]:
        for name in filter(labels.__contains__, more):
            message = "is the name of an instance and of another label; skipped"
            self.findings.warning(more[name].line, name, message)
        return {**labels, **{name: item for name, item in more.items() if name not in labels}}

    def _common(self) -> ModCommon:
        for block in self.module.inner("MOD_COMMON"):
            try:
                options = Cursor(block).options(_COMMON_OPTIONS)
            except A2lError as error:
                self.findings.warning(block.line, "MOD_COMMON", f"{error}; skipped")
                continue
            sizes = {name: parse_integer(options.get(f"ALIGNMENT_{name}", [""])[0]) for name in _ALIGNMENTS}
            alignments = {name: size for name, size in sizes.items() if size is not None and 1 <= size <= 64}
            return ModCommon(options.get("BYTE_ORDER", [""])[0], options.get("DEPOSIT", [""])[0], alignments)
        return ModCommon()

    def _parameter_words(self, keyword: str) -> list[str]:
        """Return the word after each occurrence of a keyword in MOD_PAR."""
        words = [word for block in self.module.inner("MOD_PAR") for word in block.tokens]
        return [after for word, after in pairwise(words) if word == keyword]


def _parse_function(block: A2lBlock) -> A2lFunction:
    cursor = Cursor(block)
    name, description = cursor.word("name"), cursor.text("description")
    words = (word for inner in block.inner("DEF_CHARACTERISTIC") for word in inner.tokens)
    return A2lFunction(name, description, tuple(map(unquote, words)))

"""Reads TunerStudio tunes (.msq), the settings of MegaSquirt, Speeduino and rusEFI controllers.

A tune is XML with a `constant` or `pcVariable` per setting: numbers separated by blanks, one row of a table per y, or
words in quotes. It stores tables and their breakpoints as unrelated constants; the firmware's definition file (`.ini`)
pairs them in its sections TableEditor and CurveEditor. Without that file in the folder of the tune, the usual pairs of
Speeduino, MS2/Extra, MS3 and rusEFI are tried, as their public definition files state them.
"""

import re
from bisect import bisect
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field, replace
from html import unescape
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import CalibrationSource, Findings, ReadResult
from kennfeld.calfiles.xml_tree import parse_xml
from kennfeld.formatting import count_noun
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Block, Parameter, Scalar, Text, TextKind, parameter

_MAX_FILE_BYTES = 20_000_000
_MAX_FILES = 50
_SIGNATURE = re.compile(r'^[ \t]*signature[ \t]*=[ \t]*"([^"\n]*)"', re.MULTILINE)
_LINE = re.compile(r"[ \t]*(\w+)[ \t]*=[ \t]*(.*)")
_WORD = re.compile(r'"([^"]*)"|([^",;\s][^",;]*)')
_STRING = re.compile(r"^[ \t]*(\w+)[ \t]*=[ \t]*string[ \t]*,", re.MULTILINE | re.IGNORECASE)
_SECTION = re.compile(r"[ \t]*\[([^\]]+)\]")

_SPEEDUINO_TABLES = """
veTable rpmBins fuelLoadBins, veTable2 fuelRPM2Bins fuelLoad2Bins, advTable1 rpmBins2 mapBins1
advTable2 rpmBins3 mapBins2, afrTable rpmBinsAFR loadBinsAFR, lambdaTable rpmBinsAFR loadBinsAFR
boostTable rpmBinsBoost tpsBinsBoost, boostTableDutyLookup rpmBinsDutyLookup loadBinsDutyLookup
vvtTable rpmBinsVVT loadBinsVVT, vvt2Table rpmBinsVVT2 loadBinsVVT2, wmiTable rpmBinsWMI mapBinsWMI
stagingTable rpmBinsStaging loadBinsStaging, dwellTable rpmBinsDwell loadBinsDwell
"""
_TRIMS = "".join(f", fuelTrim{n}Table fuelTrim{n}rpmBins fuelTrim{n}loadBins" for n in range(1, 9))
_OTHER_TABLES = """
veTable1 frpm_table1 fmap_table1, veTable2 frpm_table2 fmap_table2, veTable3 frpm_table3 fmap_table3
advanceTable1 srpm_table1 smap_table1, advanceTable2 srpm_table2 smap_table2
afrTable1 arpm_table1 amap_table1, afrTable2 arpm_table2 amap_table2
veTable veRpmBins veLoadBins, ignitionTable ignitionRpmBins ignitionLoadBins, lambdaTable lambdaRpmBins lambdaLoadBins
"""
_CURVES = """
taeRates taeBins, maeRates maeBins, dwellRates brvBins, injBatRates brvBins, injAng injAngRPM, airDenRates airDenBins
baroFuelValues baroFuelBins, fuelTempValues fuelTempBins, iatRetRates iatRetBins, cltAdvValues cltAdvBins
idleAdvValues idleAdvBins, PWMFanDuty fanPWMBins, iacOLPWMVal iacBins, iacCrankDuty iacCrankBins, iacOLStepVal iacBins
iacCrankSteps iacCrankBins, iacCLValues iacBins, rotarySplitValues rotarySplitBins, wueRates wueBins, wueAFR wueBins
wueRecommended wueBins, crankingEnrichValues crankingEnrichBins, primePulse primeBins, asePct aseBins, aseCount aseBins
flexFuelAdj flexFuelBins, flexAdvAdj flexAdvBins, flexBoostAdj flexBoostBins, knock_window_angle knock_window_rpms
knock_window_dur knock_window_rpms, oilPressureProtMins oilPressureProtRPM, coolantProtRPM coolantProtTemp
rollingProtCutPercent rollingProtRPMDelta, wmiAdvAdj wmiAdvBins
"""

_ROOT = re.compile(r"<(?:[\w.-]+:)?msq[\s/>]")
_PROLOG = 20_000  # characters before the root
_ATTRIBUTES = r"""((?:\s+[\w:.-]+\s*=\s*(?:"[^"]*"|'[^']*'))*)"""
_PART = re.compile(
    rf"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<(page|constant|pcVariable|versionInfo){_ATTRIBUTES}\s*(/?)>([^<]*)", re.DOTALL
)
_ATTRIBUTE = re.compile(r"""([\w:.-]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_COUNT = re.compile(r"[0-9]{1,6}")
_WORD_KINDS: tuple[TextKind, TextKind] = ("text", "enumeration")  # without and within quotes
_NUMBER = re.compile(r"[-+0-9.eE]+")


@dataclass(frozen=True)
class Pair:
    """A table with its axes: names of constants, the channels on the axes, and the title an editor shows."""

    values: str
    axes: tuple[str, ...]
    inputs: tuple[str, ...] = ("", "")
    title: str = ""


def find_definition(path: Path | None, signature: str, findings: Findings) -> str | None:
    """Return the text of a tune's definition file: the one with its signature, or mainController.ini."""
    if path is None or not path.parent.is_dir():
        return None
    texts = dict(_definitions(path))
    for text in texts.values():
        if signature and signature in _SIGNATURE.findall(text):
            return text
    for file, text in texts.items():
        if file.name.casefold() == "maincontroller.ini":
            said = next(iter(_SIGNATURE.findall(text)), "")
            message = f"{file.name} is for the firmware {said!r}, but the tune for {signature!r}"
            findings.warning(
                0, "", message, "Tables may have wrong axes: put the matching definition file next to the tune."
            )
            return text
    return None


def _definitions(path: Path) -> Iterator[tuple[Path, str]]:
    try:
        folders = [path.parent, path.parent / "projectCfg"]
        files = sorted(file for folder in folders if folder.is_dir() for file in folder.iterdir())
        found = [file for file in files if file.suffix.casefold() == ".ini" and file.is_file()]
        for file in found[:_MAX_FILES]:
            if file.stat().st_size <= _MAX_FILE_BYTES:
                yield file, CalibrationSource(file.name, file.read_bytes()).text
    except OSError:
        return


def strings_of(definition: str) -> frozenset[str]:
    """Return the constants that a definition file declares as free text, not as a choice of words."""
    return frozenset(_STRING.findall(definition))


def pairs_of(definition: str) -> list[Pair]:
    """Return the tables and curves that a definition file shows in its editors, in its order."""
    results: list[Pair] = []
    section, title = "", ""
    bins: dict[str, list[str]] = {}
    for line in definition.split("\n"):
        named = _SECTION.match(line)
        if named:
            section, bins = named[1].strip().casefold(), {}
        setting = _LINE.match(line)
        if setting is None or section not in ("tableeditor", "curveeditor"):
            continue
        key = setting[1].casefold()
        words = [quoted or plain.strip() for quoted, plain in _WORD.findall(setting[2].partition(";")[0])]
        if key in ("table", "curve"):
            bins, title = {}, _title(setting[2])
        elif key in ("xbins", "ybins", "zbins") and words:
            bins[key] = words
            results += _complete_pair(section, key, bins, title)
    return results


def _title(rest: str) -> str:
    quoted = re.search(r'"([^"]*)"', rest)
    return quoted[1] if quoted else ""


def _complete_pair(section: str, key: str, bins: dict[str, list[str]], title: str) -> list[Pair]:
    """Return the pair that one more line of an editor completes."""
    if section == "tableeditor":
        if len(bins) < 3:
            return []
        x, y = bins["xbins"], bins["ybins"]
        return [Pair(bins["zbins"][0], (x[0], y[0]), (_input_name(x), _input_name(y)), title)]
    if key == "ybins" and "xbins" in bins:
        return [Pair(bins["ybins"][0], (bins["xbins"][0],), (_input_name(bins["xbins"]), ""), title)]
    return []


def _input_name(words: list[str]) -> str:
    return words[1] if len(words) > 1 and re.fullmatch(r"\w+", words[1]) else ""


def usual_pairs() -> list[Pair]:
    """Return the pairs of the common firmwares; of several for one table, the one that fits is used."""
    listed = f"{_SPEEDUINO_TABLES.strip()}{_TRIMS}\n{_OTHER_TABLES}\n{_CURVES}"
    words = (entry.split() for entry in re.split(r"[,\n]", listed))
    return [Pair(first, tuple(axes)) for first, *axes in filter(None, words)]


@dataclass(frozen=True)
class Constant:
    """One setting: its attributes, and the location of its content in the file."""

    name: str
    line: int
    begin: int
    content: str
    unit: str = ""
    digits: int | None = None
    sizes: tuple[int, int] | None = None  # rows and columns
    page: str = ""

    @property
    def words(self) -> list[str]:
        """The numbers as written; empty if the content is not a list of numbers."""
        words = self.content.split()
        return words if all(map(_NUMBER.fullmatch, words)) else []


@dataclass(frozen=True, eq=False)
class Msq:
    """A tune as read: its text, its constants and their content."""

    source: CalibrationSource
    text: str
    constants: Mapping[str, Constant]
    items: Mapping[str, Parameter | Text]
    axes: Mapping[str, Axis]


def recognises_msq(text: str) -> bool:
    """Check whether a text is XML whose root is that of a tune."""
    return text.lstrip("\ufeff \n\t").startswith("<") and _ROOT.search(text[:_PROLOG]) is not None


def read_msq(source: CalibrationSource) -> ReadResult:
    """Return the settings of a tune: numbers, tables with their axes, words; the page is the function.

    A table whose axes are unknown, or do not increase, is a value block, its axes too. Raises `InputError` with every
    finding; entities are refused.
    """
    findings = Findings(source.name)
    if parse_xml(source.raw, findings) is None:
        findings.finish()
    text = "".join(source.lines)
    reader = _MsqReader(findings)
    signature = reader.find(text)
    definition = find_definition(source.path, signature, findings)
    reader.build(pairs_of(definition) if definition is not None else usual_pairs(), definition is not None)
    reader.free_texts(strings_of(definition or ""))
    remarks = findings.finish()
    members = [item for item in reader.items.values() if isinstance(item, Parameter)]
    texts = [item for item in reader.items.values() if isinstance(item, Text)]
    origin = Msq(source, text, reader.constants, reader.items, reader.axes)
    kind = f"MSQ tune of {signature}" if signature else "MSQ tune"
    return ReadResult(kind, ParameterSet(members, texts, reader.axes.values(), origin=origin), remarks)


@dataclass
class _MsqReader:
    findings: Findings
    constants: dict[str, Constant] = field(default_factory=dict)
    arrays: dict[str, Float] = field(default_factory=dict)  # a row for each y, as in the file
    items: dict[str, Parameter | Text] = field(default_factory=dict)
    axes: dict[str, Axis] = field(default_factory=dict)

    def find(self, text: str) -> str:
        """Add all constants of a file; return the signature of the firmware."""
        ends = [at for at, character in enumerate(text) if character == "\n"]
        page = signature = ""
        for part in _PART.finditer(text):
            attributes = {name: unescape(one or other) for name, one, other in _ATTRIBUTE.findall(part[2] or "")}
            if part[1] == "page":
                page = attributes.get("number", "")
            elif part[1] == "versionInfo":
                signature = attributes.get("signature", "")
            elif part[1]:
                line = bisect(ends, part.start()) + 1
                self._keep(attributes, Constant(attributes.get("name", ""), line, part.start(4), part[4], page=page))
        return signature

    def _keep(self, attributes: Mapping[str, str], found: Constant) -> None:
        counts = [attributes.get(key, "") for key in ("rows", "cols")]
        sizes = (int(counts[0]), int(counts[1])) if all(map(_COUNT.fullmatch, counts)) else None
        if sizes is None and _COUNT.fullmatch(counts[0]):
            sizes = (int(counts[0]), 1)
        digits = attributes.get("digits", "")
        written = int(digits) if _COUNT.fullmatch(digits) and int(digits) < 20 else None
        result = replace(found, unit=attributes.get("units", "").strip(), digits=written, sizes=sizes)
        if not found.name:
            self.findings.error(found.line, "", "a constant has no name", "Use a complete copy of the file.")
        elif found.name in self.constants:
            message = f"duplicate of line {self.constants[found.name].line}; skipped"
            self.findings.warning(found.line, found.name, message)
        else:
            self.constants[found.name] = result
            self._value(result)

    def _value(self, constant: Constant) -> None:
        content = constant.content.strip()
        if content.startswith('"') and constant.sizes is not None:
            self.findings.warning(
                constant.line, constant.name, "is a list of words, which cannot be a parameter; skipped"
            )
        elif constant.words:
            array = self._array(constant)
            if array is not None:
                self.arrays[constant.name] = array
        elif constant.sizes is not None:
            word = next((word for word in content.split() if not _NUMBER.fullmatch(word)), "")
            message = f"must be a number, got {word[:40]!r}" if word else "has no numbers"
            self.findings.error(constant.line, constant.name, message)
        else:
            quoted = len(content) > 1 and content[0] == content[-1] == '"'
            text, kind = unescape(content[1:-1] if quoted else content), _WORD_KINDS[quoted]
            unit, functions = constant.unit, _page_functions(constant)
            self.items[constant.name] = Text(constant.name, text, functions=functions, unit=unit, kind=kind)

    def _array(self, constant: Constant) -> Float | None:
        numbers = []
        for word in constant.words:
            try:
                numbers.append(float(word))
            except ValueError:
                numbers.append(np.nan)
            if not isfinite(numbers[-1]):
                self.findings.error(constant.line, constant.name, f"must be a finite number, got {word[:40]!r}")
                return None
        rows, columns = constant.sizes or (1, len(numbers))
        if rows * columns != len(numbers):
            message = f"has {count_noun(len(numbers), 'value')}, but its rows and columns state {rows} x {columns}"
            self.findings.error(constant.line, constant.name, message)
            return None
        return np.array(numbers).reshape(rows, columns)

    def build(self, pairs: list[Pair], has_definition: bool) -> None:
        """Convert the constants to parameters, those with a pair to tables."""
        different = {(pair.values, pair.axes): pair for pair in reversed(pairs)}
        tables = {pair.values: pair for pair in different.values() if self._fits(pair, has_definition)}
        used = {name for pair in tables.values() for name in pair.axes} - tables.keys()
        for name in self.constants:
            if name in self.arrays and name not in used:
                self.items[name] = self._item(name, tables.get(name))
        self.items = {name: self.items[name] for name in self.constants if name in self.items}

    def free_texts(self, names: Set[str]) -> None:
        """Mark constants as free text instead of one of several words."""
        for name in names & self.items.keys():
            item = self.items[name]
            if isinstance(item, Text):
                self.items[name] = replace(item, kind="text")

    def _fits(self, pair: Pair, has_definition: bool) -> bool:
        """Check whether a pair gives a table its axes."""
        values = self.arrays.get(pair.values)
        points = [self.arrays.get(name) for name in pair.axes]
        if values is None or any(one is None for one in points) or pair.values in pair.axes:
            return False
        sizes = tuple(one.size for one in points if one is not None)
        if sizes != (values.shape[::-1] if len(sizes) > 1 else (values.size,)):
            if has_definition:
                found = " x ".join(map(str, values.shape[::-1]))
                message = f"has {found} values, but its axes have {' x '.join(map(str, sizes))}; read as a value block"
                self.findings.warning(self.constants[pair.values].line, pair.values, message)
            return False
        fallen = [name for name in pair.axes if not self._increases(name, pair.values)]
        return not fallen

    def _increases(self, name: str, user: str) -> bool:
        points = self.arrays[name].ravel()
        if np.all(points[1:] > points[:-1]):
            return True
        message = f"is read as a value block: its breakpoints {name} are not strictly increasing"
        self.findings.warning(self.constants[user].line, user, message)
        return False

    def _item(self, name: str, pair: Pair | None) -> Parameter:
        constant, array = self.constants[name], self.arrays[name]
        labels: dict[str, Any] = {"unit": constant.unit, "functions": _page_functions(constant)}
        if pair is not None:
            axes = [self._axis(one, given) for one, given in zip(pair.axes, pair.inputs, strict=False)]
            return parameter(name, array.T if len(axes) > 1 else array.ravel(), axes, description=pair.title, **labels)
        if constant.sizes is None and array.size == 1:
            return Scalar(name, array[0, 0], **labels)
        return Block(name, array.ravel() if 1 in array.shape else array.T, **labels)

    def _axis(self, name: str, quantity: str) -> Axis:
        """Return the breakpoints in a constant: one axis for all tables that use it."""
        points = self.arrays[name].ravel()
        return self.axes.setdefault(name, Axis(points, quantity, self.constants[name].unit, name))


def _page_functions(constant: Constant) -> tuple[str, ...]:
    return (f"page {constant.page}",) if constant.page else ()

"""Reads TunerStudio tunes (.msq), the settings of MegaSquirt, Speeduino and rusEFI controllers.

A tune is XML with a `constant` or `pcVariable` per setting: numbers separated by blanks, one row of a table per y, or
words in quotes. It stores tables and their breakpoints as unrelated constants; the firmware's definition file (`.ini`)
pairs them in its sections TableEditor and CurveEditor. Without that file in the folder of the tune, the usual pairs of
Speeduino, MS2/Extra, MS3 and rusEFI are tried, as their public definition files state them.
"""

import re
from bisect import bisect
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field, replace
from html import unescape
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.file_state import note_opened
from kennfeld.base.formatting import count_noun, size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import describe_fall, in_rising_order, parse_float, turn
from kennfeld.calfiles.format import CalibrationSource, FileFindings, Item, ReadResult, build_set
from kennfeld.calfiles.xml_tree import parse_xml
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Block, Parameter, Scalar, parameter
from kennfeld.domain.texts import Text, TextKind

_MAX_FILE_BYTES = 20_000_000
_MAX_FILES = 50
_SIGNATURE = re.compile(r'^[ \t]*signature[ \t]*=[ \t]*"([^"\n]*)"', re.MULTILINE)
_LINE = re.compile(r"[ \t]*(\w+)[ \t]*=[ \t]*(.*)")
_WORD = re.compile(r'"([^"]*)"|([^",;\s][^",;]*)')
# a constant that is free text, not a choice of words
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


def find_definition(path: Path | None, signature: str, findings: FileFindings) -> str | None:
    """Return the text of a tune's definition file: the one with its signature, or mainController.ini."""
    if path is None or not path.parent.is_dir():
        return None
    texts = dict(_definitions(path))
    for text in texts.values():
        if signature and signature in _SIGNATURE.findall(text):
            return text
    for file, text in texts.items():
        # TunerStudio keeps the definition of a project under this name
        if file.name.casefold() == "maincontroller.ini":
            other = next(iter(_SIGNATURE.findall(text)), "")
            message = f"{file.name} is for the firmware {other!r}, but the tune for {signature!r}"
            remedy = "Tables may have wrong axes: put the matching definition file next to the tune."
            findings.warning(0, "", message, remedy)
            return text
    return None


def _definitions(path: Path) -> Iterator[tuple[Path, str]]:
    try:
        folders = [path.parent, path.parent / "projectCfg"]
        files = sorted(file for folder in folders if folder.is_dir() for file in folder.iterdir())
        definitions = [file for file in files if file.suffix.casefold() == ".ini" and file.is_file()]
        for file in (*folders, *definitions[:_MAX_FILES]):
            note_opened(file)
        for file in definitions[:_MAX_FILES]:
            if file.stat().st_size <= _MAX_FILE_BYTES:
                yield file, CalibrationSource(file.name, file.read_bytes()).text
    except OSError:
        return


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
            quoted_title = re.search(r'"([^"]*)"', setting[2])
            bins, title = {}, quoted_title[1] if quoted_title else ""
        elif key in ("xbins", "ybins", "zbins") and words:
            bins[key] = words
            results += _complete_pair(section, key, bins, title)
    return results


def _complete_pair(section: str, key: str, bins: dict[str, list[str]], title: str) -> list[Pair]:
    """Return the pair that one more line of an editor completes."""
    is_table = section == "tableeditor"
    # a table is complete with x, y and z in any order; a curve may have several ybins over one xbins
    if len(bins) < 3 if is_table else key != "ybins" or "xbins" not in bins:
        return []
    axes = [bins["xbins"], bins["ybins"]] if is_table else [bins["xbins"]]
    inputs = [words[1] if len(words) > 1 and re.fullmatch(r"\w+", words[1]) else "" for words in axes]
    return [
        Pair(bins["zbins" if is_table else "ybins"][0], tuple(words[0] for words in axes), (*inputs, "")[:2], title)
    ]


def usual_pairs() -> list[Pair]:
    """Return the pairs of the common firmwares; of several for one table, the one that fits is used."""
    listed = f"{_SPEEDUINO_TABLES.strip()}{_TRIMS}\n{_OTHER_TABLES}\n{_CURVES}"
    words = (entry.split() for entry in re.split(r"[,\n]", listed))
    return [Pair(first, tuple(axes)) for first, *axes in filter(None, words)]


@dataclass(frozen=True)
class TuneConstant:
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

    @property
    def labels(self) -> dict[str, Any]:
        """The attributes of its parameter or text."""
        return {"unit": self.unit, "functions": (f"page {self.page}",) if self.page else ()}


@dataclass(frozen=True, eq=False)
class Msq:
    """A tune as read: its text, its constants and their content."""

    source: CalibrationSource
    text: str
    constants: Mapping[str, TuneConstant]
    items: Mapping[str, Item]
    axes: Mapping[str, Axis]


def read_msq(source: CalibrationSource) -> ReadResult:
    """Return the settings of a tune: numbers, tables with their axes, words; the page is the function.

    A table whose axes are unknown, or neither rise nor fall, is a value block, its axes too. Raises `InputError` with
    every finding; entities are refused.
    """
    findings = FileFindings(source.name)
    if parse_xml(source.raw, findings) is None:
        findings.finish()
    text = "".join(source.lines)
    reader = _MsqReader(findings)
    signature = reader.find(text)
    definition = find_definition(source.path, signature, findings)
    reader.build(pairs_of(definition) if definition is not None else usual_pairs(), definition is not None)
    reader.free_texts(_STRING.findall(definition or ""))
    warnings = findings.finish()
    origin = Msq(source, text, reader.constants, reader.items, reader.axes)
    parameters = build_set({(name, ""): item for name, item in reader.items.items()}, reader.axes.values(), origin)
    return ReadResult(f"MSQ tune of {signature}" if signature else "MSQ tune", parameters, warnings)


@dataclass
class _MsqReader:
    findings: FileFindings
    constants: dict[str, TuneConstant] = field(default_factory=dict)
    arrays: dict[str, Float] = field(default_factory=dict)  # a row for each y, as in the file
    items: dict[str, Item] = field(default_factory=dict)
    axes: dict[str, Axis] = field(default_factory=dict)

    def find(self, text: str) -> str:
        """Add all constants of a file; return the signature of the firmware."""
        ends = [at for at, character in enumerate(text) if character == "\n"]
        page = signature = ""
        for part in _PART.finditer(text):
            attributes = {
                name: unescape(double or single) for name, double, single in _ATTRIBUTE.findall(part[2] or "")
            }
            if part[1] == "page":
                page = attributes.get("number", "")
            elif part[1] == "versionInfo":
                signature = attributes.get("signature", "")
            elif part[1]:
                line = bisect(ends, part.start()) + 1
                self._keep(_constant(attributes, line, part.start(4), part[4], page))
        return signature

    def _keep(self, constant: TuneConstant) -> None:
        if not constant.name:
            self.findings.error(constant.line, "", "a constant has no name", "Use a complete copy of the file.")
        elif constant.name in self.constants:
            message = f"duplicate of line {self.constants[constant.name].line}; skipped"
            self.findings.warning(constant.line, constant.name, message)
        else:
            self.constants[constant.name] = constant
            self._value(constant)

    def _value(self, constant: TuneConstant) -> None:
        content = constant.content.strip()
        if content.startswith('"') and constant.sizes is not None:
            message = "is a list of words, which cannot be a parameter; skipped"
            self.findings.warning(constant.line, constant.name, message)
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
            self.items[constant.name] = Text(constant.name, text, kind=kind, **constant.labels)

    def _array(self, constant: TuneConstant) -> Float | None:
        numbers = list(map(parse_float, constant.words))
        for word, number in zip(constant.words, numbers, strict=True):
            if not isfinite(number):
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
        # backwards, so that of several pairs for a table the first one that fits remains
        different = {(pair.values, pair.axes): pair for pair in reversed(pairs)}
        tables = {pair.values: pair for pair in different.values() if self._fits(pair, has_definition)}
        # breakpoints are read as axes, unless they are a table themselves
        used = {name for pair in tables.values() for name in pair.axes} - tables.keys()
        for name in self.constants:
            if name in self.arrays and name not in used:
                self.items[name] = self._item(name, tables.get(name))
        self.items = {name: self.items[name] for name in self.constants if name in self.items}

    def free_texts(self, names: Iterable[str]) -> None:
        """Mark constants as free text instead of one of several words."""
        for name in names:
            item = self.items.get(name)
            if isinstance(item, Text):
                self.items[name] = replace(item, kind="text")

    def _fits(self, pair: Pair, has_definition: bool) -> bool:
        """Check whether a pair gives a table its axes."""
        values = self.arrays.get(pair.values)
        points = [self.arrays[name].ravel() for name in pair.axes if name in self.arrays]
        if values is None or len(points) < len(pair.axes) or pair.values in pair.axes:
            return False
        line = self.constants[pair.values].line
        sizes = tuple(axis.size for axis in points)
        if sizes != (values.shape[::-1] if len(sizes) > 1 else (values.size,)):
            if has_definition:
                size, axes = (size_text(numbers) for numbers in (values.shape[::-1], sizes))
                message = f"has {size} values, but its axes have {axes}; read as a value block"
                self.findings.warning(line, pair.values, message)
            return False
        faults = {name: describe_fall(in_rising_order(axis)[0]) for name, axis in zip(pair.axes, points, strict=True)}
        wrong = {name: fault for name, fault in faults.items() if fault}
        for name, fault in wrong.items():
            message = f"is read as a value block: its breakpoints {name} neither rise nor fall: {fault}"
            self.findings.warning(line, pair.values, message)
        return not wrong

    def _item(self, name: str, pair: Pair | None) -> Parameter:
        constant, array = self.constants[name], self.arrays[name]
        if pair is not None:
            axes = []
            for axis, quantity in zip(pair.axes, pair.inputs, strict=False):
                points, falls = in_rising_order(self.arrays[axis].ravel())
                own = Axis(points, quantity, self.constants[axis].unit, axis, falling=falls)
                axes.append(self.axes.setdefault(axis, own))  # one axis for all tables that use the constant
            values = turn(array.T if len(axes) > 1 else array.ravel(), axes)
            return parameter(name, values, axes, description=pair.title, **constant.labels)
        if constant.sizes is None and array.size == 1:
            return Scalar(name, array[0, 0], **constant.labels)
        return Block(name, array.ravel() if 1 in array.shape else array.T, **constant.labels)


def _constant(attributes: Mapping[str, str], line: int, begin: int, content: str, page: str) -> TuneConstant:
    rows, columns, digits = (
        int(attributes[key]) if _COUNT.fullmatch(attributes.get(key, "")) else None
        for key in ("rows", "cols", "digits")
    )
    unit, name = attributes.get("units", "").strip(), attributes.get("name", "")
    sizes = None if rows is None else (rows, 1 if columns is None else columns)
    digits = digits if digits is not None and digits < 20 else None
    return TuneConstant(name, line, begin, content, unit, digits, sizes, page)

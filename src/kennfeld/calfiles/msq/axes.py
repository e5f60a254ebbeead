"""Which constants of a tune are the axes of which table.

A tune holds tables and their breakpoints as unrelated constants; the definition file of the firmware (`.ini`) pairs
them in its sections TableEditor and CurveEditor. Where it is not beside the tune, the usual pairs of the firmwares
Speeduino, MS2/Extra, MS3 and rusEFI are tried, as their public definition files state them.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from kennfeld.calfiles.format import Notes, Source

__all__ = ["Pair", "definition_beside", "pairs_of", "strings_of", "usual_pairs"]

_MOST_BYTES = 20_000_000
_MOST_FILES = 50
_SIGNATURE = re.compile(r'^[ \t]*signature[ \t]*=[ \t]*"([^"\n]*)"', re.MULTILINE)
_LINE = re.compile(r"[ \t]*(\w+)[ \t]*=[ \t]*(.*)")
_WORD = re.compile(r'"([^"]*)"|([^",;\s][^",;]*)')
_STRING = re.compile(r"^[ \t]*(\w+)[ \t]*=[ \t]*string[ \t]*,", re.MULTILINE | re.IGNORECASE)
_SECTION = re.compile(r"[ \t]*\[([^\]]+)\]")


@dataclass(frozen=True)
class Pair:
    """A table with its axes: names of constants, the channels on the axes, and the title an editor shows."""

    values: str
    axes: tuple[str, ...]
    inputs: tuple[str, ...] = ("", "")
    title: str = ""


def definition_beside(path: Path | None, signature: str, notes: Notes) -> str | None:
    """The text of the definition file of a tune: the one beside it that names its signature, or mainController.ini."""
    if path is None or not path.parent.is_dir():
        return None
    texts = dict(_definitions(path))
    for text in texts.values():
        if signature and signature in _SIGNATURE.findall(text):
            return text
    for file, text in texts.items():
        if file.name.casefold() == "maincontroller.ini":
            said = next(iter(_SIGNATURE.findall(text)), "")
            what = f"{file.name} is for the firmware {said!r}, the tune for {signature!r}"
            notes.remark(0, "", what, "Tables may have the wrong axes: put the right definition file beside the tune.")
            return text
    return None


def _definitions(path: Path) -> Iterator[tuple[Path, str]]:
    try:
        folders = [path.parent, path.parent / "projectCfg"]
        files = sorted(file for folder in folders if folder.is_dir() for file in folder.iterdir())
        found = [file for file in files if file.suffix.casefold() == ".ini" and file.is_file()]
        for file in found[:_MOST_FILES]:
            if file.stat().st_size <= _MOST_BYTES:
                yield file, Source(file.name, file.read_bytes()).text
    except OSError:
        return


def strings_of(definition: str) -> frozenset[str]:
    """Return the constants that a definition file declares as free text, not as a choice of words."""
    return frozenset(_STRING.findall(definition))


def pairs_of(definition: str) -> list[Pair]:
    """The tables and curves that a definition file shows in its editors, in its order."""
    found: list[Pair] = []
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
            found += _complete(section, key, bins, title)
    return found


def _title(rest: str) -> str:
    quoted = re.search(r'"([^"]*)"', rest)
    return quoted[1] if quoted else ""


def _complete(section: str, key: str, bins: dict[str, list[str]], title: str) -> list[Pair]:
    """The pair that one more line of an editor completes."""
    if section == "tableeditor":
        if len(bins) < 3:
            return []
        x, y = bins["xbins"], bins["ybins"]
        return [Pair(bins["zbins"][0], (x[0], y[0]), (_second(x), _second(y)), title)]
    if key == "ybins" and "xbins" in bins:
        return [Pair(bins["ybins"][0], (bins["xbins"][0],), (_second(bins["xbins"]), ""), title)]
    return []


def _second(words: list[str]) -> str:
    return words[1] if len(words) > 1 and re.fullmatch(r"\w+", words[1]) else ""


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


def usual_pairs() -> list[Pair]:
    """The pairs of the common firmwares; of those that name the same table, the one that fits counts."""
    listed = f"{_SPEEDUINO_TABLES.strip()}{_TRIMS}\n{_OTHER_TABLES}\n{_CURVES}"
    words = (entry.split() for entry in re.split(r"[,\n]", listed))
    return [Pair(first, tuple(axes)) for first, *axes in filter(None, words)]

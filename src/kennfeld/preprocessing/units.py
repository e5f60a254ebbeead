"""Unit conversion of recorded channels into the units of the function.

Units are recognised by the spellings of engine measurement, English and German; any other word is looked up in pint's
registry of units. Angles are a quantity of their own here, so that revolutions per minute are not a frequency.
"""

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Fix, Location
from kennfeld.base.formatting import join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.measurement.unit_text import in_seconds, plain_unit, time_unit
from kennfeld.preprocessing.recipe import DataSettings

Kinship = Literal["same", "contrary", "unknown"]
_T = TypeVar("_T", float, Float)  # Python 3.11
_Unit = tuple[tuple[str, int], ...]  # names as pint knows them, each with its exponent

_NOTHING = frozenset(("", "-", "--", "1", "none", "unitless", "n/a", "bool", "boolean", "flag", "enum", "raw"))
_WHOLE_WORDS = """
revolution/minute: rpm 1/min min-1 min^-1 u/min upm rev/min r/min umdr/min ump/min rotations/min
degree_Celsius: c degc deg_c celsius °c deg.c gradc gradcelsius degcelsius oc
degree_Fahrenheit: degf deg_f fahrenheit °f
kelvin: k kelvin degk °k
degree: deg ° degree degrees grad °kw °ca °crk gradkw degkw degca degcrk deg_crk deg_ca degcrs gradca °kwvot °kwvzot
newton*meter: nm n.m n*m n-m
kilonewton*meter: knm
foot*pound_force: lbft lb-ft lbf-ft lbfft lb.ft ftlb ft-lb ft-lbf ft.lb ft*lb ftlbf
milligram/stroke: mg/stk mg/hub mg/str mg/stroke mg/inj mg/asphub
gram/stroke: g/stk g/hub g/str g/stroke
kilometer/hour: km/h kmh kph kmph
mile/hour: mph
percent: % pct percent prozent vol% vol-% %vol
pound_force_per_square_inch: psi psia
kilopascal: kpa kpaabs
bar: bar bara barabs
millibar: mbar mbara mbarabs
hectopascal: hpa hpaabs
"""
_PART_WORDS = """
second: s sec secs second seconds sek sekunde sekunden
millisecond: msec millisecond milliseconds
microsecond: us µs μs usec
minute: min minute minutes
hour: h hr hour hours std
degree: ° deg degree degrees °kw °ca °crk
revolution: u rev umdr revolution revolutions
stroke: stk hub hübe str stroke strokes inj
degree_Celsius: °c degc
kelvin: k
newton: n
meter: m
kilometer: km
watt: w
kilowatt: kw
horsepower: hp bhp
metric_horsepower: ps cv
joule: j
kilojoule: kj
volt: v volt
ampere: a amp ampere
ohm: ohm ω
kiloohm: kohm kω
engine_cycle: cyc cycle cycles asp
cylinder: cyl zyl
pascal: pa
kilopascal: kpa
hectopascal: hpa
bar: bar
millibar: mbar
gram: g
kilogram: kg
metric_ton: t
liter: l ltr liter litre
milliliter: ml
cubic_centimeter: ccm cc
hertz: hz
kilohertz: khz
mmHg: mmhg
inHg: inhg
inch_H2O_39F: inh2o
percent: % pct
ppm: ppm
permille: ‰
radian: rad
lambda: λ lambda
air_fuel_ratio: afr
"""
_OWN = ("stroke", "engine_cycle", "cylinder", "lambda", "air_fuel_ratio")  # each a quantity of its own
_KELVIN = {  # 180 times the size of a degree, and 180 times what its 0 is: whole numbers, so that nothing is rounded
    "kelvin": (180, 0),
    "degree_Celsius": (180, 49_167),
    "degree_Fahrenheit": (100, 45_967),
}
_DIFFERENCE = {"degree_Celsius": "kelvin", "degree_Fahrenheit": "degree_Rankine"}
_PLAIN = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−º˚⋅×", "0123456789--°°·*") | {ord("℃"): "°C", ord("℉"): "°F"}
_FACTOR = re.compile(r"([^\W\d_]+|°[^\W\d_]*|[%‰])(?:\^?([+-]?\d))?")
_SHARES = frozenset(("percent", "permille", "ppm"))  # the numbers among units; a bit or a count is no share
_MAX_LENGTH = 40  # characters of a unit

_Case = tuple[str, str, str, str]  # channel, its unit, the unit it is converted to, and the owner of that unit


@dataclass(frozen=True)
class UnitConversion:
    """Conversion of values in one unit into another: `factor` times the value, plus `offset`.

    >>> UnitConversion(1.0, 273.15).of(20.0)
    293.15
    """

    factor: float
    offset: float = 0.0

    def of(self, values: _T) -> _T:
        """Return a value, or an array of values, in the other unit."""
        return values * self.factor + self.offset if self.offset else values * self.factor


def is_unit_missing(unit: str) -> bool:
    """Return whether a text states no unit, such as an empty one or a dash.

    >>> is_unit_missing("[-]"), is_unit_missing("%")
    (True, False)
    """
    return plain_unit(unit).casefold() in _NOTHING


@cache
def compare_units(source: str, target: str) -> UnitConversion | Kinship:
    """Return the conversion of values in `source` into values in `target`.

    "same" if both are equal, "contrary" if they are units of different quantities, "unknown" if one of them is not
    known or not stated.

    >>> compare_units("1/min", "U/min"), compare_units("rpm", "Nm"), compare_units("FSN", "Nm")
    ('same', 'contrary', 'unknown')
    >>> compare_units("kNm", "Nm")
    UnitConversion(factor=1000.0, offset=0.0)
    """
    if is_unit_missing(source) or is_unit_missing(target):
        return "unknown"
    first, second = _parse_unit(source), _parse_unit(target)
    if first == second:
        return "same"
    if all(len(unit) == 1 and unit[0][0] in _KELVIN and unit[0][1] == 1 for unit in (first, second)):
        factor, offset = _KELVIN[first[0][0]]
        divisor, zero = _KELVIN[second[0][0]]
        return UnitConversion(factor / divisor, (offset - zero) / divisor)
    return _registry_conversion(first, second)


def _registry_conversion(first: _Unit, second: _Unit) -> UnitConversion | Kinship:
    """Return the conversion by pint's registry, for units that have different spellings here."""
    registry = _registry()
    if not all(_is_known(registry, name) for name, _ in (*first, *second)):
        return "unknown"
    source, target = dict(_as_differences(first)), dict(_as_differences(second))
    if registry.get_dimensionality(source) != registry.get_dimensionality(target):
        return "contrary"
    if not registry.get_dimensionality(source) and not {*source, *target} <= _SHARES:
        return "unknown"
    factor = _mere_factor(registry, registry.UnitsContainer(source), registry.UnitsContainer(target))
    return "unknown" if factor is None else "same" if factor == 1.0 else UnitConversion(factor)


def _mere_factor(registry: Any, source: Any, target: Any) -> float | None:
    """Return one `source` in `target`; None if it is not a mere factor, as for decibels and other temperatures."""
    try:
        zero, unit, double = (float(registry.convert(value, source, target)) for value in (0.0, 1.0, 2.0))
    except Exception:  # of many kinds, such as the logarithm of 0
        return None
    if zero != 0.0 or not math.isclose(double, 2 * unit, rel_tol=1e-12):
        return None
    short = float(f"{unit:.12g}")  # 1000 for 1000.0000000000001
    return short if math.isclose(short, unit, rel_tol=1e-14) else unit


def _as_differences(unit: _Unit) -> _Unit:
    """Return the unit with differences of temperatures, which have no zero of their own, so that factors suffice."""
    return _multiply((_DIFFERENCE.get(name, name), exponent) for name, exponent in unit)


def _multiply(factors: Iterable[tuple[str, int]]) -> _Unit:
    """Return the product of the factors, without those that cancel out."""
    exponents: dict[str, int] = {}
    for name, exponent in factors:
        exponents[name] = exponents.get(name, 0) + exponent
    return tuple(sorted((name, exponent) for name, exponent in exponents.items() if exponent))


def _is_known(registry: Any, name: str) -> bool:
    try:
        return bool(registry.parse_unit_name(name, case_sensitive=True))
    except Exception:  # of many kinds: the name is any text of a file
        return False


@cache
def _registry() -> Any:
    """Return the registry of units, in which angles, strokes and air ratios are quantities of their own."""
    import pint

    registry: Any = pint.UnitRegistry(None, on_redefinition="ignore")  # empty: a full one knows already that 1 rad is 1
    registry.load_definitions(Path(pint.__file__).with_name("default_en.txt"))
    registry.define("radian = [angle] = rad")
    for name in _OWN:
        registry.define(f"{name} = [{name}]")
    return registry


def _words(text: str) -> dict[str, str]:
    lines = (line.partition(":") for line in text.strip().splitlines())
    return {word: meaning for meaning, _, words in lines for word in words.split()}


def _unit(meaning: str) -> _Unit:
    """Return a meaning of the table: factors, and at most one divisor."""
    factors, _, divisor = meaning.partition("/")
    return tuple(sorted([*((name, 1) for name in factors.split("*")), *([(divisor, -1)] if divisor else [])]))


_WHOLE = {word: _unit(meaning) for word, meaning in _words(_WHOLE_WORDS).items()}
_PARTS = _words(_PART_WORDS)
# within products, too, nm is newton metre, not nanometre
_JOINED: dict[str, _Unit] = {"nm": (("newton", 1), ("meter", 1)), "knm": (("kilonewton", 1), ("meter", 1))}


@cache
def _parse_unit(text: str) -> _Unit:
    """Return the unit as names with exponents; a text that is no unit as a name of its own."""
    plain = plain_unit(text).translate(_PLAIN)
    folded = re.sub(r"\s", "", plain.casefold())
    # the words above go without case, those of pint keep theirs: mW is not MW
    unit = None if len(plain) > _MAX_LENGTH else _WHOLE.get(folded) or _product(plain)
    return ((text, 1),) if unit is None else unit


def _product(text: str) -> _Unit | None:
    """Parse factors between `*`, `.` and blanks, and divisors after `/`, perhaps in brackets; None if invalid."""
    factors: list[tuple[str, int]] = []
    sign, inside = 1, False
    for part in re.findall(r"[/()]|[^/()*·.\s]+", text):
        if part == "/":
            sign = -1
        elif part == "(":
            inside = True
        elif part == ")":
            sign, inside = 1, False
        elif part != "1":
            factor = _FACTOR.fullmatch(part)
            if factor is None:
                return None
            power = sign * int(factor[2] or 1)
            factors += [(name, power * exponent) for name, exponent in _unit_of_word(factor[1])]
            # a divisor is one factor, unless brackets hold several
            sign = sign if inside else 1
    unit = _multiply(factors)
    # a temperature alone has a zero; within a product, such as W/°C, it is a difference
    return (unit if len(unit) == 1 and unit[0][1] == 1 else _as_differences(unit)) or None


def _unit_of_word(word: str) -> _Unit:
    """Return the unit of a word, or its product, such as Nm."""
    folded = word.casefold()
    return _JOINED.get(folded, ((_PARTS.get(folded, word), 1),))


@dataclass
class Units:
    """Conversion of the channels of all files of a project, and a record of what was converted.

    `stated` are the units that the project file states; `wanted` is the unit of each channel that the function states
    one for, with its owner: the input Speed. Other channels take the unit of the first file that has one.
    """

    stated: Mapping[str, str]
    wanted: Mapping[str, tuple[str, str]]
    first: dict[str, tuple[str, str]] = field(default_factory=dict)
    cases: dict[_Case, dict[str, None]] = field(default_factory=dict)

    def convert(self, part: Dataset, name: str) -> Dataset:
        """Return the recording with its channels converted; `name` is its file's."""
        stated = with_stated_units(part, self.stated)
        channels = tuple(self._convert_channel(channel, name) for channel in stated.channels)
        same = all(channel is before for channel, before in zip(channels, part.channels, strict=True))
        return part if same else replace(part, channels=channels)

    def _convert_channel(self, channel: Channel, file: str) -> Channel:
        if is_unit_missing(channel.unit):
            return channel
        unit, whose = self.wanted.get(channel.name) or self.first.setdefault(channel.name, (channel.unit, file))
        conversion = compare_units(channel.unit, unit)
        if not isinstance(conversion, UnitConversion):
            return channel
        self.cases.setdefault((channel.name, channel.unit, unit, whose), {})[file] = None
        return replace(channel, values=conversion.of(channel.values), unit=unit)

    def remarks(self, formulas: Collection[str]) -> Iterator[Finding]:
        """Yield a remark on each conversion; `formulas` are the channels that formulas of the project read."""
        for (channel, unit, to, whose), files in self.cases.items():
            message = f"channel {channel} is converted from {unit} to {to}, the unit of {whose}"
            if channel in formulas:
                message += f"; formulas read {channel} in {to}"
            yield Finding(Location(join_names(files, 1)), message, severity="remark")


def with_stated_units(dataset: Dataset, units: Mapping[str, str]) -> Dataset:
    """Return the dataset with the units that the project file states; values are not converted."""
    changed = [replace(c, unit=units[c.name]) for c in dataset.channels if c.name in units]
    return dataset.with_channels(*changed) if changed else dataset


def select_time_units(stated: Mapping[str, str]) -> dict[str, str]:
    """Return those of the stated units that are units of time, which a column of time may be in.

    >>> select_time_units({"Time": "ms", "n": "rpm"})
    {'Time': 'ms'}
    """
    return {name: unit for name, unit in stated.items() if in_seconds(unit) is not None}


def check_stated_units(
    file: DataSettings, used: Collection[str], clocks: Collection[str], *, complete: bool
) -> Iterator[Finding]:
    """Report stated units of unused channels, and stated units of time columns that are not units of time.

    `clocks` are the columns that time was read from; all of them are known only if all data are `complete`.
    """
    for name, unit in file.units.items():
        if name in clocks:
            if in_seconds(unit) is None and name not in used:
                message = f"{unit} is not a unit of time, but {name} is the time column"
                fixes = (Fix.choose(("units", name), ("s", "ms", "us", "ns", "min", "h")),)
                yield Finding(file.location("units", name), message, "Write s, ms, us, ns, min or h.", fixes=fixes)
            continue
        # it may be the time column of a file that could not be read
        if not complete and time_unit(name, unit) is not None:
            continue
        if name not in used:
            remedy = nearest(name, {*used, *clocks}) or "Name a channel of the files or a calculated one."
            fixes = (Fix.remove(("units", name)),)
            yield Finding(file.location("units", name), f"channel {name} is not used", remedy, fixes=fixes)

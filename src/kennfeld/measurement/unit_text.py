"""Recognition of units in tables: in a row below the names, or in the name itself."""

import re

_WORDS = """
s sec secs second seconds sek ms msec us µs μs usec ns min h hr d day
rpm min-1 u upm s-1 hz khz mhz rad deg ° °ca °kw °crk degca deg_ca degcrk degkw cad
nm n kn w kw mw hp ps j kj mj kwh v mv kv a ma ohm ω kω
pa hpa kpa mpa bar mbar psi mmhg k °c degc deg_c c °f degf f celsius kelvin
kg g mg t l ml gal m3 m³ mm3 mm³ cm3 cm³ cc stk str hub stroke cyc cycle cyl rev inj
m mm cm km µm um kmh mph kph kt knots s2 s² mi mile miles mpg
meter meters metre metres degree degrees
% pct percent ppm ppm_v vol% vol-% vol mol% fsn db dba phi lambda λ afr
:1 - -- 1 none bool boolean bit bits count counts enum flag adc raw #
"""
_SECONDS = {
    (1.0, 1.0): "s sec secs second seconds sek sekunden",
    (1.0, 1e3): "ms msec millisecond milliseconds",
    (1.0, 1e6): "us µs μs usec microsecond microseconds",
    (1.0, 1e7): "100ns",
    (1.0, 1e9): "ns nsec nanosecond nanoseconds",
    (60.0, 1.0): "min minute minutes minuten",
    (3600.0, 1.0): "h hr hrs hour hours stunden",
    (86400.0, 1.0): "day days tage",
}
_TIME = {word: scale for scale, words in _SECONDS.items() for word in words.split()}
_UNITS = frozenset(_WORDS.split()) | frozenset(_TIME)
_TIME_NAME = re.compile(
    r"(?:elapsed|relative)?[ _]?(?:time|timestamps?|time ?stamps?|zeit|t)(?:(?:[ _]|, ?| ?/ ?| in )([a-zµμ]+))?"
)
_CALLED_TIME = re.compile(
    r"(?:elapsed|relative)?[ _]?(?:time|timestamps?|time ?stamps?|zeit)(?: ?[(\[,/].*)?", re.DOTALL
)
_NUMBERED = re.compile(r"(?:time|zeit|timestamps?)[ _.]?\(?[0-9]+(?: ?m?s)?\)?|x_value|t_[0-9]+ ?m?s", re.IGNORECASE)
# words that name a date or a time of day, whose column may be the time although it is called `Device Time`
_STAMPED = re.compile(r"\b(?:time|timestamps?|stamp|date|datetime|zeit|uhrzeit|datum|clock)\b", re.IGNORECASE)
_SAYS_TIME = re.compile(r"\b(?:time|timestamp|zeit|uhrzeit)\b", re.IGNORECASE)
_FRACTION = re.compile(r"(?:time[ _.]?)?(?:ms|msec|millis|millisec|milliseconds?|millisekunden?)", re.IGNORECASE)
_BRACKETS = re.compile(r"(.*\S)\s*\[([^\[\]]*)\]\s*", re.DOTALL)
_PARENTHESES = re.compile(r"(.*\S)\s*\(([^()]*)\)\s*", re.DOTALL)


def plain_unit(text: str) -> str:
    """Return the unit without its brackets; a dash stands for none.

    >>> plain_unit("[Nm]"), plain_unit("(rpm)"), plain_unit("[-]")
    ('Nm', 'rpm', '-')
    """
    text = text.strip()
    if len(text) >= 2 and text[0] + text[-1] in ("[]", "()"):
        text = text[1:-1].strip()
    return text


def looks_like_unit(text: str) -> bool:
    """Return whether a cell reads like a unit: a known one, or anything in brackets.

    >>> looks_like_unit("[furlong]"), looks_like_unit("kg/h"), looks_like_unit("Speed")
    (True, True, False)
    """
    text = text.strip()
    if len(text) >= 2 and text[0] == "[" and text[-1] == "]":
        return True
    folded = plain_unit(text).casefold()
    # products, quotients and powers of known units
    return folded in _UNITS or all(part in _UNITS for part in re.split(r"[/*·^ ]", folded))


def split_name(text: str) -> tuple[str, str]:
    """Return name and unit of a column header; an index such as `rad[3]` stays part of the name.

    >>> split_name("Speed [rpm]"), split_name("Speed (rpm)"), split_name("p (intake)"), split_name("rad[3]")
    (('Speed', 'rpm'), ('Speed', 'rpm'), ('p (intake)', ''), ('rad[3]', ''))
    """
    text = " ".join(text.split())
    match = _BRACKETS.fullmatch(text)
    if match and not (match[2].isdigit() and text[len(match[1])] == "["):
        return match[1], match[2].strip()
    match = _PARENTHESES.fullmatch(text)
    if match and looks_like_unit(match[2]):
        return match[1], match[2].strip()
    return text, ""


def in_seconds(unit: str) -> tuple[float, float] | None:
    """Return factor and divisor that convert a time in this unit to seconds, None for other units.

    >>> in_seconds("ms"), in_seconds("rpm")
    ((1.0, 1000.0), None)
    """
    return _TIME.get(plain_unit(unit).casefold().removesuffix("."))


def time_unit(name: str, unit: str) -> str | None:
    """Return the unit of a column with a name of time, seconds by default; None for other names.

    >>> time_unit("time_ms", ""), time_unit("t / ms", ""), time_unit("Zeit", "s"), time_unit("t", "°C")
    ('ms', 'ms', 's', None)
    """
    match = _TIME_NAME.fullmatch(name.strip().casefold())
    if not match or (match[1] and in_seconds(match[1]) is None):
        return None
    stated = unit if states_unit_of_time("", unit) else (match[1] or "s")
    return None if in_seconds(stated) is None else stated


def states_unit_of_time(name: str, unit: str) -> bool:
    """Return whether the unit or the name of a time column states its unit.

    >>> states_unit_of_time("time_ms", ""), states_unit_of_time("time", "-")
    (True, False)
    """
    match = _TIME_NAME.fullmatch(name.strip().casefold())
    return plain_unit(unit) not in ("", "-") or bool(match and match[1])


def says_time(name: str) -> bool:
    """Return whether a name has the word for time, as that of a clock.

    >>> says_time("Device Time"), says_time("Datum")
    (True, False)
    """
    return _SAYS_TIME.search(name.replace("_", " ")) is not None


def is_called_time(name: str) -> bool:
    """Return whether a name is that of the time, whatever unit stands behind it; a quantity such as `t` is not.

    >>> is_called_time("Time (hrs)"), is_called_time("Zeit"), is_called_time("Injection time"), is_called_time("t")
    (True, True, False, False)
    """
    return _CALLED_TIME.fullmatch(name.strip().casefold()) is not None


def may_be_time(name: str, unit: str) -> bool:
    """Return whether a column may be the time of the samples."""
    if _STAMPED.search(name.replace("_", " ")) or is_fraction_name(name):
        return True
    return time_unit(name, unit) is not None or is_clock(name, unit) or in_seconds(unit) is not None


def is_fraction_name(name: str) -> bool:
    """Return whether a column has the name of milliseconds beside a time in whole seconds.

    >>> is_fraction_name("ms"), is_fraction_name("Millisekunden"), is_fraction_name("Speed")
    (True, True, False)
    """
    return _FRACTION.fullmatch(name.strip()) is not None


def is_clock(name: str, unit: str) -> bool:
    """Return whether a column has the name of a group's time: `time`, `time_2`, `Zeit_10ms`, LabVIEW's `X_Value`.

    >>> is_clock("time_100ms", "s"), is_clock("t", ""), is_clock("Time", "min"), is_clock("Time", "%")
    (True, False, True, False)
    """
    if name.casefold() == "t" and in_seconds(unit) is None:
        return False
    numbered = _NUMBERED.fullmatch(name.strip()) is not None
    return time_unit(name, unit) is not None or (numbered and (not plain_unit(unit) or in_seconds(unit) is not None))

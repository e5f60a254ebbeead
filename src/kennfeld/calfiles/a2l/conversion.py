"""Conversions (COMPU_METHOD) between raw and physical values, by ASAM MCD-2 MC.

    LINEAR a b              physical = a raw + b
    RAT_FUNC a b c d e f    raw = (a p^2 + b p + c) / (d p^2 + e p + f),   p physical

A conversion without a unique inverse has none here; nothing is guessed.
"""

from functools import partial

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.a2l.objects import A2l, CompuMethod, CompuTab, CompuVtab
from kennfeld.calfiles.a2l.syntax import A2lError
from kennfeld.domain.conversion_formulas import Formula, nan_if_infinite, parse_formula

_TABLE_KINDS = ("TAB_INTP", "TAB_NOINTP", "TAB_VERB")


@dataclass(frozen=True)
class VerbalConversion:
    """Texts assigned to raw values."""

    table: CompuVtab

    def text(self, raw: float) -> str | None:
        """Return the word of a raw number, None if there is none."""
        return next((word for least, most, word in self.table.ranges if least <= raw <= most), self.table.default)

    def raw(self, text: str) -> float | None:
        """Return the least raw number that a word stands for."""
        return next((least for least, _, word in self.table.ranges if word == text), None)


@dataclass(frozen=True)
class CompuConversion:
    """One conversion, ready to use; `raw` is None if it has no inverse. NaN stands for what has no value."""

    name: str
    unit: str
    physical: Formula
    raw: Formula | None
    words: VerbalConversion | None = None


def conversion_of(a2l: A2l, name: str, lower: float, upper: float) -> CompuConversion:
    """Return the conversion of an object within physical limits. Raises `A2lError`."""
    if name in ("NO_COMPU_METHOD", ""):
        return IDENTITY
    method = a2l.compu_methods.get(name)
    if method is None:
        raise A2lError(f"has the conversion {name[:60]}, which is not defined")
    # numbers stay raw; the words are assigned to them
    if method.table in a2l.compu_vtabs and method.kind in _TABLE_KINDS:
        words = VerbalConversion(a2l.compu_vtabs[method.table])
        return CompuConversion(name, method.unit, _identity, _identity, words)
    if method.kind == "IDENTICAL":
        functions: tuple[Formula, Formula | None] = (_identity, _identity)
    elif method.kind == "LINEAR":
        functions = _linear(*method.coeffs)
    elif method.kind == "RAT_FUNC":
        functions = _rational(method, lower, upper)
    elif method.kind in _TABLE_KINDS:
        functions = _table_conversion(a2l, method)
    elif method.kind == "FORM":
        functions = _formula(method)
    else:
        raise A2lError(f"has the conversion {method.name} of the unknown kind {method.kind[:40]!r}")
    return CompuConversion(name, method.unit, *functions)


def _identity(values: Float) -> Float:
    return values


IDENTITY = CompuConversion("", "", _identity, _identity)


def _linear(slope: float, offset: float) -> tuple[Formula, Formula | None]:
    return lambda raw: slope * raw + offset, (lambda values: (values - offset) / slope) if slope else None


def _rational(method: CompuMethod, lower: float, upper: float) -> tuple[Formula, Formula]:
    a, b, c, d, e, f = method.coeffs

    def raw(values: Float) -> Float:
        with np.errstate(all="ignore"):
            return nan_if_infinite(((a * values + b) * values + c) / ((d * values + e) * values + f))

    def physical(values: Float) -> Float:
        with np.errstate(all="ignore"):
            return nan_if_infinite((f * values - c) / (b - e * values))

    # raw = c / f, whatever the physical value
    if not (a or b or d or e):
        raise A2lError(f"has the conversion {method.name}, which has no physical value")
    # (b p + c) / (e p + f) is constant if its determinant is 0
    if b * f == c * e and not (a or d):
        raise A2lError(f"has the conversion {method.name}, which maps every value to the same raw value")
    return (partial(_root, method.coeffs, lower, upper), raw) if a or d else (physical, raw)


def _root(coeffs: tuple[float, ...], lower: float, upper: float, values: Float) -> Float:
    """Return the root of the quadratic within the limits, NaN if none or both are."""
    a, b, c, d, e, f = coeffs
    # (a - d r) p^2 + (b - e r) p + (c - f r) = 0 for the raw value r
    square, linear, constant = a - d * values, b - e * values, c - f * values
    with np.errstate(all="ignore"):
        # the root without cancellation, the other one by their product (Press et al., Numerical Recipes, section 5.6)
        whole = -0.5 * (linear + np.where(linear < 0, -1.0, 1.0) * np.sqrt(linear * linear - 4 * square * constant))
        roots = nan_if_infinite(np.stack([whole / square, constant / whole]))
    # rounding may put the root of a limit just outside
    slack = 1e-9 * (np.abs(roots) + 1e-300)
    inside = (roots >= lower - slack) & (roots <= upper + slack)
    same = np.isclose(roots[0], roots[1], rtol=1e-12, atol=0)
    # a double root counts once
    inside[1] &= ~(inside[0] & same)
    return np.where(inside.sum(axis=0) == 1, np.where(inside[0], roots[0], roots[1]), np.nan)


def _table_conversion(a2l: A2l, method: CompuMethod) -> tuple[Formula, Formula | None]:
    table = a2l.compu_tabs.get(method.table)
    if table is None or not table.raw:
        raise A2lError(f"has the conversion {method.name}, whose table {method.table[:60]!r} is not defined")
    if method.kind == "TAB_VERB":
        raise A2lError(f"has the conversion {method.name}, whose table {table.name} contains no texts")
    if any(np.diff(table.raw) <= 0):
        raise A2lError(f"has the conversion {method.name}, whose table {table.name} contains a raw value twice")
    return _interpolating_table(table) if method.kind == "TAB_INTP" else _exact_table(table)


def _interpolating_table(table: CompuTab) -> tuple[Formula, Formula | None]:
    raw, physical = np.array(table.raw), np.array(table.physical)
    outside = np.nan if table.default is None else table.default
    steps = np.diff(physical)
    forwards = _interpolation(raw, physical, outside)
    if np.all(steps > 0):
        return forwards, _interpolation(physical, raw, np.nan)
    if np.all(steps < 0):
        # `np.interp` requires rising points
        return forwards, _interpolation(physical[::-1], raw[::-1], np.nan)
    return forwards, None


def _interpolation(points: Float, values: Float, outside: float) -> Formula:
    return lambda numbers: np.asarray(np.interp(numbers, points, values, left=outside, right=outside), np.float64)


def _exact_table(table: CompuTab) -> tuple[Formula, Formula]:
    raw, physical = np.array(table.raw), np.array(table.physical)
    # stable, so that of equal physical values the first raw one counts
    order = np.argsort(physical, kind="stable")
    missing = np.nan if table.default is None else table.default

    def forwards(values: Float) -> Float:
        at = np.clip(np.searchsorted(raw, values), 0, raw.size - 1)
        return np.where(raw[at] == values, physical[at], missing)

    def back(values: Float) -> Float:
        """Return the raw value of the closest physical one."""
        known = physical[order]
        above = np.clip(np.searchsorted(known, values), 0, known.size - 1)
        below = np.clip(above - 1, 0, known.size - 1)
        closer = np.where(np.abs(known[below] - values) <= np.abs(known[above] - values), below, above)
        return raw[order][closer]

    return forwards, back


def _formula(method: CompuMethod) -> tuple[Formula, Formula | None]:
    if not method.formula:
        raise A2lError(f"has the conversion {method.name}, which has no FORMULA")
    forwards, back = parse_formula(method.formula), parse_formula(method.formula_inverse)
    if forwards is None:
        raise A2lError(f"has the conversion {method.name}, whose formula {method.formula[:60]!r} is not supported")
    return forwards, back

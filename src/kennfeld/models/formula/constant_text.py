"""Constants as one would write them: 0.1, 1 / 175, pi / 30."""

import math
from fractions import Fraction
from typing import Final

_LONG: Final = 12  # digits from which a number is taken for a computed one
_LARGEST: Final = 100_000  # of numerators and denominators


def constant_text(value: float) -> str:
    """Return a constant as an expression of exactly this value.

    A number of many digits is a fraction, or a multiple of pi, if one of small numbers has its value.

    >>> constant_text(0.1), constant_text(1 / 175), constant_text(math.pi / 30), constant_text(-1 / 3)
    ('0.1', '1 / 175', 'pi / 30', '-1 / 3')
    """
    plain = repr(value).removesuffix(".0")
    if not math.isfinite(value) or sum(sign.isdigit() for sign in plain.partition("e")[0]) < _LONG:
        return plain
    return next(filter(None, (_fraction(value), _multiple_of_pi(value), _share_of_pi(value))), plain)


def _nearest_fraction(value: float) -> tuple[int, int]:
    if not 1 / _LARGEST < abs(value) < _LARGEST:
        return 0, 1
    return Fraction(value).limit_denominator(1000).as_integer_ratio()


def _fraction(value: float) -> str:
    above, below = _nearest_fraction(value)
    return f"{above} / {below}" if above / below == value and abs(above) < _LARGEST else ""


def _multiple_of_pi(value: float) -> str:
    above, below = _nearest_fraction(value / math.pi)
    # in the order in which the text is evaluated
    if abs(above) > 1000 or above * math.pi / below != value:
        return ""
    sign = "-" if above < 0 else ""
    factor = f"{above} * pi" if abs(above) != 1 else f"{sign}pi"
    return factor if below == 1 else f"{factor} / {below}"


def _share_of_pi(value: float) -> str:
    above, below = _nearest_fraction(value * math.pi)
    if not above or abs(above) > 1000 or above / (below * math.pi) != value:
        return ""
    return f"{above} / ({below} * pi)" if below != 1 else f"{above} / pi"

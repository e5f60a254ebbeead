"""Raw values of bus signals that stand for no measurement: 255 = "SNA" beside a scaled temperature."""

import re

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.measurement.bus_messages import BusSignal

# words that control units use for a signal without a value; cantools returns the text itself for all names
_NO_VALUE = re.compile(
    r"sna|(?:.* )?(?:signal |data |value )?not (?:available|valid|defined|present|used|supported|installed)(?: .*)?"
    r"|(?:.* )?(?:unavailable|invalid|undefined|unknown|reserved|unused|ungueltig|ungültig|fehler|failure)(?: .*)?"
    r"|(?!no |kein)(?:.* )?(?:error|fault|defect)(?: .*)?|n a|nan|no (?:data|value|signal|info|information)"
    r"|(?:.* )?nicht (?:verfuegbar|verfügbar|vorhanden|definiert|gueltig|gültig)(?: .*)?"
    r"|init(?:ial|ialisation|ialization|ialisierung)?(?: value)?",
    re.IGNORECASE,
)
_WORD_BOUNDARY = re.compile(r"[\W_]+|(?<=[a-z])(?=[A-Z])")


def says_no_value(text: str) -> bool:
    """Return whether the name of a raw value says that there is none.

    >>> says_no_value("Signal_NotAvailable"), says_no_value("SNA"), says_no_value("No_Error"), says_no_value("Idle")
    (True, True, False, False)
    """
    return _NO_VALUE.fullmatch(" ".join(filter(None, _WORD_BOUNDARY.split(text)))) is not None


def is_state(signal: BusSignal) -> bool:
    """Return whether a signal is a state: an unscaled integer of which at least half the values have a name."""
    return not signal.is_scaled and 2 * len(signal.texts) >= 1 << signal.length


def missing_texts(signal: BusSignal) -> dict[int, str]:
    """Return the raw values of a signal that stand for no measurement, with their names; of a state, none.

    >>> missing_texts(BusSignal("Temp", 0, 8, factor=0.5, texts=((0, "Cold"), (255, "SNA"))))
    {255: 'SNA'}
    """
    if signal.kind == "f" or is_state(signal):
        return {}
    return {value: text for value, text in signal.texts if says_no_value(text)}


def without_texts(raw: Float, values: Float, signal: BusSignal) -> dict[str, int]:
    """Make values, Float[frames], of raw ones that stand for no measurement NaN; return how often each text occurs."""
    counts: dict[str, int] = {}
    for value, text in missing_texts(signal).items():
        samples = raw == value
        count = int(np.count_nonzero(samples & ~np.isnan(values)))
        if count:
            values[samples] = np.nan
            counts[text] = counts.get(text, 0) + count
    return counts

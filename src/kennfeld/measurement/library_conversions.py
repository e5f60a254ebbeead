"""Conversions of MDF channels as the library that reads every MDF file holds them."""

from collections.abc import Iterator
from typing import Any

from kennfeld.measurement.mdf_conversions import KINDS_4, ConversionKind, MdfConversion

# by the numbers of version 3; 65535 is the identity
_KINDS_3 = {
    0: ConversionKind.LINEAR,
    1: ConversionKind.INTERPOLATED,
    2: ConversionKind.NEAREST,
    6: ConversionKind.POLYNOMIAL,
    7: ConversionKind.EXPONENTIAL,
    8: ConversionKind.LOGARITHMIC,
    9: ConversionKind.RATIONAL,
    10: ConversionKind.FORMULA,
    11: ConversionKind.TEXTS,
    12: ConversionKind.TEXT_RANGES,
}
# names of the parameters that repeat, and of the one that follows them
_REPEATED = {
    ConversionKind.INTERPOLATED: (("raw", "phys"), ""),
    ConversionKind.NEAREST: (("raw", "phys"), ""),
    ConversionKind.RANGES: (("lower", "upper", "phys"), "default"),
    ConversionKind.TEXTS: (("val",), ""),
    ConversionKind.TEXT_RANGES: (("lower", "upper"), ""),
    ConversionKind.TEXT_VALUES: (("val",), "val_default"),
}
_SINGLE = {
    # physical = b + a * raw
    ConversionKind.LINEAR: ("b", "a"),
    ConversionKind.RATIONAL: tuple(f"P{k}" for k in range(1, 7)),
    ConversionKind.POLYNOMIAL: tuple(f"P{k}" for k in range(1, 7)),
    ConversionKind.EXPONENTIAL: tuple(f"P{k}" for k in range(1, 8)),
    ConversionKind.LOGARITHMIC: tuple(f"P{k}" for k in range(1, 8)),
}
_WITH_DEFAULT = (ConversionKind.TEXTS, ConversionKind.TEXT_RANGES)
_SCALED_TEXT = "{X}"  # in a text of version 3 that stands for a scale


def conversion_of(block: Any, version: str) -> MdfConversion | None:
    """Return the conversion of a channel of the library; `version` is that of the file."""
    if block is None:
        return None
    kinds = KINDS_4 if version >= "4" else _KINDS_3
    kind = kinds.get(int(block.conversion_type), ConversionKind.IDENTITY)
    return MdfConversion(kind, tuple(_values(block, kind)), _references(block, kind, version), str(block.unit or ""))


def _values(block: Any, kind: ConversionKind) -> Iterator[float]:
    for name in _SINGLE.get(kind, ()):
        yield float(getattr(block, name))
    names, last = _REPEATED.get(kind, ((), ""))
    place = 0
    while names:
        values = [getattr(block, f"{_spelt(block, name)}_{place}", None) for name in names]
        if any(value is None for value in values):
            break
        yield from map(float, values)  # type: ignore[arg-type]  # none of them is None
        place += 1
    if last:
        yield float(getattr(block, last))


def _spelt(block: Any, name: str) -> str:
    """Return the name of a parameter, which is another one in version 3."""
    return "param_val" if name == "val" and hasattr(block, "param_val_0") else name


def _references(block: Any, kind: ConversionKind, version: str) -> tuple[str | MdfConversion | None, ...]:
    if kind is ConversionKind.FORMULA:
        own = getattr(block, "formula_field", None)  # the library rewrites that of version 3
        return (own.decode("latin-1").strip(" \t\r\n\0") if isinstance(own, bytes) else str(block.formula),)
    if kind not in (*_WITH_DEFAULT, ConversionKind.TEXT_VALUES):
        return ()
    blocks = getattr(block, "referenced_blocks", None) or {}
    references = []
    place = 0
    while f"text_{place}" in blocks or hasattr(block, f"text_{place}"):
        own = blocks.get(f"text_{place}", getattr(block, f"text_{place}", None))
        references.append(_reference(own, version))
        place += 1
    if kind in _WITH_DEFAULT:
        references.append(_reference(blocks.get("default_addr"), version))
    return tuple(references)


def _reference(content: Any, version: str) -> str | MdfConversion | None:
    if isinstance(content, bytes):
        text = content.decode("utf-8" if version >= "4" else "latin-1", "replace").split("\0", 1)[0].strip()
        return (_scale_in(text) if version < "4" and _SCALED_TEXT in text else None) or text or None
    return conversion_of(content, version) if hasattr(content, "conversion_type") else None


def _scale_in(text: str) -> MdfConversion | None:
    """Return the linear scale that a text of version 3 states: `"0.5*{X}-40"`."""
    factor, _, offset = text.strip('"').replace(" ", "").partition("*{X}")
    try:
        return MdfConversion(ConversionKind.LINEAR, (float(offset or 0.0), float(factor or 1.0)))
    except ValueError:
        return None

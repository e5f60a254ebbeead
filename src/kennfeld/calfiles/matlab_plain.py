"""Values of the MATLAB language in the form that calibrations are made of: plain numbers, texts, structs."""

import numpy as np

from kennfeld.calfiles.matlab_values import Opaque, Struct, Value
from kennfeld.matlab import values as m
from kennfeld.matlab.objects import Breakpoint, LookupTable, Parameter, parameter_of

__all__ = ["plain_of"]

_LETTERS = "xyzw"
_WORDS = {"complex numbers": "complex number"}
_DEEPEST = 40


def plain_of(value: m.Value, depth: int = 0) -> Value:
    """A value as a calibration reads it; objects such as Simulink.Parameter as structs of what they say."""
    if isinstance(value, np.ndarray):
        return _array(value)
    if depth > _DEEPEST or isinstance(value, m.Handle | m.Opaque):
        kind = "function" if isinstance(value, m.Handle) else getattr(value, "kind", "value too deep within others")
        return Opaque(_WORDS.get(kind, kind))
    if isinstance(value, m.Cell):
        return [plain_of(one, depth + 1) for one in value.values.ravel(order="F")]
    if value.kind:
        return _object(value)
    elements = [Struct({k: plain_of(v, depth + 1) for k, v in one.items()}) for one in value.elements.ravel(order="F")]
    return elements[0] if len(elements) == 1 else list(elements)


def _array(value: m.Array) -> Value:
    if value.dtype.kind == "U":
        return "\n".join("".join(line) for line in value.tolist()) if value.ndim == 2 else ""
    if value.dtype.kind == "O":
        return str(value.flat[0]) if value.size == 1 else [str(one) for one in value.ravel(order="F")]
    return value.astype(np.float64)


def _object(value: m.Struct) -> Value:
    meant = parameter_of(value)
    if meant is None:
        return Opaque(value.kind)
    if not isinstance(meant, LookupTable):
        return Struct({"Value": meant.value, **_said(meant)})
    axes = dict(zip(_LETTERS, meant.breakpoints, strict=False))
    units: dict[str, Value] = {f"{letter}_unit": axis.unit for letter, axis in axes.items() if axis.unit}
    points: dict[str, Value] = {letter: axis.value for letter, axis in axes.items()}
    return Struct({**points, **units, "values": meant.value, **_said(meant)})


def _said(meant: Parameter | LookupTable | Breakpoint) -> dict[str, Value]:
    said = {"Unit": meant.unit, "Description": meant.description}
    return {name: word for name, word in said.items() if word}

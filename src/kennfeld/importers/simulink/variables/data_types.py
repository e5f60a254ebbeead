"""Data types of signals: buses, integers and fixed-point numbers, by name, expression or object of the variables."""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, TypeAlias

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.base.formatting import number_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.reader.dialog_words import after_word, begins_with_word, contains_word, match_word
from kennfeld.importers.simulink.reader.model_tree import ModelBlock
from kennfeld.importers.simulink.variables.m_files import evaluate_numerically
from kennfeld.importers.simulink.variables.mask_scope import (
    MaskCodeVariable,
    MaskVariable,
    ParameterValue,
    Scope,
    Variable,
)
from kennfeld.matlab import simulink_types as types
from kennfeld.matlab.parser import parse_expression
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.integer_types import IntegerType, integer_type_named

_BUILT_IN: Final = frozenset({"double", "single", "half", "boolean", "logical", "bool", "string", "fcn_call", "action"})
# what begins a setting that names no type of numbers, or none at all
_NO_TYPE: Final = ("Inherit", "Enum:", "Image:", "Connection:", "Specify", "<", "?", "Logical (")
_SAME: Final = ("Same as first input", "Same as input")
_BACK: Final = "Inherit via back propagation"
_EXPRESSION = re.compile(r"[A-Za-z][\w.]*(?:\(|\Z)")
_NAME = re.compile(r"[A-Za-z]\w*\Z")
_CONSTRUCTOR = re.compile(r"([su])(fix|int|frac)\(\s*(\d{1,3})\s*\)\Z")  # sfix(16) of older files
_FLOAT = re.compile(r"float\(\s*'(\w+)'\s*\)\Z")
# sfix16_En4, ufix8_S0p5_B2: a slope 2^-4, and a slope 0.5 with the bias 2
_ENCODED = re.compile(r"([su])fix(\d{1,3})((?:_[EFSB]n?\d+(?:p\d+)?(?:en?\d+)?)*)\Z")
_PART = re.compile(r"_([EFSB])([^_]+)")
_MAX_DEPTH: Final = 20  # aliases of aliases, masks within masks


@dataclass(frozen=True)
class FixedPointType:
    """A type whose stored integers n mean slope n + bias; an integer type has slope 1 and bias 0."""

    bits: int
    signed: bool
    slope: float = 1.0
    bias: float = 0.0

    @property
    def is_integer(self) -> bool:
        """True for a plain integer type."""
        return self.slope == 1 and self.bias == 0

    @property
    def limits(self) -> tuple[float, float]:
        """The smallest and the largest value.

        >>> FixedPointType(8, True, 0.0625).limits
        (-8.0, 7.9375)
        """
        word = IntegerType(self.bits, self.signed)
        return word.least * self.slope + self.bias, word.most * self.slope + self.bias

    def __str__(self) -> str:
        least, most = map(number_text, self.limits)
        return f"steps of {number_text(self.slope)} from {least} to {most}"


@dataclass(frozen=True)
class BusElement:
    """An element of a bus or a value type: its dimensions, None if they are inherited, its type and its unit."""

    name: str
    dimensions: tuple[int, ...] | None
    type: str
    unit: str = ""


@dataclass(frozen=True)
class BusType:
    """A bus object: its name, its elements in order, and the source that defines it."""

    name: str
    elements: tuple[BusElement, ...]
    source: str = ""

    def __str__(self) -> str:
        return f"the bus {self.name} of {self.source}"


@dataclass(frozen=True)
class PlainType:
    """A built-in type that is no integer, such as double or boolean."""

    name: str


@dataclass(frozen=True)
class UndefinedType:
    """A type whose object the model's variables do not define; `is_bus` if its name is written as that of a bus."""

    name: str
    is_bus: bool = False


DataType: TypeAlias = PlainType | FixedPointType | BusType | BusElement | UndefinedType


def data_type(written: str, scope: Scope, depth: int = 0) -> DataType | None:
    """Return the type that a field specifies, through aliases and masks; None if it is inherited or enumerated."""
    written = written.strip()
    if written.casefold() in _BUILT_IN:
        return PlainType(written.casefold())
    if not written or depth > _MAX_DEPTH or match_word(written, ["auto"]) is not None:
        return None
    if any(begins_with_word(written, word) for word in _NO_TYPE):
        return None
    if (word := integer_type_named(written)) is not None:
        return FixedPointType(word.bits, word.signed)
    if (encoded := _encoded_type(written)) is not None:
        return encoded
    if (floating := _FLOAT.match(written)) is not None:
        return data_type(floating[1], scope, depth + 1)
    of_bus = after_word(written, "Bus:")
    name = after_word(written, "ValueType:") if of_bus is None else of_bus
    name = written if name is None else name
    if not _NAME.match(name):
        return _type_of_expression(written, scope, depth)
    meaning = scope.find(name)
    if isinstance(meaning, MaskVariable):
        return data_type(meaning.text, meaning.outside, depth + 1)
    if isinstance(meaning, Variable):
        return _type_of_object(name, meaning, scope, depth)
    return UndefinedType(name, of_bus is not None)


def output_type(block: ModelBlock, scope: Scope) -> DataType | None:
    """Return the type that a block specifies for its output, None if it is inherited."""
    written = (block.value("OutDataTypeStr") or "").strip()
    if match_word(written, ["Inherit: Same as accumulator"]) is not None:
        written = (block.value("AccumDataTypeStr") or "").strip()
    return data_type(written, scope) if written else _type_of_older_fields(block, scope)


def stated_type(block: ModelBlock) -> str:
    """Return the text by which a block specifies the type of its output, "" if it is inherited."""
    # the key of newer files first; the mode of older ones names the type unless it refers to an expression
    words = ((block.value(key) or "").strip() for key in ("OutDataTypeStr", "OutDataTypeMode", "DataType"))
    return next((word for word in words if word and not _is_inherited(word)), "")


def _is_inherited(word: str) -> bool:
    inherited = any(begins_with_word(word, text) for text in ("Inherit", "Same as", "Specify"))
    return inherited or match_word(word, ["auto"]) is not None


def has_type_of_input(block: ModelBlock) -> bool:
    """Return True if a block takes the type of its output from its first input."""
    written = _inheritance(block)
    return bool(written) and match_word(after_word(written, "Inherit:") or written, _SAME) is not None


def has_type_of_readers(block: ModelBlock) -> bool:
    """Return True if a block takes the type of its output from those that read it, as conversions do by default."""
    written = _inheritance(block) or (_BACK if block.type == "DataTypeConversion" else "")
    return bool(written) and match_word(after_word(written, "Inherit:") or written, [_BACK]) is not None


def _inheritance(block: ModelBlock) -> str:
    return block.value("OutDataTypeStr") or block.value("OutDataTypeMode") or ""


def _type_of_older_fields(block: ModelBlock, scope: Scope) -> DataType | None:
    """Return the type that a file before R2009b specifies, in several fields."""
    if block.is_set_to("UseBusObject", "on"):
        return data_type(f"Bus: {block.value('BusObject') or ''}", scope)
    for field in ("OutDataTypeMode", "DataType"):
        mode = (block.value(field) or "").strip()
        kind = _type_of_dialog(block, scope) if begins_with_word(mode, "Specify") else data_type(mode, scope)
        if kind is not None:
            return kind
    return None


def _type_of_dialog(block: ModelBlock, scope: Scope) -> DataType | None:
    """Return the type of the fields for bits and scaling, which count if the mode says so."""
    kind = data_type(block.value("OutDataType") or "", scope)
    scaling = _evaluate(block.value("OutScaling") or "", scope)
    if isinstance(kind, FixedPointType) and isinstance(scaling, np.ndarray) and scaling.size in (1, 2):
        slope, bias = float(scaling.flat[0]), float(scaling.flat[1]) if scaling.size == 2 else 0.0
        return replace(kind, slope=slope, bias=bias) if slope > 0 else kind
    return kind


def _type_of_object(name: str, variable: Variable, scope: Scope, depth: int) -> DataType | None:
    if not isinstance(variable.value, Mapping) or not variable.kind:
        # a mask or a script may keep the name of a type in a text; any other value defines none
        text = variable.value
        return data_type(text, scope, depth + 1) if isinstance(text, str) else UndefinedType(name)
    properties = _Properties(variable.value)
    match variable.kind:
        case types.BUS:
            listed = properties.structs("Elements")
            return BusType(name, tuple(_element(_Properties(part), scope) for part in listed), variable.source)
        case types.ALIAS_TYPE:
            return data_type(properties.text("BaseType"), scope, depth + 1)
        case types.VALUE_TYPE:
            return _element(properties, scope)
    return _numeric_type(properties, scope, depth)


class _Properties:
    """The properties of an object, by name in any case; older scripts write some in lower case."""

    def __init__(self, values: Mapping[str, ParameterValue]) -> None:
        self._values = {name.casefold(): value for name, value in values.items()}

    def __contains__(self, name: str) -> bool:
        return name.casefold() in self._values

    def text(self, name: str, default: str = "") -> str:
        value = self._values.get(name.casefold())
        return value.strip() if isinstance(value, str) and value.strip() else default

    def numbers(self, name: str, scope: Scope) -> tuple[float, ...]:
        """Return numbers, also of a text such as the name of a variable; () if there are none."""
        value = self._values.get(name.casefold())
        if isinstance(value, str):
            value = _evaluate(value, scope)
        return tuple(float(n) for n in value.ravel()) if isinstance(value, np.ndarray) else ()

    def number(self, name: str, scope: Scope, default: float) -> float:
        numbers = self.numbers(name, scope)
        return numbers[0] if numbers else default

    def structs(self, name: str) -> tuple[Mapping[str, ParameterValue], ...]:
        value = self._values.get(name.casefold(), ())
        listed = value if isinstance(value, tuple) else (value,)
        return tuple(part for part in listed if isinstance(part, Mapping))


def _element(properties: _Properties, scope: Scope) -> BusElement:
    numbers = properties.numbers("Dimensions", scope)
    # without dimensions an element is a scalar; those that are inherited or have no value stay open
    whole = all(number >= 1 and number.is_integer() for number in numbers)
    dimensions = tuple(map(int, numbers)) if whole and numbers else None if "Dimensions" in properties else (1,)
    unit = properties.text("Unit") or properties.text("DocUnits")
    return BusElement(properties.text("Name", "a"), dimensions, properties.text("DataType", "double"), unit)


def _numeric_type(properties: _Properties, scope: Scope, depth: int) -> DataType | None:
    mode = properties.text("DataTypeMode", "Double")
    if not begins_with_word(mode, "Fixed-point"):
        return data_type(mode.casefold(), scope, depth + 1)
    # properties that a file does not store have the defaults of a new object
    bits = properties.number("WordLength", scope, 16)
    if not (bits.is_integer() and 1 <= bits <= types.MOST_BITS):
        return None
    is_unsigned = match_word(properties.text("Signedness", "Signed"), ["Unsigned"]) is not None
    signed = properties.number("Signed", scope, 1) != 0 and not is_unsigned
    slope, bias = 1.0, 0.0
    if contains_word(mode, "binary point"):
        slope = float(np.exp2(-properties.number("FractionLength", scope, 0)))
    elif contains_word(mode, "slope"):
        factor = properties.number("SlopeAdjustmentFactor", scope, 1)
        total = factor * float(np.exp2(properties.number("FixedExponent", scope, 0)))
        slope, bias = properties.number("Slope", scope, total), properties.number("Bias", scope, 0)
    return FixedPointType(int(bits), signed, slope, bias)


def _encoded_type(written: str) -> FixedPointType | None:
    """Return the type of a name that encodes its scaling, or of a function of older releases, None for others."""
    if match := _CONSTRUCTOR.match(written):
        signed, bits = match[1] == "s", int(match[3])
        # a fraction has its binary point behind the sign
        slope = float(np.exp2(int(signed) - bits)) if match[2] == "frac" else 1.0
        return FixedPointType(bits, signed, slope) if 1 <= bits <= types.MOST_BITS else None
    match = _ENCODED.match(written)
    if match is None or not 1 <= int(match[2]) <= types.MOST_BITS:
        return None
    parts = {key: _decoded_number(text) for key, text in _PART.findall(match[3])}
    # slope = F 2^E, or S
    slope = parts.get("S", parts.get("F", 1.0) * float(np.exp2(parts.get("E", 0.0))))
    return FixedPointType(int(match[2]), match[1] == "s", slope, parts.get("B", 0.0))


def _decoded_number(text: str) -> float:
    """Return a number of a type name, in which p is the point and n the minus."""
    return float(text.replace("p", ".").replace("n", "-"))


def _type_of_expression(written: str, scope: Scope, depth: int) -> DataType | None:
    """Return the type of an expression such as `fixdt(1, WordLength, 4)`."""
    # anything but a call or a field is a setting, such as "Same as input"
    if not _EXPRESSION.match(written):
        return None
    value = _evaluate(written, scope)
    if isinstance(value, str):
        return data_type(value, scope, depth + 1)
    if not isinstance(value, Mapping):
        return UndefinedType(written[:60])
    properties = _Properties(value)
    if "BaseType" in properties:
        return data_type(properties.text("BaseType"), scope, depth + 1)
    return _numeric_type(properties, scope, depth) if "WordLength" in properties else UndefinedType(written[:60])


def _evaluate(text: str, scope: Scope) -> ParameterValue | None:
    """Return the value of an expression, None if it has none."""

    def value_of(name: str) -> ParameterValue | None:
        meaning = scope.find(name)
        if isinstance(meaning, MaskVariable):
            return _evaluate(meaning.text, meaning.outside) if meaning.evaluated else meaning.text
        return None if meaning is None or isinstance(meaning, MaskCodeVariable) else meaning.value

    try:
        return evaluate_numerically(parse_expression(text), value_of)[0]
    except (InputError, EvaluationError, RecursionError):
        return None

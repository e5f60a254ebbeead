"""Types on the wire: what a page asks, and what it is answered, as dataclasses beside the questions.

A field is called on the wire as in Python, in camel case and without an underscore at its end: `at_bound` is `atBound`,
`from_` is `from`. A field that is `ABSENT` is not on the wire. Arrays of a reply travel beside its JSON, see `frames`.
`scripts/wire_types.py` writes the types of the page from these.
"""

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Generic, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from kennfeld.app.answer import Answer
from kennfeld.base.errors import ArgumentError
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass

Subject = TypeVar("Subject")  # Python 3.11

Toml = Annotated[Any, "Toml"]  # a value of a project file
KeyPath = Annotated[tuple[str | int, ...], "Path"]  # entries of a list count from 1
KeyChange = tuple[KeyPath, Toml | None]  # null removes the key

SHOWN = 100  # characters of a wrong value in a message
_PLAIN = (str, int, float, NoneType)
_NUMBERS: Mapping[Any, set[type]] = {int: {int}, float: {int, float}}  # types of JSON that are such numbers
_PHRASES = {str: "a text", int: "an integer", float: "a number", bool: "true or false"}


class Absent(Enum):
    """The type of a field that a reply may lack."""

    ABSENT = "absent"


ABSENT: Final = Absent.ABSENT


@dataclass(frozen=True)
class WireField:
    """A field of a dataclass on the wire.

    Attributes:
        attribute: its name in Python.
        name: its name on the wire.
        kind: its annotation.
        required: True if it has no default.
    """

    attribute: str
    name: str
    kind: Any
    required: bool


@cache
def wire_fields(record: Hashable) -> tuple[WireField, ...]:
    """Return the fields of a dataclass as they are on the wire."""
    assert isinstance(record, type)
    assert is_dataclass(record)
    kinds = get_type_hints(record, include_extras=True)
    return tuple(
        WireField(
            field.name,
            field.metadata.get("wire", wire_name(field.name)),
            kinds[field.name],
            field.default is MISSING and field.default_factory is MISSING,
        )
        for field in fields(record)
    )


def wire_name(attribute: str) -> str:
    """Return the name of an attribute on the wire.

    >>> wire_name("at_bound"), wire_name("from_")
    ('atBound', 'from')
    """
    first, *others = attribute.rstrip("_").split("_")
    return "".join([first, *(word.capitalize() for word in others)])


def members(kind: Any) -> tuple[Any, ...]:
    """Return the alternatives of a union, or the type itself."""
    return get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)


def is_array(kind: Any) -> bool:
    """Return True for the type of an array, which travels beside the JSON."""
    return any(get_origin(each) is np.ndarray for each in members(kind))


def is_arrays(kind: Any) -> bool:
    """Return True for the type of arrays by name."""
    return get_origin(kind) is Mapping and is_array(get_args(kind)[1])


def to_answer(reply: object) -> Answer:
    """Return the answer that a reply is on the wire: its arrays, and the rest as JSON."""
    if reply is None:
        return Answer()
    head, arrays = dict[str, Any](), dict[str, Any]()
    record: Any = type(reply)
    for field in wire_fields(record):
        value = getattr(reply, field.attribute)
        if is_arrays(field.kind):
            arrays |= value
        elif not is_array(field.kind):
            head |= {} if value is ABSENT else {field.name: to_json(value)}
        elif value is not None:
            arrays[field.name] = value
    return Answer(head, arrays)


def to_json(value: Any) -> Any:
    """Return a value of a reply as JSON has it. Lists hold either records or plain values."""
    if isinstance(value, list | tuple):
        plain = not value or isinstance(value[0], _PLAIN)  # long lists of numbers are not walked
        return list(value) if plain else [to_json(each) for each in value]
    if isinstance(value, Mapping):
        return {key: to_json(each) for key, each in value.items()}
    if is_dataclass(value):
        record: Any = type(value)
        pairs = ((name, getattr(value, attribute)) for attribute, name in _names(record))
        return {n: v if isinstance(v, _PLAIN) else to_json(v) for n, v in pairs if v is not ABSENT}
    return value


@cache
def _names(record: Hashable) -> tuple[tuple[str, str], ...]:
    return tuple((field.attribute, field.name) for field in wire_fields(record))


def from_json(kind: Any, value: Any, place: str) -> Any:
    """Return a value of a page as a type has it.

    Args:
        kind: a dataclass, or an annotation of one of its fields.
        value: what JSON says.
        place: where it is said, for messages: `strip.signals[0].name`.

    Raises:
        ArgumentError: the value is of another type, a key is missing, or there is no such key.

    >>> from_json(Mapping[str, Sequence[int] | None], {"MapX": [1, 2.0], "MapY": None}, "accept.cells")
    {'MapX': (1, 2), 'MapY': None}
    """
    kind = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    origin = get_origin(kind)
    if kind is Any:
        return value
    if origin in (Union, UnionType):
        return _alternative(kind, value, place)
    if is_dataclass(kind):
        return _record(kind, value, place)
    if origin in (Sequence, tuple):
        return _sequence(get_args(kind), value, place)
    if origin is Mapping:
        return {
            key: from_json(get_args(kind)[1], each, f"{place}.{key}") for key, each in _object(value, place).items()
        }
    read = _number_of(kind, value) if kind in (int, float) else value if _is_of(kind, value) else None
    if read is None:
        raise ArgumentError(f"{place} must be {_phrase(kind)}, got {_shown(value)}")
    return read


def _record(kind: Any, value: Any, place: str) -> Any:
    known = {field.name: field for field in wire_fields(kind)}
    for key in _object(value, place):
        if key not in known:
            remedy = nearest(key, known) or f"Known keys: {', '.join(known) or 'none'}"
            raise ArgumentError(f"{place}: unknown key {_shown(key)}. {remedy}")
    missing = [field.name for field in known.values() if field.required and field.name not in value]
    if missing:
        raise ArgumentError(f"{place}: {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing")
    return kind(
        **{known[key].attribute: from_json(known[key].kind, each, f"{place}.{key}") for key, each in value.items()}
    )


def _alternative(kind: Any, value: Any, place: str) -> Any:
    if value is None and NoneType in members(kind):
        return None
    others = [each for each in members(kind) if each not in (NoneType, Absent)]
    if len(others) == 1:
        return from_json(others[0], value, place)
    for each in others:  # the first that has the value, in the order of the annotation
        try:
            return from_json(each, value, place)
        except ArgumentError:
            continue
    raise ArgumentError(f"{place} must be {' or '.join(map(_phrase, others))}, got {_shown(value)}")


def _sequence(kinds: tuple[Any, ...], value: Any, place: str) -> tuple[Any, ...]:
    """Return a list as a tuple; `kinds` are those of a tuple, or of all elements."""
    if not isinstance(value, list | tuple):
        raise ArgumentError(f"{place} must be a list, got {_shown(value)}")
    if len(kinds) == 1 or kinds[1] is ...:
        if _are_numbers(kinds[0], value):  # a drag sends all values of a table with every move
            return tuple(value)
        kinds = (kinds[0],) * len(value)
    if len(kinds) != len(value):
        raise ArgumentError(f"{place} must have {len(kinds)} elements, got {len(value)}")
    return tuple(
        from_json(kind, each, f"{place}[{k}]") for k, (kind, each) in enumerate(zip(kinds, value, strict=True))
    )


def _are_numbers(kind: Any, values: Sequence[Any]) -> bool:
    """Return True if a type of numbers has all values as they are; others are looked at one by one."""
    if kind not in _NUMBERS or not {*map(type, values)} <= _NUMBERS[kind]:
        return False
    try:
        return all(map(math.isfinite, values))
    except OverflowError:
        return False


def _object(value: Any, place: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ArgumentError(f"{place} must be an object with keys, got {_shown(value)}")
    return value


def _number_of(kind: Any, value: Any) -> int | float | None:
    """Return a number, a whole one of any notation if it is to be an int; None for all else.

    Python reads NaN and infinities from JSON, which has neither; they would reach tables and datasets.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    if not math.isfinite(number):
        return None
    return value if kind is float else int(value) if number.is_integer() else None


def _is_of(kind: Any, value: Any) -> bool:
    if get_origin(kind) is Literal:
        return any(value == each and type(value) is type(each) for each in get_args(kind))
    return isinstance(value, kind)


def _phrase(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return " or ".join(map(repr, get_args(kind)))
    return _PHRASES.get(kind, "an object with keys" if is_dataclass(kind) else "a list")


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


@dataclass(frozen=True)
class Question(Generic[Subject]):
    """A question of a page.

    Attributes:
        name: its name on the wire.
        function: answers it for a session or a workspace. Its second argument, if it has one, is a dataclass of what is
            asked, and its annotation of the result is one of the reply, or None.
    """

    name: str
    function: Callable[..., object]

    def __call__(self, subject: Subject, details: Mapping[str, Any]) -> Answer:
        """Return the answer. Raises `ArgumentError` if what is asked has other keys or types."""
        asked = from_json(self.asked or Nothing, details, self.name)
        return to_answer(self.function(subject, *([] if self.asked is None else [asked])))

    @property
    def asked(self) -> type | None:
        """The dataclass of what is asked; None if the question has no details."""
        return _signature(self.function)[0]

    @property
    def reply(self) -> Any:
        """The annotation of the reply."""
        return _signature(self.function)[1]


@dataclass(frozen=True)
class Nothing:
    """The details of a question that has none."""


@cache
def _signature(function: Callable[..., object]) -> tuple[type | None, Any]:
    hints = dict(get_type_hints(function, include_extras=True))
    reply = hints.pop("return")
    _, *asked = hints.values()
    return (asked[0] if asked else None), reply


def questions_of(functions: Mapping[str, Callable[..., object]]) -> dict[str, Question[Any]]:
    """Return questions by their names on the wire."""
    return {name: Question(name, function) for name, function in functions.items()}

"""Dataclasses whose methods are written when they are first called.

`dataclasses.dataclass` writes and compiles five methods for a frozen class when its module is imported, which takes 0.4
ms on CPython 3.11. A command imports hundreds of classes and calls few of their methods, so that this was a tenth of
its time. The decorator of this module takes the fields from the standard library and defers the methods.

With plain dataclasses, `kennfeld check` and `kennfeld calibrate` of the torque demo, which import 218 and 314 classes,
take 12 % more CPU time, `kennfeld --help` 4 %; `import kennfeld` has no classes. Classes of attrs take almost three
times as long as these. Structs of msgspec take a tenth, but have neither `dataclasses.replace` nor fields that a
comparison or a text leaves out.
"""

from collections.abc import Callable
from dataclasses import MISSING, Field, FrozenInstanceError, fields
from dataclasses import dataclass as standard_dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

Writer = Callable[[type], Callable[..., Any]]
_SETTINGS = "__dataclass_params__"


class _FactoryDefault:
    """The default of an argument whose field has a factory."""

    def __repr__(self) -> str:
        return "<factory>"


_FACTORY = _FactoryDefault()


def _deferred_dataclass(
    cls: type | None = None,
    /,
    *,
    init: bool = True,
    eq: bool = True,
    frozen: bool = False,
    kw_only: bool = False,
    slots: bool = False,
) -> Any:
    """Return the class as a dataclass; arguments as those of `dataclasses.dataclass`.

    A class with slots has all methods at once, as the standard library replaces it by another class.
    """
    if cls is None:
        return partial(_deferred_dataclass, init=init, eq=eq, frozen=frozen, kw_only=kw_only, slots=slots)
    if slots:
        return standard_dataclass(init=init, eq=eq, frozen=frozen, kw_only=kw_only, slots=True)(cls)
    own = set(vars(cls))
    inherits = frozen and any(getattr(base, _SETTINGS).frozen for base in cls.__mro__[1:] if hasattr(base, _SETTINGS))
    # the standard library demands that classes over frozen ones are frozen
    standard_dataclass(init=False, repr=False, eq=False, kw_only=kw_only, frozen=inherits)(cls)
    getattr(cls, _SETTINGS).frozen = frozen  # so that the standard library knows it if another class inherits
    writers: dict[str, Writer] = {"__repr__": _write_repr}
    if init:
        writers["__init__"] = _write_frozen_init if frozen else _write_init
    if eq:
        writers["__eq__"] = _write_eq
        if frozen:
            writers["__hash__"] = _write_hash
        elif "__hash__" not in own:
            cls.__hash__ = None  # type: ignore[assignment]  # as Python does for a class with `__eq__`
    for name, write in writers.items():
        # methods of the class itself stay; Python sets `__hash__` to None if a class has only `__eq__`
        if name not in own or (name == "__hash__" and vars(cls)[name] is None):
            setattr(cls, name, _Deferred(name, cls, write))
    if frozen:
        cls.__setattr__, cls.__delattr__ = _refuse_assignment, _refuse_deletion  # type: ignore[method-assign, assignment]
    return cls


if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:
    dataclass = _deferred_dataclass


class _Deferred:
    """A method that takes its own place in the class when it is first looked up."""

    def __init__(self, name: str, owner: type, write: Writer) -> None:
        self._name, self._owner, self._write = name, owner, write

    def __get__(self, instance: object | None, owner: type) -> Any:
        method = self._write(self._owner)
        method.__name__, method.__module__ = self._name, self._owner.__module__
        method.__qualname__ = f"{self._owner.__qualname__}.{self._name}"
        setattr(self._owner, self._name, method)
        return method if instance is None else method.__get__(instance, owner)


def _write_init(cls: type) -> Callable[..., Any]:
    return _compile_init(cls, "self.{name} = {value}")


def _write_frozen_init(cls: type) -> Callable[..., Any]:
    return _compile_init(cls, "__set_field__(self, {name!r}, {value})")


def _compile_init(cls: type, assignment: str) -> Callable[..., Any]:
    """Write `__init__`, which assigns each field by a line such as `self.{name} = {value}`."""
    names: dict[str, Any] = {"__set_field__": object.__setattr__, "__missing__": _FACTORY}  # unlike fields
    own, lines = fields(cls), []
    for field in own:
        names[f"__default_{field.name}__"], names[f"__factory_{field.name}__"] = field.default, field.default_factory
        value = _value_of(field)
        if value:
            lines.append(assignment.format(name=field.name, value=value))
    if hasattr(cls, "__post_init__"):
        lines.append("self.__post_init__()")
    positional = [_argument_of(field) for field in own if field.init and not field.kw_only]
    keywords = [_argument_of(field) for field in own if field.init and field.kw_only]
    arguments = ", ".join(["self", *positional, *(["*", *keywords] if keywords else [])])
    method = _compile(f"def method({arguments}):", lines or ["pass"], names)
    method.__annotations__ = {field.name: field.type for field in own if field.init} | {"return": None}
    return method


def _argument_of(field: Field[Any]) -> str:
    if field.default is not MISSING:
        return f"{field.name}=__default_{field.name}__"
    return field.name if field.default_factory is MISSING else f"{field.name}=__missing__"


def _value_of(field: Field[Any]) -> str:
    """Return the value that is assigned to a field; empty if there is none, since the class has the default."""
    if field.default_factory is MISSING:
        return field.name if field.init else ""
    default = f"__factory_{field.name}__()"
    return f"{default} if {field.name} is __missing__ else {field.name}" if field.init else default


def _write_repr(cls: type) -> Callable[..., Any]:
    from reprlib import recursive_repr

    shown = ", ".join(f"{field.name}={{self.{field.name}!r}}" for field in fields(cls) if field.repr)
    method = _compile("def method(self):", [f'return self.__class__.__qualname__ + f"({shown})"'], {})
    return recursive_repr()(method)


def _write_eq(cls: type) -> Callable[..., Any]:
    compared = [field for field in fields(cls) if field.compare]
    own, others = _tuple_of("self", compared), _tuple_of("other", compared)
    lines = ["if other.__class__ is not self.__class__:", "    return NotImplemented", f"return {own} == {others}"]
    return _compile("def method(self, other):", lines, {})


def _write_hash(cls: type) -> Callable[..., Any]:
    hashed = [field for field in fields(cls) if (field.compare if field.hash is None else field.hash)]
    return _compile("def method(self):", [f"return hash({_tuple_of('self', hashed)})"], {})


def _tuple_of(instance: str, members: list[Field[Any]]) -> str:
    return f"({''.join(f'{instance}.{field.name}, ' for field in members)})"


def _compile(head: str, lines: list[str], names: dict[str, Any]) -> Callable[..., Any]:
    exec("\n    ".join([head, *lines]), names)
    method: Callable[..., Any] = names["method"]
    return method


def _refuse_assignment(self: object, name: str, value: object) -> None:
    raise FrozenInstanceError(f"cannot assign to field {name!r}")


def _refuse_deletion(self: object, name: str) -> None:
    raise FrozenInstanceError(f"cannot delete field {name!r}")

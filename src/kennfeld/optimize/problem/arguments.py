"""The kinds of the arguments of `calibrate`: a wrong one is a sentence, and not an error from somewhere inside."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol, TypedDict

import numpy as np

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.constraints import Equality, Limit, Pin, Shape
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter, Scalar
from kennfeld.domain.storage import RoundingMethod
from kennfeld.models import Model
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Factor
from kennfeld.preprocessing.coercion import Data


class Fitted(Protocol):
    """An object with fitted parameters, such as a result."""

    @property
    def parameters(self) -> ParameterSet: ...


Start = ParameterSet | Mapping[str, float | Parameter] | Parameter | Iterable[Parameter] | Fitted | str | Path
Bounds = tuple[float | None, float | None]
Limits = Mapping[str, Bounds] | Sequence[Limit]
Shift = Mapping[str, float | Literal["auto"]] | Mapping[str, Mapping[str, float]]
Factors = Factor | Mapping[str, Factor | Sequence[Factor] | Mapping[str, float]]


class ProblemArguments(TypedDict, total=False):
    """The arguments of `calibrate` by which a problem is stated beside model, data, start and target."""

    node: str | None
    criteria: Sequence[Criterion]
    test: Data | Sequence[Data]
    free: Sequence[str]
    free_axes: Sequence[str]
    smoothness: Factors
    bounds: Mapping[str, Bounds] | None
    limits: Limits | None
    pins: Sequence[Pin]
    constraints: Sequence[Shape | Equality]
    channels: Mapping[str, str] | None
    shift: Shift | None
    rounding: RoundingMethod | None
    storage: str | Path | None
    step: Mapping[str, float] | None
    max_shift: float


def check_kinds(arguments: Mapping[str, Any]) -> None:
    """Raise `ArgumentError` for the first argument of `calibrate` of a wrong kind."""
    for name, (is_right, expected) in _KINDS.items():
        value = arguments.get(name)
        if value is not None and not is_right(value):
            raise ArgumentError(f"{name} must be {expected}, got {_described(value)}")
    model = arguments.get("model")
    if not isinstance(model, Model | str):
        remedy = "kennfeld.formula, simulink, esdl, fmu, onnx and function return models"
        raise ArgumentError(f"model must be a model or formula text, got {_described(model)}; {remedy}")


def _described(value: Any) -> str:
    """Return a short text of a value with its type."""
    text = repr(value)
    return f"{text} of type {type(value).__name__}" if len(text) <= 60 else f"a {type(value).__name__}"


def _list_of(*kinds: type) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, Sequence) and not isinstance(value, str) and _all_of(value, *kinds)


def _all_of(values: Iterable[Any], *kinds: type) -> bool:
    return all(isinstance(value, kinds) for value in values)


def _is_named(*kinds: type) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, Mapping) and _all_of(value, str) and _all_of(value.values(), *kinds)


def _are_limits(value: Any) -> bool:
    return _are_pairs(value) if isinstance(value, Mapping) else _list_of(Limit)(value)


def _are_pairs(value: Any) -> bool:
    if not isinstance(value, Mapping):
        return False
    return _all_of(value, str) and all(isinstance(pair, Sequence) and len(pair) == 2 for pair in value.values())


def check_options(options: Any, progress: Any) -> None:
    """Raise `ArgumentError` if the options of a search, or the function that it reports to, are of a wrong kind."""
    if options is not None and not isinstance(options, Options):
        raise ArgumentError(f"options must be Options(...), got {_described(options)}")
    if progress is not None and not callable(progress):
        raise ArgumentError(f"progress must be a function of one argument, got {_described(progress)}")


_KINDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "target": (lambda value: isinstance(value, str | float | int | np.number), "the name of a channel, or a number"),
    "node": (lambda value: isinstance(value, str), "the name of an output"),
    "criteria": (_list_of(Criterion), "a list of Criterion"),
    "free": (_list_of(str), "a list of patterns"),
    "free_axes": (_list_of(str), "a list of patterns"),
    "bounds": (_are_pairs, "a dict of (lower, upper) by parameter"),
    "limits": (_are_limits, "a dict of (lower, upper) by name, or a list of Limit"),
    "pins": (_list_of(Pin), "a list of Pin"),
    "constraints": (_list_of(Shape, Equality), "a list of Shape and Equality"),
    "channels": (_is_named(str), "a dict of channels by the name of an input"),
    "shift": (lambda value: isinstance(value, Mapping), "a dict of shifts by channel"),
    "storage": (lambda value: isinstance(value, str | Path), "an A2L file"),
    "step": (_is_named(float, int, np.number), "a dict of steps by parameter"),
    "max_shift": (lambda value: isinstance(value, float | int | np.number), "a number of steps"),
}


def parameters_of(start: Start) -> ParameterSet:
    """Return the parameters of a start: a set, a result, a parameter or several, numbers by name, or a file.

    Raises:
        ArgumentError: it is something else, or a parameter has another name than the key of a dict.
        InputError: the file cannot be read.

    >>> parameters_of({"a": 1.0})["a"].value
    1.0
    """
    if isinstance(start, ParameterSet):
        return start
    if isinstance(start, Mapping):
        return ParameterSet(_parameter(name, value) for name, value in start.items())
    if isinstance(start, str | Path):
        from kennfeld.calfiles import read

        return read(start)
    if isinstance(start, Parameter):
        return ParameterSet([start])
    if isinstance(fitted := getattr(start, "parameters", None), ParameterSet):  # a result
        return fitted
    members: list[Any] = list(start) if isinstance(start, Iterable) else [start]
    if not _all_of(members, Parameter):
        expected = "a parameter set, a result, a list of parameters, a dict of numbers or a calibration file"
        raise ArgumentError(f"start must be {expected}, got {_described(start)}")
    return ParameterSet(members)


def _parameter(name: Any, value: Any) -> Parameter:
    if not isinstance(name, str):
        raise ArgumentError(f"start: {name!r} must be the name of a parameter, a text")
    if not isinstance(value, Parameter):
        if np.ndim(value):
            raise ArgumentError(f'start: {name} must be a number; a table is kf.Curve("{name}", breakpoints, values)')
        return Scalar(name, value)
    if value.name != name:
        raise ArgumentError(f"start: the parameter under {name!r} is called {value.name}; use its name")
    return value


def factors_by_axis(value: Mapping[str, Any], name: str, axes: int) -> tuple[Any, ...]:
    """Return the smoothness of each axis from factors by axis, as `Result.smoothness` has them; 0 for others.

    >>> factors_by_axis({"y": 2.0}, "Map", 2)
    (0.0, 2.0)
    """
    letters = AXIS_LETTERS[:axes]
    if unknown := [letter for letter in value if letter not in letters]:
        raise ArgumentError(f"smoothness of {name}: it has no axis {unknown[0]!r}, but {', '.join(letters)}")
    return tuple(value.get(letter, 0.0) for letter in letters)


def shift_of(shift: Shift, dataset: str, names: Iterable[str]) -> Mapping[str, Any]:
    """Return the shifts of a dataset by channel; those of all, or by dataset, as `Result.shifts` has them."""
    nested = [isinstance(value, Mapping) for value in shift.values()]
    if not any(nested):
        return shift
    if not all(nested):
        raise ArgumentError("shift must hold numbers by channel, or dicts of these by dataset, but not both")
    if unknown := [name for name in shift if name not in names]:
        raise ArgumentError(f"shift: there is no dataset {unknown[0]}, but {', '.join(names)}")
    own: Any = shift.get(dataset, {})
    return own  # type: ignore[no-any-return]

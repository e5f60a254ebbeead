"""Data-driven models as functions of formula text: `n = engine(throttle, load)`."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from kennfeld.models.formula.functions import Argument, Function, Later, Loom
from kennfeld.surrogate import DynamicSurrogate, Surrogate

__all__ = ["functions_of"]


def functions_of(surrogates: Iterable[Surrogate]) -> Mapping[str, Function]:
    """The functions that call these surrogates, by name.

    A dynamic one has the arguments of its inputs and `init`, its output before the first sample. An input at which it
    looks only back in time may depend on its output of now: that is how a loop is closed.
    """
    return {s.name: _dynamic(s) if isinstance(s, DynamicSurrogate) else _static(s) for s in surrogates}


def _static(surrogate: Surrogate) -> Function:
    def rule(loom: Loom, *inputs: int) -> int:
        return loom.lookup(surrogate.name, *inputs)

    return _function(surrogate.name, [Argument(name, "", False) for name in surrogate.inputs], rule, memory=False)


def _dynamic(surrogate: DynamicSurrogate) -> Function:
    arguments = [Argument(name, "", 0 not in lags) for name, lags in zip(surrogate.inputs, surrogate.lags, strict=True)]
    arguments.append(Argument("init", repr(surrogate.start), False))
    return _function(surrogate.name, arguments, partial(_recursion, surrogate), memory=True)


def _function(name: str, arguments: list[Argument], rule: Callable[..., int], *, memory: bool) -> Function:
    shown = [argument.name + f"={argument.default}" * bool(argument.default) for argument in arguments]
    return Function(name, f"{name}({', '.join(shown)})", tuple(arguments), rule, memory)


def _recursion(surrogate: DynamicSurrogate, loom: Loom, *given: Any) -> int:
    *inputs, init = given
    made: list[int] = []
    point = [loom.remember(init, lambda read: made[0], lag) for lag in surrogate.output_lags]
    for x, lags, start in zip(inputs, surrogate.lags, surrogate.start_inputs, strict=True):
        point += [_at_lag(loom, x, lag, start) for lag in lags]
    y = loom.lookup(surrogate.name, *point)
    lower, upper = (loom.const(limit) for limit in surrogate.limits)
    made.append(loom.call("min", loom.call("max", y, lower), upper) if _limited(surrogate) else y)
    return made[0]


def _limited(surrogate: DynamicSurrogate) -> bool:
    return surrogate.limits != (-float("inf"), float("inf"))


def _at_lag(loom: Loom, x: int | Later, lag: int, start: float) -> int:
    if callable(x):
        return loom.remember_input(x, start, lag)
    return loom.prev(x, x, lag) if lag else x

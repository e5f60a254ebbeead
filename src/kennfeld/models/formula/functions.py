"""Built-in functions of formula text: signatures, and the rules that write their graphs.

A function with memory creates states by `GraphBuilder.remember`: the value read now, and a function that returns the
node of the next value. Arguments that only the next value needs are passed as callables, evaluated when all nodes
exist; this permits feedback.

Surrogates and functions from files are functions of formula text as well: `n = engine(throttle, load)`.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from kennfeld.graph.builder import GraphBuilder

if TYPE_CHECKING:
    from kennfeld.models.model_function import ModelFunction
    from kennfeld.surrogate.filtered_surrogate import FilteredSurrogate
    from kennfeld.surrogate.surrogate_file import Surrogate
    from kennfeld.surrogate.surrogate_models import DynamicSurrogate, StaticSurrogate

CONSTANTS: Final = {"pi": math.pi, "inf": math.inf, "nan": math.nan}

# infix operators and what they are in a graph
OPERATORS: Final = {
    "or": "or", "and": "and", "==": "eq", "!=": "ne", "<": "lt", "<=": "le", ">": "gt", ">=": "ge",
    "+": "add", "-": "sub", "*": "mul", "/": "div", "^": "pow",
}  # fmt: skip

ITSELF: Final = "itself"  # default of an argument that stands for the value of the call; a rule receives None

Deferred = Callable[[], int]

_UNARY = "abs sqrt exp log log10 sin cos tan asin acos atan sinh cosh tanh erf erfc floor ceil round sign single"


class InvalidArgumentError(Exception):
    """The value of a named argument cannot be used."""

    def __init__(self, argument: str, message: str) -> None:
        super().__init__(message)
        self.argument, self.message = argument, message


class FunctionArgument(NamedTuple):
    """An argument; `default` is a number, the name of another argument, or `ITSELF`; "" if it is required."""

    name: str
    default: str
    later: bool


class BuiltinFunction(NamedTuple):
    """A built-in function; `rule(builder, *arguments)` writes its graph.

    `ordered` names two arguments of which the first must not exceed the second.
    """

    name: str
    signature: str
    arguments: tuple[FunctionArgument, ...]
    rule: Callable[..., int]
    memory: bool
    ordered: tuple[str, ...] = ()

    @property
    def fewest(self) -> int:
        """Minimum number of arguments."""
        return sum(not argument.default for argument in self.arguments)

    @property
    def most(self) -> float:
        """Maximum number of arguments."""
        return math.inf if "..." in self.signature else len(self.arguments)

    def position(self, name: str) -> int:
        """Return the position of an argument."""
        return [argument.name for argument in self.arguments].index(name)

    def argument(self, index: int) -> FunctionArgument:
        """Return the argument at a position of a call."""
        # further arguments of min and max are like the last one
        return self.arguments[min(index, len(self.arguments) - 1)]


def _function(
    signature: str, rule: Callable[..., int], memory: bool = False, later: str = "", ordered: str = ""
) -> BuiltinFunction:
    name, _, inside = signature.removesuffix(")").partition("(")
    arguments = []
    for part in inside.removesuffix(", ...").split(", "):
        argument, _, default = part.partition("=")
        arguments.append(FunctionArgument(argument, default, argument in later.split()))
    return BuiltinFunction(name, signature, tuple(arguments), rule, memory, tuple(ordered.split()))


def _operation(builder: GraphBuilder, *args: int, op: str) -> int:
    return builder.call(op, *args)


def _fold(builder: GraphBuilder, first: int, *others: int, op: str) -> int:
    for other in others:
        first = builder.call(op, first, other)
    return first


def _bswitch(builder: GraphBuilder, x: int, a: int, b: int) -> int:
    return builder.call("select", builder.call("le", x, builder.const(0.0)), a, b)


def _clip(builder: GraphBuilder, x: int, lower: int, upper: int) -> int:
    return builder.call("min", builder.call("max", x, lower), upper)


def _prev(builder: GraphBuilder, x: Deferred, init: int) -> int:
    return builder.remember(init, lambda read: x())


def _delay(builder: GraphBuilder, x: Deferred, n: int, init: int) -> int:
    # the length of the memory is fixed when the graph is built
    steps = builder.value(n)
    if steps is None or not steps >= 1 or not steps.is_integer():
        value = "an expression that is not constant" if steps is None else f"{steps:g}"
        raise InvalidArgumentError("n", f"the number of steps of a delay must be a constant integer >= 1, got {value}")
    return builder.remember(init, lambda read: x(), int(steps))


def _integrator(
    builder: GraphBuilder, x: Deferred, init: int, lower: Deferred, upper: Deferred, start: Deferred | None
) -> int:
    def then(read: int) -> int:
        # y(k+1) = min(max(y(k) + (t(k+1) - t(k)) x(k), lower), upper), where `start` may take the place of y(k)
        begun = read if start is None else start()
        moved = builder.call("add", begun, builder.call("mul", builder.next_step(), x()))
        return builder.within(moved, lower(), upper())

    return builder.remember_within(init, then, lambda: (lower(), upper()))


def _continuous_integrator(
    builder: GraphBuilder, x: Deferred, init: int, lower: Deferred, upper: Deferred, start: Deferred | None
) -> int:
    def then(read: int) -> int:
        # `graph.integration` replaces it by the stages of the declared solver
        return builder.node("advance", (read if start is None else start(), x(), lower(), upper()))

    return builder.remember_within(init, then, lambda: (lower(), upper()))


def _held(builder: GraphBuilder, x: int) -> int:
    return x if builder.value(x) is not None else builder.node("hold", (x,))


def _derivative(builder: GraphBuilder, x: int) -> int:
    # y(k) = (x(k) - x(k-1)) / dt; x(-1) = x(0), so that it begins at 0
    change = builder.call("sub", x, builder.remember(x, lambda read: x))
    return builder.call("div", change, builder.step())


def _pt1(
    builder: GraphBuilder, x: int, T: int, init: int, share: Callable[[GraphBuilder, int], int] | None = None
) -> int:
    before = builder.state()
    # y(k) = y(k-1) + gain (x(k) - y(k-1)), y(-1) = init
    gain = _valid_share(builder, T, (share or _implicit_share)(builder, T))
    moved = builder.call("mul", gain, builder.call("sub", x, before))
    y = builder.call("add", before, moved)
    builder.close(before, init, y)
    return y


def _implicit_share(builder: GraphBuilder, T: int) -> int:
    """Return dt/(T + dt), the gain of one implicit Euler step of a PT1."""
    dt = builder.step()
    return builder.call("div", dt, builder.call("add", T, dt))


def _exact_share(builder: GraphBuilder, T: int) -> int:
    """Return 1 - exp(-dt/T), the gain of a PT1 whose input is constant within the step.

    It is 2 h / (1 + h) with h = tanh(z/2) and z = dt/T, in which nothing cancels for short steps. Below T = dt/1000 it
    is 1 in double precision, so that T may be 0 and its derivative there is 0.
    """
    dt = builder.step()
    least = builder.call("mul", builder.const(1e-3), dt)
    halves = builder.call("div", builder.call("mul", builder.const(0.5), dt), builder.call("max", T, least))
    h = builder.call("tanh", halves)
    double = builder.call("mul", builder.const(2.0), h)
    return builder.call("div", double, builder.call("add", builder.const(1.0), h))


def _valid_share(builder: GraphBuilder, T: int, share: int) -> int:
    """Return the gain of a PT1; NaN for T < 0."""
    invalid, constant = builder.const(math.nan), builder.value(T)
    # a constant T is checked once, not at every sample
    if constant is None:
        return builder.call("select", builder.call("lt", T, builder.const(0.0)), invalid, share)
    return invalid if constant < 0 else share


def _lowpass(builder: GraphBuilder, x: int, f: int) -> int:
    T = builder.call("div", builder.const(1.0), builder.call("mul", builder.const(2 * math.pi), f))
    return _pt1(builder, x, T, x)


def _ratelimit(builder: GraphBuilder, x: int, up: int, down: int) -> int:
    before, dt = builder.state(), builder.step()
    # y(k) = y(k-1) + clip(x(k) - y(k-1), down dt, up dt), y(-1) = x(0)
    lowest, highest = builder.call("mul", down, dt), builder.call("mul", up, dt)
    y = builder.call("add", before, _clip(builder, builder.call("sub", x, before), lowest, highest))
    builder.close(before, x, y)
    return y


def _hysteresis(builder: GraphBuilder, x: int, on: int, off: int) -> int:
    before, zero = builder.state(), builder.const(0.0)
    # 1 from `on` upwards, 0 from `off` downwards, between them the value before; 0 at first
    kept = builder.call("select", builder.call("le", x, off), zero, before)
    y = builder.call("select", builder.call("ge", x, on), builder.const(1.0), kept)
    builder.close(before, zero, y)
    return y


_TABLE = (
    *(_function(f"{op}(x)", partial(_operation, op=op)) for op in _UNARY.split()),
    _function("atan2(y, x)", partial(_operation, op="atan2")),
    _function("mod(a, b)", partial(_operation, op="mod")),
    _function("min(a, b, ...)", partial(_fold, op="min")),
    _function("max(a, b, ...)", partial(_fold, op="max")),
    _function("if(condition, a, b)", partial(_operation, op="select")),
    _function("bswitch(x, a, b)", _bswitch),
    _function("clip(x, lower, upper)", _clip, ordered="lower upper"),
    _function("prev(x, init=0)", _prev, memory=True, later="x"),
    _function("delay(x, n, init=0)", _delay, memory=True, later="x"),
    _function(
        "integrator(x, init=0, lower=-inf, upper=inf, start=itself)",
        _integrator,
        memory=True,
        later="x lower upper start",
        ordered="lower upper",
    ),
    _function("sampled(x)", lambda builder, x: x),
    _function("derivative(x)", _derivative, memory=True),
    _function("PT1(x, T, init=x)", _pt1, memory=True),
    _function("PT1exact(x, T, init=x)", partial(_pt1, share=_exact_share), memory=True),
    _function("lowpass(x, f)", _lowpass, memory=True),
    _function("ratelimit(x, up, down)", _ratelimit, memory=True, ordered="down up"),
    _function("hysteresis(x, on, off)", _hysteresis, memory=True, ordered="off on"),
)

FUNCTIONS: Final = {function.name: function for function in _TABLE}
FUNCTIONS["timeDelay"] = FUNCTIONS["prev"]


def _with_solver() -> Iterator[tuple[str, BuiltinFunction]]:
    for name, function in FUNCTIONS.items():
        if name == "integrator":
            yield name, function._replace(rule=_continuous_integrator)
        elif name == "sampled":
            yield name, function._replace(rule=_held)


# the rules of these functions in a text that declares a solver
CONTINUOUS_FUNCTIONS: Final = dict(_with_solver())


def functions_of(surrogates: Iterable["Surrogate"]) -> Mapping[str, BuiltinFunction]:
    """Return the functions that call these surrogates, by name.

    A dynamic surrogate takes its inputs and `init`, its output before the first sample. An input that is used only with
    a lag may depend on the current output, which permits closed loops.
    """
    return {surrogate.name: _function_of(surrogate) for surrogate in surrogates}


def functions_of_files(functions: Iterable["ModelFunction"]) -> Mapping[str, BuiltinFunction]:
    """Return the functions that call the outputs of functions from files, by name."""
    return {
        call: _output_of(function, call, number) for function in functions for call, number in function.calls.items()
    }


def _output_of(function: "ModelFunction", call: str, number: int) -> BuiltinFunction:
    arguments = [
        FunctionArgument(x.name, "" if x.default is None else repr(x.default), x.later) for x in function.inputs
    ]

    def rule(builder: GraphBuilder, *inputs: int | Deferred) -> int:
        return function.write(builder, inputs)[number]

    return _called(call, arguments, rule, memory=function.memory)


def _function_of(surrogate: "Surrogate") -> BuiltinFunction:
    from kennfeld.surrogate.filtered_surrogate import FilteredSurrogate
    from kennfeld.surrogate.surrogate_models import DynamicSurrogate

    if isinstance(surrogate, FilteredSurrogate):
        return _filtered(surrogate)
    return _dynamic(surrogate) if isinstance(surrogate, DynamicSurrogate) else _static(surrogate)


def _static(surrogate: "StaticSurrogate") -> BuiltinFunction:
    arguments = [FunctionArgument(name, "", False) for name in surrogate.inputs]
    return _called(surrogate.name, arguments, partial(_look_up, surrogate.name), memory=False)


def _look_up(name: str, builder: GraphBuilder, *inputs: int) -> int:
    return builder.lookup(name, *inputs)


def _dynamic(surrogate: "DynamicSurrogate") -> BuiltinFunction:
    arguments = [
        FunctionArgument(name, "", 0 not in lags) for name, lags in zip(surrogate.inputs, surrogate.lags, strict=True)
    ]
    arguments.append(FunctionArgument("init", repr(surrogate.start), False))
    return _called(surrogate.name, arguments, partial(_recursion, surrogate), memory=True)


def _called(name: str, arguments: list[FunctionArgument], rule: Callable[..., int], *, memory: bool) -> BuiltinFunction:
    shown = [argument.name + f"={argument.default}" * bool(argument.default) for argument in arguments]
    return BuiltinFunction(name, f"{name}({', '.join(shown)})", tuple(arguments), rule, memory)


def _recursion(surrogate: "DynamicSurrogate", builder: GraphBuilder, *arguments: Any) -> int:
    # y(k) = f(y(k - l), u(k - l)) in the order of the trained coordinates: the output by its lags, then each input by
    # its own
    *inputs, init = arguments
    result: list[int] = []
    point = [builder.remember(init, lambda read: result[0], lag) for lag in surrogate.output_lags]
    for x, lags, start in zip(inputs, surrogate.lags, surrogate.start_inputs, strict=True):
        point += [_at_lag(builder, x, lag, start) for lag in lags]
    result.append(_limited(builder, builder.lookup(surrogate.name, *point), surrogate.limits))
    return result[0]


def _limited(builder: GraphBuilder, y: int, limits: tuple[float, float]) -> int:
    return y if limits == (-math.inf, math.inf) else _clip(builder, y, *map(builder.const, limits))


def _filtered(surrogate: "FilteredSurrogate") -> BuiltinFunction:
    arguments = [FunctionArgument(name, "", surrogate.delay > 0) for name in surrogate.inputs]
    return _called(surrogate.name, arguments, partial(_filter_inputs, surrogate), memory=True)


def _filter_inputs(surrogate: "FilteredSurrogate", builder: GraphBuilder, *inputs: Any) -> int:
    from kennfeld.surrogate.input_filters import filter_share

    starts = surrogate.start_inputs
    # coordinates in the trained order: all inputs, then all of them filtered with each time constant
    direct = [_at_lag(builder, x, surrogate.delay, start) for x, start in zip(inputs, starts, strict=True)]
    shares = [filter_share(surrogate.step, T) for T in surrogate.time_constants]
    point = [*direct, *(_low_passed(builder, x, share) for share in shares for x in direct)]
    return _limited(builder, builder.lookup(surrogate.name, *point), surrogate.limits)


def _low_passed(builder: GraphBuilder, x: int, share: float) -> int:
    before = builder.state()
    # y(k) = y(k-1) + share (x(k) - y(k-1)), settled at first: y(-1) = x(0)
    y = builder.call("add", before, builder.call("mul", builder.const(share), builder.call("sub", x, before)))
    builder.close(before, x, y)
    return y


def _at_lag(builder: GraphBuilder, x: int | Deferred, lag: int, start: float) -> int:
    # an input without lag 0, whose node may depend on the output
    if callable(x):
        return builder.remember_input(x, start, lag)
    return builder.prev(x, x, lag) if lag else x

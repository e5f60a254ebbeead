"""The built-in functions of formula text, as data: a signature, and the graph that a call becomes.

A function with memory writes its graph through `Loom.remember`: what is read now, and what the next step will find.
Arguments that are only needed for the next step come as a callable, asked when all nodes exist; this is
how feedback is written.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple

from kennfeld.graph import Builder

__all__ = ["CONSTANTS", "FUNCTIONS", "OPERATORS", "Argument", "Function", "Loom", "UnusableError"]

CONSTANTS: Final = {"pi": math.pi, "inf": math.inf, "nan": math.nan}

# infix operators and what they are in a graph
OPERATORS: Final = {
    "or": "or",
    "and": "and",
    "==": "eq",
    "!=": "ne",
    "<": "lt",
    "<=": "le",
    ">": "gt",
    ">=": "ge",
    "+": "add",
    "-": "sub",
    "*": "mul",
    "/": "div",
    "^": "pow",
}

Later = Callable[[], int]


class UnusableError(Exception):
    """A rule cannot use the argument of this name."""

    def __init__(self, argument: str, what: str) -> None:
        super().__init__(what)
        self.argument, self.what = argument, what


class Loom(Builder):
    """A graph builder whose memories may say later what they hold."""

    def __init__(self) -> None:
        super().__init__()
        self._open: list[tuple[int, Callable[[int], tuple[int, int]]]] = []

    def remember(self, init: int, then: Callable[[int], int], latency: int = 1) -> int:
        """A new memory as read now; `then` maps it to what it holds next, and is asked in `settle`."""
        return self._opened(lambda read: (init, then(read)), latency)

    def remember_input(self, x: Callable[[], int], otherwise: float, latency: int) -> int:
        """A memory of x that starts with the first x, or `otherwise` where the first x needs this memory."""

        def held(read: int) -> tuple[int, int]:
            node = x()
            return (self.const(otherwise) if self._needs(node, read) else node), node

        return self._opened(held, latency)

    def _opened(self, held: Callable[[int], tuple[int, int]], latency: int) -> int:
        read = self.state(latency)
        self._open.append((read, held))
        return read

    def _needs(self, node: int, other: int) -> bool:
        """Whether a node is computed from another one within the step."""
        seen, stack = {node}, [node]
        while stack:
            args = [a for a in self.nodes[stack.pop()].args if a not in seen]
            seen.update(args)
            stack += args
        return other in seen

    def settle(self) -> None:
        """Complete all memories; completing one may open further ones."""
        while self._open:
            read, held = self._open.pop()
            self.close(read, *held(read))

    def value(self, node: int) -> float | None:
        """The value of a constant node."""
        return float(self.nodes[node].payload) if self.nodes[node].op == "const" else None


class Argument(NamedTuple):
    """An argument; `default` is a number or the name of another argument, "" where it must be given."""

    name: str
    default: str
    later: bool


class Function(NamedTuple):
    """A built-in function; `rule(loom, *arguments)` writes its graph."""

    name: str
    signature: str
    arguments: tuple[Argument, ...]
    rule: Callable[..., int]
    memory: bool

    @property
    def fewest(self) -> int:
        """How many arguments a call needs."""
        return sum(not argument.default for argument in self.arguments)

    @property
    def most(self) -> float:
        """How many arguments a call may have."""
        return math.inf if "..." in self.signature else len(self.arguments)

    def argument(self, index: int) -> Argument:
        """The argument at a position of a call."""
        return self.arguments[min(index, len(self.arguments) - 1)]


def _function(signature: str, rule: Callable[..., int], memory: bool = False, later: str = "") -> Function:
    name, _, inside = signature.removesuffix(")").partition("(")
    arguments = []
    for part in inside.removesuffix(", ...").split(", "):
        argument, _, default = part.partition("=")
        arguments.append(Argument(argument, default, argument in later.split()))
    return Function(name, signature, tuple(arguments), rule, memory)


def _operation(loom: Loom, *args: int, op: str) -> int:
    return loom.call(op, *args)


def _fold(loom: Loom, first: int, *others: int, op: str) -> int:
    for other in others:
        first = loom.call(op, first, other)
    return first


def _if(loom: Loom, condition: int, a: int, b: int) -> int:
    return loom.call("select", condition, a, b)


def _bswitch(loom: Loom, x: int, a: int, b: int) -> int:
    return loom.call("select", loom.call("le", x, loom.const(0.0)), a, b)


def _clip(loom: Loom, x: int, lower: int, upper: int) -> int:
    return loom.call("min", loom.call("max", x, lower), upper)


def _prev(loom: Loom, x: Later, init: int) -> int:
    return loom.remember(init, lambda read: x())


def _delay(loom: Loom, x: Later, n: int, init: int) -> int:
    steps = loom.value(n)
    if steps is None or not steps >= 1 or not steps.is_integer():
        given = "an expression that changes" if steps is None else f"{steps:g}"
        raise UnusableError("n", f"the steps of a delay must be a constant whole number from 1 on, not {given}")
    return loom.remember(init, lambda read: x(), int(steps))


def _integrator(loom: Loom, x: Later, init: int, lower: Later, upper: Later) -> int:
    def then(read: int) -> int:
        moved = loom.call("add", read, loom.call("mul", loom.input("dt"), x()))
        low, high = lower(), upper()
        if loom.value(low) != -math.inf:
            moved = loom.call("max", moved, low)
        return moved if loom.value(high) == math.inf else loom.call("min", moved, high)

    return loom.remember(init, then)


def _derivative(loom: Loom, x: int) -> int:
    before = loom.remember(x, lambda read: x)
    return loom.call("div", loom.call("sub", x, before), loom.input("dt"))


def _pt1(loom: Loom, x: int, T: int, init: int) -> int:
    before = loom.state()
    moved = loom.call("mul", _pt1_share(loom, T), loom.call("sub", x, before))
    y = loom.call("add", before, moved)
    loom.close(before, init, y)
    return y


def _pt1_share(loom: Loom, T: int) -> int:
    """dt/(T + dt): which part of the way to its input a PT1 goes in one step; NaN for T < 0."""
    dt, invalid = loom.input("dt"), loom.const(math.nan)
    share = loom.call("div", dt, loom.call("add", T, dt))
    constant = loom.value(T)
    if constant is None:
        return loom.call("select", loom.call("lt", T, loom.const(0.0)), invalid, share)
    return invalid if constant < 0 else share


def _lowpass(loom: Loom, x: int, f: int) -> int:
    T = loom.call("div", loom.const(1.0), loom.call("mul", loom.const(2 * math.pi), f))
    return _pt1(loom, x, T, x)


def _ratelimit(loom: Loom, x: int, up: int, down: int) -> int:
    before, dt = loom.state(), loom.input("dt")
    lowest, highest = loom.call("mul", down, dt), loom.call("mul", up, dt)
    y = loom.call("add", before, _clip(loom, loom.call("sub", x, before), lowest, highest))
    loom.close(before, x, y)
    return y


def _hysteresis(loom: Loom, x: int, on: int, off: int) -> int:
    before, zero = loom.state(), loom.const(0.0)
    kept = loom.call("select", loom.call("le", x, off), zero, before)
    y = loom.call("select", loom.call("ge", x, on), loom.const(1.0), kept)
    loom.close(before, zero, y)
    return y


_UNARY = "abs sqrt exp log log10 sin cos tan asin acos atan sinh cosh tanh floor ceil round sign"

_TABLE = (
    *(_function(f"{op}(x)", partial(_operation, op=op)) for op in _UNARY.split()),
    _function("atan2(y, x)", partial(_operation, op="atan2")),
    _function("mod(a, b)", partial(_operation, op="mod")),
    _function("min(a, b, ...)", partial(_fold, op="min")),
    _function("max(a, b, ...)", partial(_fold, op="max")),
    _function("if(condition, a, b)", _if),
    _function("bswitch(x, a, b)", _bswitch),
    _function("clip(x, lower, upper)", _clip),
    _function("prev(x, init=0)", _prev, memory=True, later="x"),
    _function("delay(x, n, init=0)", _delay, memory=True, later="x"),
    _function("integrator(x, init=0, lower=-inf, upper=inf)", _integrator, memory=True, later="x lower upper"),
    _function("derivative(x)", _derivative, memory=True),
    _function("PT1(x, T, init=x)", _pt1, memory=True),
    _function("lowpass(x, f)", _lowpass, memory=True),
    _function("ratelimit(x, up, down)", _ratelimit, memory=True),
    _function("hysteresis(x, on, off)", _hysteresis, memory=True),
)

FUNCTIONS: Final = {function.name: function for function in _TABLE}
FUNCTIONS["timeDelay"] = FUNCTIONS["prev"]

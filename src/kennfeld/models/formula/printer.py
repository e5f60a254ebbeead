"""Graph to formula text that reads back to the same graph.

Graphs in the form that formula text can say: no two memories that always hold the same.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from typing import Final, NamedTuple

from kennfeld.errors import ArgumentError
from kennfeld.graph import CLOCK, Graph, GraphBuilder, State
from kennfeld.models.formula.functions import FUNCTIONS, OPERATORS
from kennfeld.models.formula.lexer import DECLARATIONS, is_plain
from kennfeld.models.formula.parser import LEVELS

__all__ = ["merged", "to_text"]

_INFIX: Final = {op: text for text, op in OPERATORS.items()}
_CALLS: Final = {"select": "if"}
_TABLES: Final = ("scalar", "curve", "map", "cube", "cube")
_NEGATION, _COMPARISON, _POWER, _ATOM = LEVELS["*"] + 1, LEVELS["<"], LEVELS["^"], LEVELS["^"] + 1
# deeper expressions get names for their inner parts; the parser allows 100
_DEEPEST = 40


def merged(graph: Graph) -> Graph:
    """The same graph with memories of equal initial and next nodes made one.

    >>> b = GraphBuilder()
    >>> u, zero = b.input("u"), b.const(0.0)
    >>> twins = [b.state(), b.state()]
    >>> for twin in twins:
    ...     b.close(twin, zero, u)
    >>> len(merged(b.finish({"y": b.call("add", *twins)})).states)
    1
    """
    while len(set(graph.states)) < len(graph.states):  # merging may make further memories equal
        first: dict[State, int] = {}
        kept = [first.setdefault(state, index) for index, state in enumerate(graph.states)]
        graph = _with_states(graph, kept)
    return graph


def _with_states(graph: Graph, kept: Sequence[int]) -> Graph:
    """The graph that reads memory `kept[i]` where it read memory i."""
    builder = GraphBuilder()
    reads = {which: builder.state(graph.states[which].latency) for which in dict.fromkeys(kept)}
    number: list[int] = []
    for op, args, payload in graph.nodes:
        copied = reads[kept[payload]] if op == "state" else builder.node(op, tuple(number[a] for a in args), payload)
        number.append(copied)
    for which, read in reads.items():
        builder.close(read, number[graph.states[which].init], number[graph.states[which].next])
    names = {name: number[at] for name, at in graph.names.items()}
    return builder.finish(names, graph.units, graph.outputs)


def to_text(graph: Graph, step: float | None = None, headings: Mapping[str, str] | None = None) -> str:
    r"""Formula text of a graph, complete by itself: `formula(to_text(graph)).graph == graph`.

    `headings` gives nodes by name the comment above them, written where it changes from one node to the next. Inner
    nodes that are used more than once are called `_1`, `_2`, ... Memories of equal content are printed as one.
    Raises `ArgumentError` for what text cannot say: a name that is two things, a name or unit with a line break or
    a unit with `]`, and the operation `guard`, which occurs only in derivatives.

    >>> from kennfeld.models.formula import formula
    >>> print(to_text(formula("y[Nm] = M(n, 2 * q) - K * prev(n, 0)\nscalar K").graph), end="")
    input n
    input q
    map M
    scalar K
    output y
    y[Nm] = M(n, 2 * q) - K * prev(n, 0)
    """
    _check(graph)
    graph = merged(graph)
    declared = [] if step is None else [f"step {step!r}"]
    return "\n".join([*declared, *_declarations(graph), *_Printer(graph).lines(headings or {}), ""])


def _check(graph: Graph) -> None:
    if any(node.op == "guard" for node in graph.nodes):
        raise ArgumentError("a derivative graph (operation guard) has no formula text")
    kinds = {"node": graph.names, "input": graph.inputs, "parameter": graph.parameters}
    for name, times in Counter(name for names in kinds.values() for name in names).items():
        if times > 1:
            both = " and ".join(f"a {kind}" for kind, names in kinds.items() if name in names)
            raise ArgumentError(
                f"{name!r} is {both}; formula text needs different names".replace("a input", "an input")
            )
        if not name or "\n" in name or "\r" in name:
            raise ArgumentError(f"the name {name!r} is empty or has a line break; formula text has no such names")
    _check_tables(graph)
    for name, unit in graph.units.items():
        if any(sign in unit for sign in "]\n\r"):
            raise ArgumentError(f"the unit {unit!r} of {name} has a bracket or a line break")


def _check_tables(graph: Graph) -> None:
    axes = graph.parameters
    for op, args, name in graph.nodes:
        if op == "lookup" and len(args) != axes[name]:
            raise ArgumentError(f"{name!r} is looked up with {len(args)} and with {axes[name]} coordinates")


def _declarations(graph: Graph) -> Iterator[str]:
    axes = graph.parameters
    for kind, name in (
        *(("input", name) for name in graph.inputs),
        *((_TABLES[number] if number < len(_TABLES) else "rbf", name) for name, number in axes.items()),
        *(("output", name) for name in graph.outputs),
    ):
        unit = "" if kind == "output" else _unit(graph, name)
        yield f"{kind} {_name(name)}{unit}"


def _unit(graph: Graph, name: str) -> str:
    unit = graph.units.get(name, "")
    return f"[{unit}]" if unit else ""


def _name(name: str) -> str:
    """A name as text: quoted where it would be read as something else."""
    plain = is_plain(name) and name not in FUNCTIONS and name not in DECLARATIONS and not name.startswith("_")
    return name if plain else f"%{name.replace('%', '%%')}%"


def _number(value: float) -> str:
    return repr(value).removesuffix(".0")


class _Text(NamedTuple):
    """A piece of an expression; `level` is the precedence of its loosest operator, `depth` its nesting."""

    text: str
    level: int = _ATOM
    depth: int = 0

    def within(self, level: int) -> "_Text":
        """In brackets, unless it binds at least as tightly as `level`."""
        return self if self.level >= level else _Text(f"({self.text})", _ATOM, self.depth + 1)


class _Printer:
    """Writes each node once: in place, or on a line of its own where it has a name."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.output: list[str] = []
        self._named: dict[int, str] = {}
        for name, at in graph.names.items():
            if not self._is_leaf(at):
                self._named.setdefault(at, name)
        uses = Counter(part for at in range(len(graph.nodes)) for part in self._parts(at))
        self._shared = {at for at, times in uses.items() if times > 1 and not self._is_leaf(at)} - self._named.keys()
        taken = {*graph.names, *graph.inputs, *graph.parameters}
        self._free_names = (name for name in map("_{}".format, count(1)) if name not in taken)
        self._auxiliary: dict[int, str] = {}
        self._begun: set[int] = set()
        self._done: dict[int, _Text] = {}

    def lines(self, headings: Mapping[str, str]) -> list[str]:
        """The lines of all nodes; auxiliary ones stand before their first use where a loop permits."""
        above = ""
        for name, at in self.graph.names.items():
            if (heading := " ".join(headings.get(name, "").split())) != above:
                above = heading
                self.output += ["", f"# {heading}"] if heading else [""]
            if self._named.get(at, name) == name:
                self._write(at)
                text = self._done[at].text
            else:
                text = self._read(at).text
            self.output.append(f"{_name(name)}{_unit(self.graph, name)} = {text}")
        return self.output

    def _is_leaf(self, at: int) -> bool:
        op, args, _ = self.graph.nodes[at]
        return not args and op != "state"

    def _parts(self, at: int) -> Sequence[int]:
        op, args, payload = self.graph.nodes[at]
        if op != "state":
            return args
        state = self.graph.states[payload]
        return state.next, state.init

    def _write(self, root: int) -> None:
        """Write the expression of a node, and before it the lines of auxiliary nodes that it uses."""
        stack = [(root, False)]
        while stack:
            at, entered = stack.pop()
            if entered:
                self._finish(at, root)
            elif at not in self._begun:
                self._begun.add(at)
                if at in self._shared:
                    self._auxiliary[at] = next(self._free_names)
                parts = [part for part in self._parts(at) if part not in self._named]
                stack += [(at, True), *((part, False) for part in reversed(parts))]

    def _finish(self, at: int, root: int) -> None:
        text = self._done[at] = self._expression(at)
        if at != root and text.depth > _DEEPEST and at not in self._auxiliary:
            self._auxiliary[at] = next(self._free_names)
        if at in self._auxiliary:
            self.output.append(f"{self._auxiliary[at]} = {text.text}")

    def _read(self, at: int) -> _Text:
        """A node as another expression mentions it."""
        if at in self._named:
            return _Text(_name(self._named[at]))
        return _Text(self._auxiliary[at]) if at in self._auxiliary else self._done[at]

    def _expression(self, at: int) -> _Text:
        op, args, payload = self.graph.nodes[at]
        if op == "const":
            return _Text(_number(payload), _NEGATION if _number(payload).startswith("-") else _ATOM, 1)
        if op == "input":
            return _Text(payload if payload in CLOCK else _name(payload))
        if op == "lookup" and not args:
            return _Text(_name(payload))
        parts = [self._read(part) for part in self._parts(at)]
        if op in _INFIX:
            return _infix(op, *parts)
        if op in ("neg", "not"):
            return _prefix(op, *parts)
        if op == "state":
            return _memory(self.graph.states[payload].latency, *parts)
        return _call(_name(payload) if op == "lookup" else _CALLS.get(op, op), parts)


def _infix(op: str, left: _Text, right: _Text) -> _Text:
    sign = _INFIX[op]
    level = LEVELS[sign]
    # a comparison has none beside it, a power binds to the right, all others bind to the left
    left = left.within(_ATOM if level == _POWER else level + (level == _COMPARISON))
    right = right.within(_ATOM if right.text.startswith("-") else level + (level != _POWER))
    depth = max(left.depth, right.depth + (level == _POWER))
    return _Text(f"{left.text} {sign} {right.text}", level, depth)


def _prefix(op: str, operand: _Text) -> _Text:
    if op == "neg":
        inner = operand.within(_POWER)
        return _Text(f"-{inner.text}", _NEGATION, inner.depth + 1)
    inner = operand.within(_COMPARISON)
    return _Text(f"not {inner.text}", LEVELS["not"], inner.depth + 1)


def _memory(latency: int, content: _Text, init: _Text) -> _Text:
    if latency == 1:
        return _call("prev", [content, init])
    return _call("delay", [content, _Text(str(latency)), init])


def _call(name: str, args: Sequence[_Text]) -> _Text:
    return _Text(f"{name}({', '.join(arg.text for arg in args)})", _ATOM, 1 + max(arg.depth for arg in args))

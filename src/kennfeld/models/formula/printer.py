"""Printing of graphs as formula text that compiles to the same graph.

Formula text cannot express two states with equal contents, so these are merged first.
"""

import math
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from kennfeld.base.errors import ArgumentError
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.graph import CLOCK, Graph, GraphBuilder, State
from kennfeld.graph.integration import Advance, is_continuous
from kennfeld.models.formula.constant_text import constant_text
from kennfeld.models.formula.functions import FUNCTIONS, OPERATORS
from kennfeld.models.formula.lexer import DECLARATIONS, is_plain
from kennfeld.models.formula.line_wrapping import wrap
from kennfeld.models.formula.parser import LEVELS

_INFIX: Final = {op: text for text, op in OPERATORS.items()}
_CALLS: Final = {"select": "if", "hold": "sampled"}
_TABLES: Final = ("scalar", "curve", "map", "cube", "cube")
_NEGATION, _COMPARISON, _POWER, _ATOM = LEVELS["*"] + 1, LEVELS["<"], LEVELS["^"], LEVELS["^"] + 1
# deeper expressions get names for their inner parts; the parser allows 100
_MAX_DEPTH = 40
_MAX_ARGUMENTS: Final = 8  # of min and max, as long chains would be copied at each of their parts
_NOTE_COLUMN: Final = 50  # the last column at which descriptions are aligned


class TextLayout(NamedTuple):
    """The words of a text for readers, which do not change what it computes.

    Attributes:
        headings: comment above a node, by its name; written if it differs from that of the node before.
        descriptions: comment behind the declaration of an input, a parameter or an output, by its name.
        tables: names by which the text calls tables, by the names of their parameters.
        counted: those of the tables that are value blocks whose elements the text counts from 1.
        words: the word by which auxiliary nodes are named that are written for a node, by its name.
        auxiliary: names of auxiliary nodes, by their numbers in the graph.
    """

    headings: Mapping[str, str] = FrozenDict({})
    descriptions: Mapping[str, str] = FrozenDict({})
    tables: Mapping[str, str] = FrozenDict({})
    counted: Collection[str] = ()
    words: Mapping[str, str] = FrozenDict({})
    auxiliary: Mapping[int, str] = FrozenDict({})


def to_text(graph: Graph, step: float | None = None, solver: str = "") -> str:
    r"""Print a graph as complete formula text: `formula(to_text(graph)).graph == graph`.

    Inner nodes that are used more than once are named after the node that they are written for: those of `y` are
    `_y_1`, `_y_2`, ... States of equal contents are merged.

    Args:
        graph: graph with lookups, not lowered; that before the solver if there is one.
        step: step in s to declare.
        solver: solver of continuous states to declare; "" if the graph has none.

    Raises:
        ArgumentError: text cannot express the graph: a name with two meanings, a name or unit with a line break, a unit
            with `]`, or the operation `guard`, which only derivatives contain.

    >>> from kennfeld.models.formula import formula
    >>> print(to_text(formula("y[Nm] = M(n, 2 * q) - K * prev(n, 0)\nscalar K").graph), end="")
    input n
    input q
    map M
    scalar K
    output y
    y[Nm] = M(n, 2 * q) - K * prev(n, 0)
    """
    return "\n".join([*(line.text for line in _lines(merged(graph, solver), step, solver)), ""])


class PrintedLine(NamedTuple):
    """A line of formula text and the name of the node that it belongs to; empty for declarations and comments.

    `defines` is True where the statement of this node begins, False for its auxiliary nodes and further lines.
    """

    text: str
    node: str = ""
    defines: bool = False


def to_lines(
    graph: Graph, step: float | None = None, solver: str = "", layout: TextLayout | None = None
) -> Sequence[PrintedLine]:
    """Return the text of a graph as a person would arrange it: wrapped, with blank lines and the words of a layout.

    The lines of auxiliary nodes, and those that continue a statement, belong to the node that they are written for.
    `layout.auxiliary` has the numbers of nodes of a graph without states of equal contents.
    """
    return _lines(merged(graph, solver), step, solver, layout or TextLayout())


def merged(graph: Graph, solver: str) -> Graph:
    """Return a graph that can be printed without states of equal contents; raises `ArgumentError` if there is none."""
    _check(graph)
    graph = merge_equal_states(graph)
    if is_continuous(graph) and not solver:
        raise ArgumentError("the graph has continuous states and needs a solver")
    return graph


def _lines(graph: Graph, step: float | None, solver: str, layout: TextLayout | None = None) -> Sequence[PrintedLine]:
    settings = [*([] if step is None else [f"step {step!r}"]), *([f"solver {solver}"] if solver else [])]
    groups = [settings, *_declarations(graph, layout)]
    if layout is not None:
        # names of parameters are those of the calibration, whatever the text calls them
        groups.append([_table_call(graph, name, layout) for name in layout.tables])
        groups = [["", *group] for group in groups if group]
    declarations = [PrintedLine(text) for group in groups for text in group]
    return [*declarations, *_Printer(graph, layout).lines()]


def _table_call(graph: Graph, name: str, layout: TextLayout) -> str:
    """Return the definition of the function by which the text calls a table."""
    arguments = ("ijkl" if name in layout.counted else "xyzw")[: graph.parameters[name]]
    coordinates = ", ".join(f"{argument} - 1" if name in layout.counted else argument for argument in arguments)
    note = "  # elements counted from 1" if name in layout.counted else ""
    return f"def {layout.tables[name]}({', '.join(arguments)}) = {spell_name(name)}({coordinates}){note}"


def merge_equal_states(graph: Graph) -> Graph:
    """Merge the states of a graph with equal initial and next nodes.

    >>> b = GraphBuilder()
    >>> u, zero = b.input("u"), b.const(0.0)
    >>> twins = [b.state(), b.state()]
    >>> for twin in twins:
    ...     b.close(twin, zero, u)
    >>> len(merge_equal_states(b.finish({"y": b.call("add", *twins)})).states)
    1
    """
    while len(set(graph.states)) < len(graph.states):  # merging may make further memories equal
        first: dict[State, int] = {}
        kept = [first.setdefault(state, index) for index, state in enumerate(graph.states)]
        graph = _with_states(graph, kept)
    return graph


def _with_states(graph: Graph, kept: Sequence[int]) -> Graph:
    """Return the graph with reads of state i replaced by reads of state `kept[i]`."""
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


def _check(graph: Graph) -> None:
    if any(node.op == "guard" for node in graph.nodes):
        raise ArgumentError("a derivative graph (operation guard) cannot be written as formula text")
    if graph.layers:
        names = ", ".join(sorted(graph.layers))
        raise ArgumentError(f"layers of neural networks cannot be written as formula text: {names}")
    kinds = {"node": graph.names, "input": graph.inputs, "parameter": graph.parameters}
    for name, times in Counter(name for names in kinds.values() for name in names).items():
        if times > 1:
            both = " and ".join(f"a {kind}" for kind, names in kinds.items() if name in names)
            message = f"{name!r} is {both}; formula text requires different names"
            raise ArgumentError(message.replace("a input", "an input"))
        if not name or "\n" in name or "\r" in name:
            raise ArgumentError(f"the name {name!r} is empty or contains a line break")
    axes = graph.parameters
    for op, args, name in graph.nodes:
        if op == "lookup" and len(args) != axes[name]:
            raise ArgumentError(f"{name!r} is looked up with {len(args)} and with {axes[name]} coordinates")
    for name, unit in graph.units.items():
        if any(sign in unit for sign in "]\n\r"):
            raise ArgumentError(f"the unit {unit!r} of {name} contains a bracket or a line break")


def _declarations(graph: Graph, layout: TextLayout | None) -> Iterator[list[str]]:
    """Yield the declarations of inputs, parameters and outputs; with descriptions, if there is a layout."""
    axes = graph.parameters
    kinds = {name: _TABLES[number] if number < len(_TABLES) else "rbf" for name, number in axes.items()}
    for declared in (dict.fromkeys(graph.inputs, "input"), kinds, dict.fromkeys(graph.outputs, "output")):
        texts = {
            name: f"{kind} {spell_name(name)}{'' if kind == 'output' else _unit(graph, name)}"
            for name, kind in declared.items()
        }
        yield list(texts.values()) if layout is None else _described(texts, layout.descriptions)


def _described(texts: Mapping[str, str], descriptions: Mapping[str, str]) -> list[str]:
    """Return declarations with their descriptions in a column of their own."""
    notes = {name: " ".join(descriptions.get(name, "").split()) for name in texts}
    width = max((len(text) for name, text in texts.items() if notes[name] and len(text) <= _NOTE_COLUMN), default=0)
    return [f"{text:{width}}  # {notes[name]}" if notes[name] else text for name, text in texts.items()]


def _unit(graph: Graph, name: str) -> str:
    unit = graph.units.get(name, "")
    return f"[{unit}]" if unit else ""


def spell_name(name: str) -> str:
    """Return a name as text, in quotes if it would have another meaning without."""
    plain = is_plain(name) and name not in FUNCTIONS and name not in DECLARATIONS and not name.startswith("_")
    return name if plain else f"%{name.replace('%', '%%')}%"


def _constant(value: float) -> "_Text":
    text = constant_text(value)
    if " " in text:
        return _Text(text, LEVELS["*"], 1)
    return _Text(text, _NEGATION if text.startswith("-") else _ATOM, 1)


class _Text(NamedTuple):
    """Text of an expression; `level` is the precedence of its outermost operator, `depth` its nesting."""

    text: str
    level: int = _ATOM
    depth: int = 0

    def within(self, level: int) -> "_Text":
        """Add brackets unless the expression binds at least as tightly as `level`."""
        return self if self.level >= level else _Text(f"({self.text})", _ATOM, self.depth + 1)


class _Printer:
    """Printer that writes each node once: inline, or on a line of its own if it has a name."""

    def __init__(self, graph: Graph, layout: TextLayout | None) -> None:
        self.graph = graph
        self.layout = TextLayout() if layout is None else layout
        self.is_wrapped = layout is not None
        self.output: list[PrintedLine] = []
        self._written = ""  # the name of the node that is written
        self._named: dict[int, str] = {}
        for name, at in graph.names.items():
            if not self._is_leaf(at):
                self._named.setdefault(at, name)
        written = (at for at, node in enumerate(graph.nodes) if node.op != "advance")  # part of its state
        uses = Counter(part for at in written for part in self._parts(at))
        self._shared = {at for at, times in uses.items() if times > 1 and not self._is_leaf(at)} - self._named.keys()
        self._taken = {*graph.names, *graph.inputs, *graph.parameters, *self.layout.auxiliary.values()}
        self._numbers = Counter[str]()
        self._auxiliary: dict[int, str] = {}
        self._begun: set[int] = set()
        self._done: dict[int, _Text] = {}

    def lines(self) -> list[PrintedLine]:
        """Return the lines of all nodes; auxiliary nodes precede their first use unless they are part of a loop."""
        above = ""
        if self.is_wrapped and not any(self.layout.headings.values()):
            self.output.append(PrintedLine(""))
        for name, at in self.graph.names.items():
            if (heading := " ".join(self.layout.headings.get(name, "").split())) != above:
                above = heading
                self.output += [PrintedLine(text) for text in (["", f"# {heading}"] if heading else [""])]
            self._written = name
            # a node with two names is written under the first; the second one refers to it
            if self._named.get(at, name) == name:
                self._write(at)
                text = self._done[at].text
            else:
                text = self._read(at).text
            self._add(f"{spell_name(name)}{_unit(self.graph, name)} = {text}", defines=True)
        return self.output

    def _add(self, statement: str, defines: bool = False) -> None:
        """Add a statement that is written for the current node."""
        first, *rest = wrap(statement) if self.is_wrapped else [statement]
        lines = PrintedLine(first, self._written, defines), *(PrintedLine(part, self._written) for part in rest)
        self.output += lines

    def _is_leaf(self, at: int) -> bool:
        op, args, _ = self.graph.nodes[at]
        return not args and op != "state"

    def _parts(self, at: int) -> Sequence[int]:
        op, args, payload = self.graph.nodes[at]
        if op != "state":
            return args
        state = self.graph.states[payload]
        advance = self.graph.nodes[state.next]
        if advance.op != "advance":
            return state.next, state.init
        return self._integrator_arguments(at, state.init, Advance(*advance.args))

    def _integrator_arguments(self, at: int, init: int, advance: Advance) -> Sequence[int]:
        """Return the arguments of an integrator without the last ones that have their defaults."""
        arguments = [advance.slope, init, advance.lower, advance.upper, advance.start]
        defaults = [False, *map(self._is_constant, arguments[1:4], (0.0, -math.inf, math.inf)), advance.start == at]
        count = max(index for index, default in enumerate(defaults) if not default) + 1
        return arguments[:count]

    def _is_constant(self, at: int, value: float) -> bool:
        op, _, payload = self.graph.nodes[at]
        return op == "const" and bool(payload == value)

    def _write(self, root: int) -> None:
        """Write the expression of a node, preceded by the lines of its auxiliary nodes."""
        stack = [(root, False)]
        while stack:
            at, entered = stack.pop()
            if entered:
                self._finish(at, root)
            elif at not in self._begun:
                self._begun.add(at)
                # named before its parts are written, as feedback may lead from them back to it
                if at in self._shared:
                    self._auxiliary[at] = self._free_name(at)
                parts = [part for part in self._parts(at) if part not in self._named]
                stack += [(at, True), *((part, False) for part in reversed(parts))]

    def _finish(self, at: int, root: int) -> None:
        text = self._done[at] = self._expression(at)
        if at != root and text.depth > _MAX_DEPTH and at not in self._auxiliary:
            self._auxiliary[at] = self._free_name(at)
        if at in self._auxiliary:
            self._add(f"{self._auxiliary[at]} = {text.text}")

    def _free_name(self, at: int) -> str:
        """Return a name for an auxiliary node: its own, or one after the node that is written."""
        if at in self.layout.auxiliary:
            return self.layout.auxiliary[at]
        word = re.sub(r"\W+", "_", self.layout.words.get(self._written, self._written)).strip("_")
        while True:
            self._numbers[word] += 1
            name = f"_{word}_{self._numbers[word]}" if word else f"_{self._numbers[word]}"
            if name not in self._taken:
                return name

    def _read(self, at: int) -> _Text:
        """Return a node as it appears in another expression."""
        if at in self._named:
            return _Text(spell_name(self._named[at]))
        return _Text(self._auxiliary[at]) if at in self._auxiliary else self._done[at]

    def _expression(self, at: int) -> _Text:
        op, args, payload = self.graph.nodes[at]
        if op == "const":
            return _constant(payload)
        if op == "input":
            return _Text(payload if payload in CLOCK else spell_name(payload))
        if op == "lookup" and not args:
            return _Text(spell_name(payload))
        if op in ("min", "max"):
            return self._extreme(at)
        parts = [self._read(part) for part in self._parts(at)]
        if op in _INFIX:
            return _infix(op, *parts)
        if op in ("neg", "not"):
            return _prefix(op, *parts)
        if op == "state" and self.graph.nodes[self.graph.states[payload].next].op == "advance":
            return _call("integrator", parts)
        if op == "state":
            latency, (content, init) = self.graph.states[payload].latency, parts
            return _call("prev", parts) if latency == 1 else _call("delay", [content, _Text(str(latency)), init])
        if op == "lookup":
            return self._lookup(payload, args)
        return _call(_CALLS.get(op, op), parts)

    def _lookup(self, name: str, coordinates: Sequence[int]) -> _Text:
        parts = [self._read(at) for at in coordinates]
        if name in self.layout.counted:
            numbers = [self._counted(at) for at in coordinates]
            if None in numbers:
                return _call(spell_name(name), parts)
            parts = [number for number in numbers if number is not None]
        return _call(self.layout.tables.get(name) or spell_name(name), parts)

    def _counted(self, at: int) -> _Text | None:
        """Return the number of an element counted from 1, None if subtracting 1 would not give the node again."""
        op, args, payload = self.graph.nodes[at]
        if op == "const" and payload >= 0 and payload.is_integer():
            return _constant(payload + 1)
        if op == "sub" and self._is_inline(at) and self._is_constant(args[1], 1.0):
            return self._read(args[0])
        return None

    def _extreme(self, at: int) -> _Text:
        """Write the least or greatest of several values as one call, and both limits of a value as `clip`."""
        op, (first, second), _ = self.graph.nodes[at]
        args, inner = [second], first
        while self.graph.nodes[inner].op == op and self._is_inline(inner) and len(args) < _MAX_ARGUMENTS:
            inner, after = self.graph.nodes[inner].args
            args.insert(0, after)
        name, args = op, [inner, *args]
        below = self.graph.nodes[first]
        if op == "min" and below.op == "max" and self._is_inline(first) and self._may_limit(below.args[1], second):
            name, args = "clip", [*below.args, second]
        return _call(name, [self._read(arg) for arg in args])

    def _is_inline(self, at: int) -> bool:
        return at not in self._named and at not in self._auxiliary

    def _may_limit(self, lower: int, upper: int) -> bool:
        """Return False for constant limits in the wrong order, which `clip` refuses."""
        low, high = (self.graph.nodes[limit] for limit in (lower, upper))
        return not (low.op == high.op == "const" and not low.payload <= high.payload)


def _infix(op: str, left: _Text, right: _Text) -> _Text:
    sign = _INFIX[op]
    level = LEVELS[sign]
    # a comparison has none beside it, a power binds to the right, all others bind to the left
    left = left.within(_ATOM if level == _POWER else level + (level == _COMPARISON))
    # a negative right operand is put in brackets: a - (-2), but a == -2
    is_negative = right.text.startswith("-") and level > _COMPARISON
    right = right.within(_ATOM if is_negative else level + (level != _POWER))
    depth = max(left.depth, right.depth + (level == _POWER))
    return _Text(f"{left.text} {sign} {right.text}", level, depth)


def _prefix(op: str, operand: _Text) -> _Text:
    if op == "neg":
        inner = operand.within(_POWER)
        return _Text(f"-{inner.text}", _NEGATION, inner.depth + 1)
    inner = operand.within(_COMPARISON)
    return _Text(f"not {inner.text}", LEVELS["not"], inner.depth + 1)


def _call(name: str, args: Sequence[_Text]) -> _Text:
    return _Text(f"{name}({', '.join(arg.text for arg in args)})", _ATOM, 1 + max(arg.depth for arg in args))

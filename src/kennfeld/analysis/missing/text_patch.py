"""The change of formula text that adds a term at a node; the rest of the text stays as it is, to the byte."""

import difflib
from collections.abc import Collection, Sequence
from itertools import pairwise
from typing import NamedTuple

from kennfeld.analysis.missing.refit import Addition
from kennfeld.analysis.missing.terms import MissingTerm, unused_name
from kennfeld.models.formula.functions import FUNCTIONS
from kennfeld.models.formula.lexer import DECLARATIONS, is_plain, split, statements
from kennfeld.models.formula.syntax import Token

_SUMS, _PRODUCTS = frozenset("+-*/^"), frozenset("*/^")


def with_term(text: str, addition: Addition, inputs: Collection[str] = (), taken: Collection[str] = ()) -> str | None:
    """Return formula text with a term; None if the text does not define the node, or if others share its memory.

    A node such as `y = 0.9 * prev(y) + x` would remember the term, too, which was not fitted so: its equation gets a
    name of its own. If another equation reads the earlier values of y as well, it is ambiguous which are meant.

    Args:
        text: the formula text.
        addition: the term with its parameter.
        inputs: those that the function has already.
        taken: all names of the function.

    >>> from kennfeld.domain.parameters import Curve
    >>> curve = Curve("C", [0, 1], [1, 1])
    >>> print(with_term("a = b - c  # sum", Addition(MissingTerm("a", "multiply", "x"), curve)))
    a = (b - c) * C(x)  # sum
    """
    lines, ending = split(text), "\r\n" if "\r\n" in text else "\n"
    term, every = addition.term, [*statements(lines)]
    equation = next((each for tokens in every if (each := _Equation.of(tokens)) and each.name.name == term.node), None)
    if equation is None:
        return None
    label = "" if addition.parameter is None else addition.parameter.name
    constant = quoted_name(term.time_constant(taken))
    expression = equation.expression
    own = [token for token in expression if _is_name(token, term.node)]
    if not own:
        before, after = _around(term, label, constant, expression, lines)
        _insert(lines, expression, before, after)
        corrected = []
    elif any(_is_remembered(tokens, term.node) for tokens in every if tokens is not equation.tokens):
        return None
    else:
        inner = quoted_name(unused_name(f"{term.node}_inner", {*taken, constant}))
        before, after = _around(term, label, constant, [Token("name", inner, 1, 1)], [inner])
        corrected = [f"{quoted_name(term.node)}{equation.unit} = {before}{inner}{after}"]
        for token in reversed((equation.name, *own)):
            _replace(lines, token, inner)
    lines[equation.tokens[-1].line : equation.tokens[-1].line] = [
        *corrected,
        *([f"{constant}[s] = {label}"] if term.kind == "lag" else []),
        *_declarations(lines, addition, inputs),
    ]
    return ending.join(lines)


class _Equation(NamedTuple):
    """A statement that defines a node."""

    tokens: Sequence[Token]
    name: Token
    unit: str  # in brackets; "" without
    expression: Sequence[Token]

    @classmethod
    def of(cls, tokens: Sequence[Token]) -> "_Equation | None":
        own = tokens[1:] if tokens[0].kind == "number" else tokens
        equals = next((at for at, token in enumerate(own[:3]) if token.text == "="), None)
        if own[0].kind not in ("name", "quoted") or equals is None or len(own) < equals + 3:
            return None
        return cls(tokens, own[0], own[1].text if equals == 2 else "", own[equals + 1 : -1])


def _is_name(token: Token, name: str) -> bool:
    return token.kind in ("name", "quoted") and token.name == name


def _is_remembered(tokens: Sequence[Token], name: str) -> bool:
    """Return if a statement reads earlier values of a node, in a call of a function with memory."""
    calls: list[bool] = []
    for before, token in pairwise(tokens):
        if token.text == "(":
            function = FUNCTIONS.get(before.text) if before.kind == "name" else None
            calls.append(function is not None and function.memory)
        elif token.text == ")" and calls:
            calls.pop()
        elif any(calls) and _is_name(token, name):
            return True
    return False


def quoted_name(name: str) -> str:
    """Return a name as formula text writes it."""
    return name if is_plain(name) else f"%{name.replace('%', '%%')}%"


def _around(
    term: MissingTerm, label: str, constant: str, expression: Sequence[Token], lines: Sequence[str]
) -> tuple[str, str]:
    """Return what stands before and behind the expression."""
    if term.kind == "lag":
        return "PT1(", f", {constant})"
    if term.kind == "delay":
        first, last = expression[0], expression[-1]
        return "delay(", f", {term.steps}, {_source(lines, first, last)})"
    curve = label if term.kind == "offset" else f"{label}({', '.join(map(quoted_name, term.channels))})"
    depth, outer = 0, set()
    for token in expression:
        depth += (token.text == "(") - (token.text == ")")
        if token.kind == "op" and not depth and token.text not in ("(", ")", ","):
            outer.add(token.text)
    allowed, sign = (_PRODUCTS, "*") if term.kind == "multiply" else (_SUMS, "+")
    return ("", f" {sign} {curve}") if outer <= allowed else ("(", f") {sign} {curve}")


def _source(lines: Sequence[str], first: Token, last: Token) -> str:
    """Return the text of an expression on one line, without its comments."""
    if first.line == last.line:
        return lines[first.line - 1][first.column - 1 : last.column - 1 + len(last.text)]
    parts = [token for tokens in statements(lines[first.line - 1 : last.line]) for token in tokens]
    kept = [t for t in parts if (t.line, t.column) >= (1, first.column) and t.kind != "end"]
    return " ".join(token.text for token in kept)


def _insert(lines: list[str], expression: Sequence[Token], before: str, after: str) -> None:
    last, first = expression[-1], expression[0]
    # from the end, so that the columns of the beginning stay valid
    for line, column, text in (
        (last.line, last.column - 1 + len(last.text), after),
        (first.line, first.column - 1, before),
    ):
        content = lines[line - 1]
        lines[line - 1] = content[:column] + text + content[column:]


def _replace(lines: list[str], token: Token, text: str) -> None:
    content, first = lines[token.line - 1], token.column - 1
    lines[token.line - 1] = content[:first] + text + content[first + len(token.text) :]


def _declarations(lines: Sequence[str], addition: Addition, inputs: Collection[str]) -> list[str]:
    """Return declarations of what is new, if the text declares things of their kind."""
    declared = {
        t[0].text for t in statements(lines) if t[0].kind == "name" and t[0].text in DECLARATIONS and len(t) > 2
    }
    term, declarations = addition.term, []
    if addition.parameter is not None and declared & {"scalar", "curve", "map", "cube"}:
        # a value for each recording is a scalar in the text, see `per` of the project file
        kind = "scalar" if term.kind == "offset" else addition.parameter.kind
        declarations.append(f"{kind} {quoted_name(addition.parameter.name)}")
    if "input" in declared:
        declarations += [f"input {quoted_name(name)}" for name in term.channels if name not in inputs]
    return declarations


def difference(before: str, after: str, name: str) -> str:
    """Return the change of a text in the unified format."""
    lines = difflib.unified_diff(split(before), split(after), f"a/{name}", f"b/{name}", lineterm="", n=1)
    return "\n".join(lines)

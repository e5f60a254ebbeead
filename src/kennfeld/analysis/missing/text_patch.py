"""The change of formula text that adds a term at a node; the rest of the text stays as it is, to the byte."""

import difflib
from collections.abc import Collection, Sequence

from kennfeld.analysis.missing.refit import Addition
from kennfeld.analysis.missing.terms import MissingTerm
from kennfeld.models.formula.lexer import DECLARATIONS, is_plain, split, statements
from kennfeld.models.formula.syntax import Token

_SUMS, _PRODUCTS = frozenset("+-*/^"), frozenset("*/^")


def with_term(text: str, addition: Addition, inputs: Collection[str] = (), taken: Collection[str] = ()) -> str | None:
    """Return formula text with a term; None if the text does not define the node, or by its own earlier values.

    A node such as `y = 0.9 * prev(y) + x` would remember the term, too, which was not fitted so.

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
    term = addition.term
    for tokens in statements(lines):
        own = tokens[1:] if tokens[0].kind == "number" else tokens
        if own[0].kind not in ("name", "quoted") or own[0].name != term.node:
            continue
        equals = next((at for at, token in enumerate(own[:3]) if token.text == "="), None)
        if equals is None or len(own) < equals + 3:
            continue
        expression = own[equals + 1 : -1]
        if any(token.kind in ("name", "quoted") and token.name == term.node for token in expression):
            return None
        label = "" if addition.parameter is None else addition.parameter.name
        constant = quoted_name(term.time_constant(taken))
        before, after = _around(term, label, constant, expression, lines)
        _insert(lines, expression, before, after)
        lines[own[-1].line : own[-1].line] = [
            *([f"{constant}[s] = {label}"] if term.kind == "lag" else []),
            *_declarations(lines, addition, inputs),
        ]
        return ending.join(lines)
    return None


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
    curve = f"{label}({quoted_name(term.channel)})"
    depth, outer = 0, set()
    for token in expression:
        depth += (token.text == "(") - (token.text == ")")
        if token.kind == "op" and not depth and token.text not in ("(", ")", ","):
            outer.add(token.text)
    allowed, sign = (_SUMS, "+") if term.kind == "add" else (_PRODUCTS, "*")
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


def _declarations(lines: Sequence[str], addition: Addition, inputs: Collection[str]) -> list[str]:
    """Return declarations of what is new, if the text declares things of their kind."""
    declared = {
        t[0].text for t in statements(lines) if t[0].kind == "name" and t[0].text in DECLARATIONS and len(t) > 2
    }
    term, declarations = addition.term, []
    if addition.parameter is not None and declared & {"scalar", "curve", "map", "cube"}:
        kind = "curve" if addition.parameter.axes else "scalar"
        declarations.append(f"{kind} {quoted_name(addition.parameter.name)}")
    if term.channel and "input" in declared and term.channel not in inputs:
        declarations.append(f"input {quoted_name(term.channel)}")
    return declarations


def difference(before: str, after: str, name: str) -> str:
    """Return the change of a text in the unified format."""
    lines = difflib.unified_diff(split(before), split(after), f"a/{name}", f"b/{name}", lineterm="", n=1)
    return "\n".join(lines)

"""Writes a tree as MATLAB text, which read again gives the same tree."""

from collections.abc import Iterable

from kennfeld.matlab.syntax import (
    AnonymousFunction,
    Assign,
    Binary,
    Branch,
    Call,
    CellArray,
    CellIndex,
    Colon,
    Command,
    Declaration,
    DynamicField,
    End,
    Evaluate,
    Expression,
    Field,
    For,
    FunctionDefinition,
    FunctionHandle,
    If,
    Jump,
    Matrix,
    Name,
    Number,
    Range,
    Script,
    Statement,
    Switch,
    Text,
    Transpose,
    Try,
    Unary,
    While,
)

__all__ = ["format_expression", "printed_script"]

_PLAIN = (Name, Text, Colon, End, Field, DynamicField, Call, CellIndex, Matrix, CellArray)


def format_expression(node: Expression) -> str:
    """The text of an expression, with brackets around what is made of parts.

    >>> format_expression(Binary("+", Name("a"), Binary("*", Number(2.0), Name("b"))))
    'a + (2 * b)'
    """
    match node:
        case Unary():
            return node.operator + _part(node.operand)
        case Binary():
            return f"{_part(node.left)} {node.operator} {_part(node.right)}"
        case Transpose():
            inside = _part(node.operand)
            if isinstance(node.operand, Text):  # a quote right after a text would be one within it
                inside = f"({inside})"
            return inside + ("'" if node.conjugate else ".'")
        case Range():
            parts = [node.first, node.step, node.last]
            return ":".join(_part(part) for part in parts if part is not None)
        case AnonymousFunction():
            return f"@({', '.join(node.parameters)}) {_part(node.body)}"
        case _:
            return _operand(node)


def _operand(node: Expression) -> str:
    match node:
        case Number():
            return _number(node)
        case Text():
            mark = '"' if node.is_string else "'"
            return mark + node.value.replace(mark, 2 * mark) + mark
        case Name():
            return node.name
        case Colon() | End():
            return ":" if isinstance(node, Colon) else "end"
        case Field():
            return f"{_base(node.of)}.{node.name}"
        case DynamicField():
            return f"{_base(node.of)}.({format_expression(node.name)})"
        case Call():
            return f"{_base(node.of)}({_listed(node.arguments)})"
        case CellIndex():
            return f"{_base(node.of)}{{{_listed(node.arguments)}}}"
        case Matrix():
            return f"[{_rows(node.rows)}]"
        case CellArray():
            return f"{{{_rows(node.rows)}}}"
        case FunctionHandle():
            return f"@{node.name}"
        case _:
            raise AssertionError(node)


def _number(node: Number) -> str:
    if node.suffix in ("", "i"):
        text = repr(node.value).removesuffix(".0")
        return ("1e999" if text == "inf" else text) + node.suffix
    return f"0x{int(node.value):X}{node.suffix}"


def _base(node: Expression) -> str:
    """An operand that an index or a field follows."""
    return format_expression(node) if isinstance(node, _PLAIN) else f"({format_expression(node)})"


def _part(node: Expression) -> str:
    plain = isinstance(node, (*_PLAIN, Number))
    return format_expression(node) if plain else f"({format_expression(node)})"


def _listed(nodes: Iterable[Expression]) -> str:
    return ", ".join(format_expression(node) if isinstance(node, Colon) else _part(node) for node in nodes)


def _rows(rows: Iterable[Iterable[Expression]]) -> str:
    return "; ".join(", ".join(_part(element) for element in row) for row in rows)


def printed_script(script: Script) -> str:
    """The text of a script, one statement a line, without its comments."""
    parts = [_statement(statement) for statement in script.statements]
    return "\n".join([*parts, *map(_function, script.functions)]) + "\n"


def _statement(node: Statement) -> str:
    match node:
        case Assign():
            targets = ["~" if target is None else format_expression(target) for target in node.targets]
            single = len(targets) == 1 and targets[0] != "~"
            return f"{targets[0] if single else '[' + ', '.join(targets) + ']'} = {format_expression(node.value)};"
        case Evaluate():
            return f"{format_expression(node.expression)};"
        case Command():
            return " ".join((node.name, *node.words)) if node.name != "!" else f"!{' '.join(node.words)}"
        case Jump():
            return f"{node.kind};"
        case Declaration():
            return " ".join((node.kind, *node.names)) + ";"
        case _:
            return _block(node)


def _block(node: If | For | While | Switch | Try) -> str:
    match node:
        case If():
            words = ["if", *("elseif" for _ in node.branches[1:])]
            heads = [_branch(word, branch) for word, branch in zip(words, node.branches, strict=True)]
            return _closed(*heads, *_otherwise("else", node.otherwise))
        case For():
            return _closed(
                f"for {format_expression(node.target)} = {format_expression(node.values)}", *map(_statement, node.body)
            )
        case While():
            return _closed(_branch("while", Branch(node.condition, node.body)))
        case Switch():
            cases = [_branch("case", branch) for branch in node.cases]
            return _closed(
                f"switch {format_expression(node.subject)}", *cases, *_otherwise("otherwise", node.otherwise)
            )
        case Try():
            handler = ("catch " + node.name).strip() if node.name or node.handler else ""
            return _closed("try", *map(_statement, node.body), *filter(None, [handler]), *map(_statement, node.handler))


def _branch(word: str, branch: Branch) -> str:
    return "\n".join([f"{word} {format_expression(branch.condition)}", *map(_statement, branch.body)])


def _otherwise(word: str, body: tuple[Statement, ...]) -> list[str]:
    return [word, *map(_statement, body)] if body else []


def _closed(*parts: str) -> str:
    return "\n".join([*parts, "end"])


def _function(node: FunctionDefinition) -> str:
    results = f"[{', '.join(node.results)}] = " if node.results else ""
    head = f"function {results}{node.name}({', '.join(node.parameters)})"
    return _closed(head, *map(_statement, node.body))

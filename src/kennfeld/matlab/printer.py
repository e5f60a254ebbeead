"""Conversion of syntax trees to MATLAB text; parsing the text gives an equal tree."""

from collections.abc import Iterable

from kennfeld.matlab import syntax as m

_PLAIN = (m.Name, m.Text, m.Colon, m.End, m.Field, m.DynamicField, m.Call, m.CellIndex, m.Matrix, m.CellArray)


def format_expression(node: m.Expression) -> str:
    """Format an expression, with brackets around compound operands.

    >>> format_expression(m.Binary("+", m.Name("a"), m.Binary("*", m.Number(2.0), m.Name("b"))))
    'a + (2 * b)'
    """
    match node:
        case m.Unary():
            return node.operator + _part(node.operand)
        case m.Binary():
            return f"{_part(node.left)} {node.operator} {_part(node.right)}"
        case m.Transpose():
            inside = _part(node.operand)
            if isinstance(node.operand, m.Text):  # a quote behind text would continue it
                inside = f"({inside})"
            return inside + ("'" if node.conjugate else ".'")
        case m.Range():
            parts = [node.first, node.step, node.last]
            return ":".join(_part(part) for part in parts if part is not None)
        case m.AnonymousFunction():
            return f"@({', '.join(node.parameters)}) {_part(node.body)}"
        case _:
            return _operand(node)


def _operand(node: m.Expression) -> str:
    match node:
        case m.Number():
            return _number(node)
        case m.Text():
            mark = '"' if node.is_string else "'"
            return mark + node.value.replace(mark, 2 * mark) + mark
        case m.Name():
            return node.name
        case m.Colon() | m.End():
            return ":" if isinstance(node, m.Colon) else "end"
        case m.Field():
            return f"{_base(node.of)}.{node.name}"
        case m.DynamicField():
            return f"{_base(node.of)}.({format_expression(node.name)})"
        case m.Call():
            return f"{_base(node.of)}({_join_arguments(node.arguments)})"
        case m.CellIndex():
            return f"{_base(node.of)}{{{_join_arguments(node.arguments)}}}"
        case m.Matrix():
            return f"[{_rows(node.rows)}]"
        case m.CellArray():
            return f"{{{_rows(node.rows)}}}"
        case m.FunctionHandle():
            return f"@{node.name}"
        case _:
            raise AssertionError(node)


def _number(node: m.Number) -> str:
    if node.suffix in ("", "i"):
        text = repr(node.value).removesuffix(".0")
        return ("1e999" if text == "inf" else text) + node.suffix
    return f"0x{int(node.value):X}{node.suffix}"


def _base(node: m.Expression) -> str:
    """Format an operand that an index or a field follows."""
    return format_expression(node) if isinstance(node, _PLAIN) else f"({format_expression(node)})"


def _part(node: m.Expression) -> str:
    plain = isinstance(node, (*_PLAIN, m.Number))
    return format_expression(node) if plain else f"({format_expression(node)})"


def _join_arguments(nodes: Iterable[m.Expression]) -> str:
    return ", ".join(format_expression(node) if isinstance(node, m.Colon) else _part(node) for node in nodes)


def _rows(rows: Iterable[Iterable[m.Expression]]) -> str:
    return "; ".join(", ".join(_part(element) for element in row) for row in rows)


def format_script(script: m.Script) -> str:
    """Format a script with one statement per line, without its comments."""
    parts = [_statement(statement) for statement in script.statements]
    return "\n".join([*parts, *map(_function, script.functions)]) + "\n"


def _statement(node: m.Statement) -> str:
    match node:
        case m.Assign():
            targets = ["~" if target is None else format_expression(target) for target in node.targets]
            single = len(targets) == 1 and targets[0] != "~"
            return f"{targets[0] if single else '[' + ', '.join(targets) + ']'} = {format_expression(node.value)};"
        case m.Evaluate():
            return f"{format_expression(node.expression)};"
        case m.Command():
            return " ".join((node.name, *node.words)) if node.name != "!" else f"!{' '.join(node.words)}"
        case m.Jump():
            return f"{node.kind};"
        case m.Declaration():
            return " ".join((node.kind, *node.names)) + ";"
        case _:
            return _block(node)


def _block(node: m.If | m.For | m.While | m.Switch | m.Try) -> str:
    match node:
        case m.If():
            words = ["if", *("elseif" for _ in node.branches[1:])]
            heads = [_branch(word, branch) for word, branch in zip(words, node.branches, strict=True)]
            return _format_block(*heads, *_otherwise("else", node.otherwise))
        case m.For():
            return _format_block(
                f"for {format_expression(node.target)} = {format_expression(node.values)}", *map(_statement, node.body)
            )
        case m.While():
            return _format_block(_branch("while", m.Branch(node.condition, node.body)))
        case m.Switch():
            cases = [_branch("case", branch) for branch in node.cases]
            return _format_block(
                f"switch {format_expression(node.subject)}", *cases, *_otherwise("otherwise", node.otherwise)
            )
        case m.Try():
            handler = ("catch " + node.name).strip() if node.name or node.handler else ""
            return _format_block(
                "try", *map(_statement, node.body), *filter(None, [handler]), *map(_statement, node.handler)
            )


def _branch(word: str, branch: m.Branch) -> str:
    return "\n".join([f"{word} {format_expression(branch.condition)}", *map(_statement, branch.body)])


def _otherwise(word: str, body: tuple[m.Statement, ...]) -> list[str]:
    return [word, *map(_statement, body)] if body else []


def _format_block(*parts: str) -> str:
    return "\n".join([*parts, "end"])


def _function(node: m.FunctionDefinition) -> str:
    results = f"[{', '.join(node.results)}] = " if node.results else ""
    head = f"function {results}{node.name}({', '.join(node.parameters)})"
    return _format_block(head, *map(_statement, node.body))

"""Conversion of expressions to MATLAB text; parsing the text gives an equal tree."""

from collections.abc import Iterable

from kennfeld.program import tree as m

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
        case m.Number():
            return _number(node)
        case m.Text():
            mark = '"' if node.is_string else "'"
            return mark + node.value.replace(mark, 2 * mark) + mark
        case m.Name():
            return node.name
        case m.Colon():
            return ":"
        case m.End():
            return "end"
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
        case m.Conditional():
            return f"{_part(node.condition)} ? {_part(node.yes)} : {_part(node.no)}"
    raise TypeError(f"{type(node).__name__} has no text in MATLAB")


def _number(node: m.Number) -> str:
    if node.suffix in ("", "i"):
        # infinity as a literal that overflows, because Inf would be read as a name
        text = repr(node.value).removesuffix(".0")
        return ("1e999" if text == "inf" else text) + node.suffix
    # only hexadecimal and binary literals have a suffix of their class
    return f"0x{int(node.value):X}{node.suffix}"


def _base(node: m.Expression) -> str:
    """Format an operand that an index or a field follows."""
    return format_expression(node) if isinstance(node, _PLAIN) else f"({format_expression(node)})"


def _part(node: m.Expression) -> str:
    return format_expression(node) if isinstance(node, m.Number) else _base(node)


def _join_arguments(nodes: Iterable[m.Expression]) -> str:
    return ", ".join(format_expression(node) if isinstance(node, m.Colon) else _part(node) for node in nodes)


def _rows(rows: Iterable[Iterable[m.Expression]]) -> str:
    return "; ".join(", ".join(_part(element) for element in row) for row in rows)

"""Small faults in Python source: an operator, a constant or a condition is replaced by another."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass

OPERATORS = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.Pow: ("**", "*"),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
}


@dataclass(frozen=True)
class Mutation:
    """A replacement of the characters `begin` to `end` of a source; `line` counts from 1."""

    line: int
    begin: int
    end: int
    text: str

    def apply(self, source: str) -> str:
        """Return the source with the fault."""
        return source[: self.begin] + self.text + source[self.end :]


def mutations(source: str) -> list[Mutation]:
    """Return all mutations of a source that change what it computes; annotations are left alone.

    >>> source = "half: float = x / 2 if x else 0"
    >>> for mutation in mutations(source):
    ...     print(mutation.apply(source))
    half: float = x * 2 if x else 0
    half: float = x / 3 if x else 0
    half: float = x / 2 if not (x) else 0
    half: float = x / 2 if x else 1
    """
    return [mutation for mutation in candidates(source) if is_fault(mutation, source)]


def candidates(source: str) -> list[Mutation]:
    """Return all mutations, in much less time, and a few more that change nothing or do not parse."""
    tree = ast.parse(source)
    lines = _Lines(source)
    all_mutations = {mutation for node in _evaluated(tree) for mutation in _of_node(node, source, lines)}
    return sorted(all_mutations, key=lambda each: (each.begin, each.end, each.text))


def is_fault(mutation: Mutation, source: str) -> bool:
    """Return whether the mutated source parses, and to something else."""
    try:
        return ast.dump(ast.parse(mutation.apply(source))) != ast.dump(ast.parse(source))
    except SyntaxError:
        return False


class _Lines:
    """Converts the line and the column (in bytes) of a node to a position in the text."""

    def __init__(self, source: str) -> None:
        self._lines = source.splitlines(keepends=True)
        self._starts = [0]
        for line in self._lines:
            self._starts.append(self._starts[-1] + len(line))

    def begin(self, node: ast.expr) -> int:
        return self._position(node.lineno, node.col_offset)

    def end(self, node: ast.expr) -> int:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._position(node.end_lineno, node.end_col_offset)

    def _position(self, line: int, column: int) -> int:
        return self._starts[line - 1] + len(self._lines[line - 1].encode()[:column].decode())


def _evaluated(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes of a tree without annotations, literals of f-strings and what only a type checker reads."""
    yield node
    for field, child in ast.iter_fields(node):
        if field in ("annotation", "returns", "type_params") or isinstance(child, ast.JoinedStr):
            continue
        for each in child if isinstance(child, list) else [child]:
            if isinstance(each, ast.AST) and not isinstance(each, ast.JoinedStr):
                yield from _evaluated(each)


def _of_node(node: ast.AST, source: str, lines: _Lines) -> Iterator[Mutation]:
    match node:
        case ast.Compare():
            operands = [node.left, *node.comparators]
            for operator, left, right in zip(node.ops, operands, operands[1:], strict=False):
                yield from _of_operator(operator, left, right, source, lines)
        case ast.BinOp():
            yield from _of_operator(node.op, node.left, node.right, source, lines)
        case ast.BoolOp():
            for left, right in zip(node.values, node.values[1:], strict=False):
                yield from _of_operator(node.op, left, right, source, lines)
        case ast.Constant(value=bool() as value):
            yield Mutation(node.lineno, lines.begin(node), lines.end(node), str(not value))
        case ast.Constant(value=int() | float() as value):
            yield Mutation(node.lineno, lines.begin(node), lines.end(node), repr(value + 1))
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
            begin, end = lines.begin(test), lines.end(test)
            yield Mutation(test.lineno, begin, end, f"not ({source[begin:end]})")


def _of_operator(operator: ast.AST, left: ast.expr, right: ast.expr, source: str, lines: _Lines) -> Iterator[Mutation]:
    if type(operator) not in OPERATORS:
        return
    old, new = OPERATORS[type(operator)]
    begin = source.find(old, lines.end(left), lines.begin(right))
    if begin >= 0:
        yield Mutation(left.end_lineno or left.lineno, begin, begin + len(old), new)

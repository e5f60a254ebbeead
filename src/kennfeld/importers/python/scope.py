"""The names of a Python function while it is translated."""

import ast
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import field
from typing import Literal

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.program import tree as m

# numbers of NumPy divide by 0 without an exception, integers have any number of digits; the truth values of NumPy are
# no numbers: True + True is True, where that of Python is 2. Which kind a number is may depend on the path: unknown
NumberKind = Literal["float", "integer", "numpy", "numpy truth", "unknown"]


def merged_kind(kinds: Iterable[NumberKind]) -> NumberKind:
    """Return the kind of a number that is of one of several kinds.

    >>> merged_kind(["integer", "float"]), merged_kind(["numpy", "float"])
    ('float', 'unknown')
    """
    distinct = set(kinds)
    if len(distinct) == 1:
        return distinct.pop()
    return "float" if distinct <= {"integer", "float"} else "unknown"


class UntranslatableError(Exception):
    """Python that a graph cannot express; `line` is its line."""

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message)
        self.message, self.line = message, line


def untranslated(tree: ast.AST) -> UntranslatableError:
    """Return the error for code of a kind that is not translated."""
    text = (ast.unparse(tree).splitlines() or [""])[0][:40]
    return UntranslatableError(f"{text} is not translated", getattr(tree, "lineno", 0))


@dataclass(eq=False)
class FunctionScope:
    """The names of a function.

    Attributes:
        names: its arguments and what it assigns.
        lists: lengths of those names that are lists; these consist of one variable for each element.
        numbers: those that are certainly not lists.
        fixed: names that stand for an expression, such as those of comprehensions.
        kinds: which kinds of numbers names hold, as they are translated.
        inner: the functions that it defines, lambdas as functions of a single return; they read the names around them
            at each call, as they are then.
    """

    names: set[str] = field(default_factory=set)
    lists: dict[str, int] = field(default_factory=dict)
    numbers: set[str] = field(default_factory=set)
    fixed: dict[str, m.Expression] = field(default_factory=dict)
    kinds: dict[str, NumberKind] = field(default_factory=dict)
    inner: dict[str, ast.FunctionDef] = field(default_factory=dict)

    def is_local(self, name: str) -> bool:
        """Return True if a name is not one of the file."""
        return name in self.names or name in self.fixed or name in self.inner


def element_name(name: str, at: int) -> str:
    """Return the variable of an element of a list; Python has no such name."""
    return f"{name}[{at}]"


def parameters_of(tree: ast.FunctionDef) -> list[str]:
    """Return the names of the arguments of a function.

    Raises:
        UntranslatableError: it has arguments or decorators of other kinds.
    """
    arguments = tree.args
    if arguments.vararg or arguments.kwarg or tree.decorator_list:
        raise UntranslatableError(f"{tree.name} has decorators or special arguments", tree.lineno)
    return [item.arg for item in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]


def own_nodes(body: Sequence[ast.AST]) -> Iterator[ast.AST]:
    """Yield the nodes of statements, without what belongs to functions in them."""
    waiting = list(body)
    while waiting:
        node = waiting.pop()
        yield node
        if not isinstance(node, ast.FunctionDef | ast.Lambda | ast.ClassDef | ast.AsyncFunctionDef):
            waiting += ast.iter_child_nodes(node)


def stored_names(tree: ast.FunctionDef) -> set[str]:
    """Return the names that a function assigns, without those of its comprehensions and inner functions."""
    inner = {
        id(node)
        for each in own_nodes(tree.body)
        if isinstance(each, ast.comprehension)
        for node in ast.walk(each.target)
    }
    nodes = (node for node in own_nodes(tree.body) if isinstance(node, ast.Name) and id(node) not in inner)
    return {node.id for node in nodes if isinstance(node.ctx, ast.Store)}


def read_names(tree: ast.FunctionDef) -> set[str]:
    """Return the names that a function reads and does not own, also those that functions in it read."""
    own = {*parameters_of(tree), *stored_names(tree)}
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} - own


def as_function(name: str, tree: ast.Lambda) -> ast.FunctionDef:
    """Return a lambda as a function that returns its expression."""
    body: list[ast.stmt] = [ast.copy_location(ast.Return(tree.body), tree)]
    definition = ast.FunctionDef(name=name, args=tree.args, body=body, decorator_list=[], returns=None)
    return ast.copy_location(definition, tree)

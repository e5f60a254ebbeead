"""Facts about the source files of the package, each of which is parsed once in a process."""

import ast
import gc
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import NoneType
from typing import Any, NamedTuple

SOURCE = Path(__file__).parents[1] / "src" / "kennfeld"
FILES = sorted(SOURCE.rglob("*.py"))
_LEAVES = {ast.Name, ast.Constant, ast.Load, ast.Store, str, NoneType}


class SourceFacts(NamedTuple):
    """What tests ask of a file.

    Attributes:
        classes: names of the classes of the module, in order.
        names: of functions, classes, arguments and variables.
        uses: modules and names that it imports, and attributes of `os`.
        docstrings: lines of their owners, and texts.
        strings: lines and texts of all other strings.
    """

    classes: tuple[str, ...]
    names: frozenset[str]
    uses: frozenset[str]
    docstrings: tuple[tuple[int, str], ...]
    strings: tuple[tuple[int, str], ...]


@cache
def facts_of(path: Path) -> SourceFacts:
    """Return the facts about a file. Its tree is not kept: a collector of garbage would visit it again and again."""
    text = path.read_text(encoding="utf-8")
    with _without_collector():
        tree = ast.parse(text)
        nodes = _nodes_by_type(tree)
        definitions = [*nodes[ast.FunctionDef], *nodes[ast.ClassDef]]
        docstrings = {
            id(node.body[0].value): (getattr(node, "lineno", 1), docstring)
            for node in (tree, *definitions)
            if (docstring := ast.get_docstring(node)) is not None
        }
        return SourceFacts(
            classes=tuple(node.name for node in tree.body if isinstance(node, ast.ClassDef)),
            names=frozenset(
                [node.name for node in definitions]
                + [node.id for node in nodes[ast.Name]]
                + [node.arg for node in nodes[ast.arg]]
            ),
            uses=frozenset(_uses(nodes)),
            docstrings=tuple(docstrings.values()),
            strings=tuple(
                (node.lineno, node.value)
                for node in nodes[ast.Constant]
                if isinstance(node.value, str) and id(node) not in docstrings
            ),
        )


@contextmanager
def _without_collector() -> Iterator[None]:
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _nodes_by_type(tree: ast.Module) -> dict[type, list[Any]]:
    """Return all nodes, in less than half the time of `ast.walk`."""
    nodes: dict[type, list[Any]] = defaultdict(list)
    waiting: list[Any] = [tree]
    while waiting:
        node = waiting.pop()
        nodes[type(node)].append(node)
        for value in () if type(node) in _LEAVES else node.__dict__.values():
            if type(value) is list:
                waiting += value
            elif isinstance(value, ast.AST):
                waiting.append(value)
    return nodes


def _uses(nodes: dict[type, list[Any]]) -> Iterator[str]:
    yield from (alias.name for node in nodes[ast.Import] for alias in node.names)
    for node in nodes[ast.ImportFrom]:
        if node.module:
            yield from (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
    for node in nodes[ast.Attribute]:
        if isinstance(node.value, ast.Name) and node.value.id == "os":
            yield f"os.{node.attr}"

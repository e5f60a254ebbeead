"""Walks over the syntax trees of `kennfeld.program.tree`.

A tree is an expression, a statement, or a tuple of them.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, is_dataclass, replace
from itertools import takewhile
from typing import Any

from kennfeld.program import tree as m

_FIELDS: dict[type, tuple[str, ...]] = {}


def children(node: m.Expression) -> Iterator[m.Expression]:
    """Yield the direct subexpressions of an expression from left to right.

    >>> [child.name for child in children(m.Binary("+", m.Name("a"), m.Name("b")))]
    ['a', 'b']
    """
    return _outermost_expressions(_parts(node))


def _outermost_expressions(parts: Iterable[object]) -> Iterator[m.Expression]:
    for part in parts:
        if isinstance(part, m.Expression):
            yield part
        elif isinstance(part, tuple):
            yield from _outermost_expressions(part)


def map_children(node: m.Expression, change: Callable[[m.Expression], m.Expression]) -> m.Expression:
    """Return an expression with `change` applied to each of its direct subexpressions."""
    names = [field.name for field in fields(node) if field.name != "place"]
    return replace(node, **{name: _map_part(getattr(node, name), change) for name in names})


def _map_part(part: Any, change: Callable[[m.Expression], m.Expression]) -> Any:
    if isinstance(part, tuple):
        return tuple(_map_part(element, change) for element in part)
    return change(part) if isinstance(part, m.Expression) else part


def expressions_in(tree: object) -> Iterator[m.Expression]:
    """Yield all expressions of a tree, each before its subexpressions."""
    return (node for node in _nodes(tree) if isinstance(node, m.Expression))


def calls_in(tree: object) -> Iterator[tuple[str, m.Expressions]]:
    """Yield the name and the arguments of each call or index of a name in a tree."""
    for node in expressions_in(tree):
        if isinstance(node, m.Call) and isinstance(node.of, m.Name):
            yield node.of.name, node.arguments


def declares_persistent(tree: object) -> bool:
    """Return True if a tree declares persistent variables."""
    return any(isinstance(node, m.Declaration) and node.kind == "persistent" for node in _nodes(tree))


def names_assigned(tree: object) -> frozenset[str]:
    """Return the variables that statements assign to, as a whole or in part."""
    return frozenset(name for target in _targets(tree) if (name := assigned_name(target)))


def paths_assigned(tree: object) -> frozenset[str]:
    """Return what statements assign to: variables, and fields `a.b` of structs if they assign no more than these.

    >>> field, index = m.Field(m.Name("a"), "b"), (m.Number(2.0),)
    >>> targets = m.Call(field, index), m.Field(m.Call(m.Name("c"), index), "d"), m.Name("e")
    >>> sorted(paths_assigned(m.Assign(targets, m.Number(1.0))))
    ['a.b', 'c', 'e']
    """
    return frozenset(path for target in _targets(tree) if (path := assigned_path(target)))


def _targets(tree: object) -> Iterator[m.Expression]:
    for node in _nodes(tree):
        if isinstance(node, m.Assign):
            yield from (target for target in node.targets if target is not None)
        elif isinstance(node, m.For):
            yield node.target


def assigned_path(target: m.Expression) -> str:
    """Return the variable or the field of a struct that the target of an assignment is part of, else ""."""
    base, steps = access_chain(target)
    if not isinstance(base, m.Name):
        return ""
    fields = takewhile(lambda step: isinstance(step, m.Field), steps)
    names = [step.name for step in fields if isinstance(step, m.Field)]
    # a(2).b = x changes a field of one element: as a path, the whole of a
    rest = steps[len(names) :]
    whole = not any(isinstance(step, m.Field | m.DynamicField) for step in rest)
    return ".".join([base.name, *names]) if whole else base.name


def assigned_name(target: m.Expression) -> str:
    """Return the variable that the target of an assignment is part of; empty if there is none."""
    base, _ = access_chain(target)
    return base.name if isinstance(base, m.Name) else ""


def names_read(tree: object) -> frozenset[str]:
    """Return the names in a tree, of variables and of functions, without parameters of anonymous functions.

    >>> product = m.Binary("*", m.Name("a"), m.Name("b"))
    >>> sorted(names_read(m.Call(m.Name("arrayfun"), (m.AnonymousFunction(("a",), product), m.Name("u")))))
    ['arrayfun', 'b', 'u']
    """
    if isinstance(tree, m.Name):
        return frozenset({tree.name})
    names = frozenset[str]().union(*map(names_read, _parts(tree)))
    return names - set(tree.parameters) if isinstance(tree, m.AnonymousFunction) else names


def access_chain(node: m.Expression) -> tuple[m.Expression, list[m.Expression]]:
    """Split `a.b(2){3}` into its base `a` and the accesses `.b`, `(2)` and `{3}`, from left to right."""
    steps: list[m.Expression] = []
    while isinstance(node, m.Field | m.DynamicField | m.Call | m.CellIndex):
        steps.append(node)
        node = node.of
    return node, steps[::-1]


def field_path(tree: m.Expression) -> list[str] | None:
    """Return the names of `a.b.c`; None if the expression is not a chain of fields of a name."""
    names: list[str] = []
    while isinstance(tree, m.Field):
        names.append(tree.name)
        tree = tree.of
    return [tree.name, *reversed(names)] if isinstance(tree, m.Name) else None


def element_path(tree: m.Expression) -> list[str] | None:
    """Return the names of `a.b` as `field_path` does, also through elements of arrays of structs: `a(2).b`, `a{2}.b`.

    >>> element_path(m.Field(m.Call(m.Name("a"), (m.Number(2.0),)), "b"))
    ['a(2)', 'b']
    """
    names: list[str] = []
    while isinstance(tree, m.Field):
        names.append(tree.name)
        tree, index = _without_index(tree.of)
        if index and not isinstance(tree, m.Field):
            return [f"{tree.name}{index}", *reversed(names)] if isinstance(tree, m.Name) else None
        if index and isinstance(tree, m.Field):
            tree = m.Field(tree.of, f"{tree.name}{index}")
    return [tree.name, *reversed(names)] if isinstance(tree, m.Name) else None


def _without_index(tree: m.Expression) -> tuple[m.Expression, str]:
    """Return what a constant index selects from, and the index as a text."""
    if isinstance(tree, m.Call | m.CellIndex) and len(tree.arguments) == 1:
        (index,) = tree.arguments
        if isinstance(index, m.Number) and index.value >= 1 and index.value.is_integer() and not index.suffix:
            return tree.of, f"({index.value:.0f})"
    return tree, ""


def dotted_name(tree: m.Expression) -> str:
    """Return `a.b.c` as a text; empty if the expression is not a chain of fields of a name."""
    return ".".join(field_path(tree) or ())


def _nodes(tree: object) -> Iterator[object]:
    """Yield all nodes of a tree, without recursion: an expression may be nested deeper than the stack."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        # a stack: reversed, nodes come in the order of the text
        if isinstance(node, tuple):
            waiting += reversed(node)
        elif names := _field_names(type(node)):
            yield node
            waiting += [getattr(node, name) for name in reversed(names)]


def _parts(tree: object) -> tuple[object, ...]:
    return tree if isinstance(tree, tuple) else tuple(getattr(tree, name) for name in _field_names(type(tree)))


def _field_names(kind: type) -> tuple[str, ...]:
    """Return the fields of a class of nodes, none of any other class; looked up for every part of every tree."""
    names = _FIELDS.get(kind)
    if names is None:
        names = _FIELDS[kind] = tuple(field.name for field in fields(kind)) if is_dataclass(kind) else ()
    return names

"""Parts of structs, by the names on the way to them: `a.b.c`."""

from collections.abc import Mapping

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.variables.scopes import Value

__all__ = ["part_of", "way_of"]


def way_of(tree: m.Expression) -> list[str] | None:
    """The names of `a.b.c`; None where it begins with something else."""
    names: list[str] = []
    while isinstance(tree, m.Field):
        names.append(tree.name)
        tree = tree.of
    return [tree.name, *reversed(names)] if isinstance(tree, m.Name) else None


def part_of(value: Value, way: list[str]) -> Value:
    """The part of a struct at the end of a way; raises `NoValueError`."""
    for at, name in enumerate(way[1:], 1):
        if not isinstance(value, Mapping) or name not in value:
            raise NoValueError(f"{'.'.join(way[:at])} has no part {name}", ".".join(way))
        value = value[name]
    return value

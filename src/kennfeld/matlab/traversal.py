"""Walks over syntax trees."""

from kennfeld.matlab import syntax as m

__all__ = ["field_path"]


def field_path(tree: m.Expression) -> list[str] | None:
    """The names of `a.b.c`; None where it begins with something else."""
    names: list[str] = []
    while isinstance(tree, m.Field):
        names.append(tree.name)
        tree = tree.of
    return [tree.name, *reversed(names)] if isinstance(tree, m.Name) else None

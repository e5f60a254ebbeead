"""In which order nodes can be built, and the loops that forbid any."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from itertools import pairwise
from typing import NamedTuple

from kennfeld.models.formula.names import Names, children
from kennfeld.models.formula.syntax import Call, Definition, Expr, Function, Name

__all__ = ["build_order", "ordered"]


class _Use(NamedTuple):
    name: str
    at_start: bool  # for an initial value


def build_order(names: Names) -> list[str]:
    """The nodes, each after those it needs in the same sample; loops are reported and marked as broken."""
    needs = _function_needs(names)
    uses = {
        name: list(_uses(definition.value, names, needs))
        for name, definition in names.definitions.items()
        if definition.value is not None
    }
    order, loops = ordered({name: [use.name for use in used] for name, used in uses.items()})
    for loop in loops:
        starts = {(name, use.name) for name in loop for use in uses[name] if use.at_start}
        _report_loop(names, loop, names.definitions, bool(starts & set(pairwise(loop))))
    return order


def ordered(uses: Mapping[str, Iterable[str]]) -> tuple[list[str], list[list[str]]]:
    """The names, each after those it uses, and the loops, one for each group of names that has one.

    >>> ordered({"a": ["b"], "b": ["c"], "c": []})
    (['c', 'b', 'a'], [])
    >>> ordered({"a": ["b"], "b": ["a"]})[1]
    [['a', 'b', 'a']]
    """
    done: dict[str, bool] = {}
    order: list[str] = []
    loops: list[list[str]] = []
    in_loop: set[str] = set()
    for root in uses:
        path: list[str] = []
        pending: list[Iterator[str]] = [iter((root,))]
        while pending:
            used = next(pending[-1], None)
            if used is None:
                pending.pop()
                if path:
                    done[path[-1]] = True
                    order.append(path.pop())
            elif used in uses and used not in done:
                done[used] = False
                path.append(used)
                pending.append(iter(uses[used]))
            elif not done.get(used, True) and not (used in in_loop and path[-1] in in_loop):
                loops.append([*path[path.index(used) :], used])
                in_loop.update(loops[-1])
    return order, loops


def _report_loop(
    names: Names, loop: list[str], statements: Mapping[str, Definition | Function], initial: bool = False
) -> None:
    members = loop[:-1]
    first = min(range(len(members)), key=lambda i: statements[members[i]].at[2:])
    turned = [*members[first:], *members[:first]]
    shown = " -> ".join([*turned, turned[0]])
    names.broken.update(members)
    at = statements[turned[0]].at
    if isinstance(statements[turned[0]], Function):
        names.source.report(at, f"a function calls itself: {shown}", "Write feedback with prev(x, init).")
    elif initial:
        mend = "Give an initial value that does not need it."
        names.source.report(at, f"an initial value needs itself: {shown}", mend)
    else:
        mend = "Break it with prev(x, init) where the value of the step before is meant."
        names.source.report(at, f"algebraic loop: {shown}", mend)


class _Needs(NamedTuple):
    """What a function of the text needs at once: which of its arguments (None where not), and which other names."""

    arguments: tuple[_Use | None, ...]
    names: tuple[_Use, ...]


def _function_needs(names: Names) -> Mapping[str, _Needs]:
    bodies = {name: function.value for name, function in names.functions.items() if function.value is not None}
    order, loops = ordered({name: list(_calls(body, names.functions)) for name, body in bodies.items()})
    for loop in loops:
        _report_loop(names, loop, names.functions)
    needs: dict[str, _Needs] = {}
    for name in order:
        given = [argument.name for argument in names.functions[name].arguments]
        used = dict.fromkeys(_uses(bodies[name], names, needs, given))
        now = {use.name: use for use in sorted(used, key=lambda use: not use.at_start)}
        others = tuple(use for use in used if use.name not in given)
        needs[name] = _Needs(tuple(now.get(argument) for argument in given), others)
    return needs


def _calls(expr: Expr, functions: Collection[str]) -> Iterator[str]:
    stack = [expr]
    while stack:
        at = stack.pop()
        if isinstance(at, Call) and not at.at.quoted and at.name in functions:
            yield at.name
        stack.extend(children(at))


def _uses(expr: Expr, names: Names, needs: Mapping[str, _Needs], arguments: Collection[str] = ()) -> Iterator[_Use]:
    """The nodes and arguments that an expression needs in the same sample; what a memory holds next is not needed."""
    stack = [(expr, False)]
    while stack:
        at, start = stack.pop()
        if isinstance(at, Name):
            if at.name in arguments or names.kind(at.name, at.at.quoted) == "node":
                yield _Use(at.name, start)
        elif isinstance(at, Call) and (function := names.built_in(at)) is not None:
            given = [(function.argument(i), arg) for i, arg in enumerate(at.args)]
            stack.extend((arg, start or spec.name == "init") for spec, arg in given if not spec.later)
        elif isinstance(at, Call) and not at.at.quoted and at.name in names.functions:
            needed = needs.get(at.name, _Needs((), ()))
            yield from (_Use(use.name, start or use.at_start) for use in needed.names)
            given_now = zip(at.args, needed.arguments, strict=False)
            stack.extend((arg, start or use.at_start) for arg, use in given_now if use)
        else:
            stack.extend((part, start) for part in children(at))

"""Methods of a class that a step calls if neither the user nor a task of an application names them."""

import re
from collections.abc import Iterator, Sequence
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.base.errors import Finding, InputError
from kennfeld.base.formatting import count_noun, join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.ascet.c_methods import is_calculated
from kennfeld.importers.ascet.instances import ClassInstance
from kennfeld.importers.ascet.type_resolution import dotted
from kennfeld.program.traversal import expressions_in

_MAX_NAMES: Final = 8  # in a sentence
_WORD: Final = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
# `begin` starts the timers of SystemLib: a step that called it would restart them each time
_STARTS: Final = frozenset({"begin", "ini", "init", "initialise", "initialization", "initialize", "reset"})


@dataclass(frozen=True)
class DefaultMethods:
    """The methods of a step in their order; the remarks say which of several were chosen."""

    methods: tuple[e.Method, ...]
    remarks: tuple[Finding, ...] = ()


def default_methods(instance: ClassInstance) -> DefaultMethods:
    """Return the methods of a class that a step calls, in the order of their declaration.

    They are its public methods, or its processes if it has any, less those that start or reset it, those in C that
    cannot be translated, and those that another one of them calls. A method without side effects stays in: a second
    call only shows its result.

    Raises:
        InputError: no method is left.
    """
    own = instance.declaration.methods
    methods = [method for method in own if "public" in method.modifiers] or list(own)
    threads = [method for method in methods if method.annotation("thread") is not None]
    triggers = [method for method in methods if method.triggers]
    # the only method, else the only process, else the only trigger of a state machine
    for candidates in (methods, threads, triggers):
        if len(candidates) == 1:
            return DefaultMethods(tuple(candidates))
    location = instance.scope.location(instance.declaration.place, instance.declaration.name)
    if not methods:
        raise InputError.of(location, "the class has no public method", "Name the methods of a step.")
    candidates = threads or methods
    # if all are in C, each is reported with its place
    written = [method for method in candidates if is_calculated(instance, method)] or candidates
    regular = [method for method in written if not starts(method.name)]
    if not regular:
        remedy = f"Name those of a step in their order, of {join_names([each.name for each in methods], _MAX_NAMES)}."
        raise InputError.of(location, "the class has several methods, which all start or reset it", remedy)
    chosen = _without_inner_calls(instance, regular)
    return DefaultMethods(tuple(chosen), (Finding(location, *_sentences(chosen, methods), severity="remark"),))


def starts(name: str) -> bool:
    """Return True for the name of a method that starts or resets a class.

    >>> [name for name in ("reset", "APP_Init", "initCANMsg", "proc_ini", "initialSpeed", "presets") if starts(name)]
    ['reset', 'APP_Init', 'initCANMsg', 'proc_ini']
    """
    words = [word.lower() for word in _WORD.findall(name)]
    return bool(words) and not _STARTS.isdisjoint((words[0], words[-1]))


def _without_inner_calls(instance: ClassInstance, methods: Sequence[e.Method]) -> list[e.Method]:
    """Return methods without those that another one of them calls, which would run twice in a step."""
    called = {method.name: _reached(instance, method) for method in methods}
    inner = {
        method.name
        for method in methods
        if method.annotation("no_side_effect") is None
        and any(method.name in called[other.name] for other in methods if other is not method)
    }
    # methods that call each other are all inner ones; their import reports the recursion
    return [method for method in methods if method.name not in inner] or list(methods)


def _reached(instance: ClassInstance, method: e.Method) -> set[str]:
    """Return the names of the methods of a class that a method calls, also by way of others."""
    seen: set[str] = set()
    waiting = [method]
    while waiting:
        names = set(_called(instance, waiting.pop())) - seen
        seen |= names
        waiting += [other for name in names if (other := instance.method(name)) is not None]
    return seen


def _called(instance: ClassInstance, method: e.Method) -> Iterator[str]:
    machine = instance.machine(method.triggers) if method.triggers else None
    for expression in expressions_in((method.body, machine)):
        if isinstance(expression, e.Call):
            owner, _, name = dotted(expression.of).rpartition(".")
            if owner in ("", "this", instance.declaration.name):
                yield name


def _sentences(chosen: Sequence[e.Method], methods: Sequence[e.Method]) -> tuple[str, str]:
    """Return what a step calls, and how to choose something else."""
    names = [method.name for method in chosen]
    others = [method.name for method in methods if method.name not in names]
    skipped = f"; {join_names(others, _MAX_NAMES)} {'is' if len(others) == 1 else 'are'} skipped" if others else ""
    count = count_noun(len(methods), "method")
    message = f"of {count}, a step calls {join_names(names, _MAX_NAMES)} in the order of the class{skipped}"
    return message, "Others, or another order, are chosen by methods; startup names those that run once before."

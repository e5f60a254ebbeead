"""The numbers that a function and those that it calls read and write."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from kennfeld.program import tree as m
from kennfeld.program.traversal import assigned_name, children


class Usage(NamedTuple):
    """The names that a function reads, and those that it writes: its arguments, and variables of the file."""

    reads: frozenset[str]
    writes: frozenset[str]


def usage_of(name: str, functions: Mapping[str, m.FunctionDefinition]) -> Usage:
    """Return the usage of a function; names that a function it calls gets the address of count as that one uses them.

    Args:
        name: name of the function in the tree, such as `step()`.
        functions: all functions, by these names.
    """
    return _Usages(functions).of(name)


class _Usages:
    def __init__(self, functions: Mapping[str, m.FunctionDefinition]) -> None:
        self.functions = functions
        self.usages: dict[str, Usage] = {}

    def of(self, name: str) -> Usage:
        if name not in self.usages:
            self.usages[name] = Usage(frozenset(), frozenset())  # a recursion, which is refused, ends there
            reads, writes = set[str](), set[str]()
            for statement in _statements(self.functions[name].body):
                self._add(statement, reads, writes)
            self.usages[name] = Usage(frozenset(reads), frozenset(writes))
        return self.usages[name]

    def _add(self, statement: m.Statement, reads: set[str], writes: set[str]) -> None:
        match statement:
            case m.Assign(targets, m.Call(m.Name(name), arguments)) if name in self.functions:
                self._add_call(name, targets, arguments, reads, writes)
            case m.Assign(targets, value):
                for target in targets:
                    self._add_target(target, reads, writes)
                self._read(value, reads, writes)
            case m.If(branches):
                for branch in branches:
                    self._read(branch.condition, reads, writes)
            case m.While(condition):
                self._read(condition, reads, writes)
            case m.Evaluate(expression):
                self._read(expression, reads, writes)

    def _add_target(self, target: m.Expression | None, reads: set[str], writes: set[str]) -> None:
        if target is not None:
            writes.add(assigned_name(target))
        if isinstance(target, m.Call):
            for argument in target.arguments:
                self._read(argument, reads, writes)

    def _read(self, tree: m.Expression, reads: set[str], writes: set[str]) -> None:
        match tree:
            case m.Name(name):
                reads.add(name)
            case m.Call(m.Name(name), arguments) if name in self.functions:
                self._add_call(name, (), arguments, reads, writes)
            # numbers that a union no longer has, and the size of an array
            case m.Call(m.Name("c:overlapped" | "c:size")):
                return
            case _:
                for child in children(tree):
                    self._read(child, reads, writes)

    def _add_call(
        self,
        name: str,
        targets: tuple[m.Expression | None, ...],
        arguments: tuple[m.Expression, ...],
        reads: set[str],
        writes: set[str],
    ) -> None:
        usage, function = self.of(name), self.functions[name]
        for parameter, argument in zip(function.parameters, arguments, strict=False):
            if parameter in usage.reads:
                self._read(argument, reads, writes)
            # of an element that is only written, the index is read all the same
            elif isinstance(argument, m.Call):
                for index in argument.arguments:
                    self._read(index, reads, writes)
        for result, target in zip(function.results, targets, strict=False):
            if result in usage.writes:
                self._add_target(target, reads, writes)
        own = {*function.parameters, *function.results}
        reads |= {item for item in usage.reads if item not in own and _is_shared(item)}
        writes |= {item for item in usage.writes if item not in own and _is_shared(item)}


def _is_shared(name: str) -> bool:
    """Return True for variables that keep their values, which all functions share."""
    return name.startswith(".") or "()." in name


def _statements(statements: tuple[m.Statement, ...]) -> Iterator[m.Statement]:
    waiting = list(statements)
    while waiting:
        statement = waiting.pop()
        yield statement
        match statement:
            case m.If(branches, otherwise):
                waiting += [inner for branch in branches for inner in branch.body]
                waiting += otherwise
            case m.While(_, body):
                waiting += body

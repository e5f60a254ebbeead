"""The interface of a C function: which numbers are inputs, outputs, states and calibration values."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Final, Literal

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.c.declarations import CFile, CFunctionDeclaration, CVariable, StaticVariable
from kennfeld.importers.c.struct_types import CStructType, Leaf
from kennfeld.importers.c.usage import Usage
from kennfeld.program import tree as m

# structs of generated code, by the names of their variables and types
_NAMES: Final = {
    "input": re.compile(r"rtU|ExtU|ExternalInputs|\w+_U|(ExtU|ExternalInputs)_\w*"),
    "output": re.compile(r"rtY|ExtY|ExternalOutputs|\w+_Y|(ExtY|ExternalOutputs)_\w*"),
    "parameter": re.compile(r"rtP|P|Parameters|\w+_P|(P|Parameters)_\w*"),
    "state": re.compile(r"rt(DW|B|X|M|ZC|PrevZCX)|DW|B|D_Work|BlockIO|\w+_(DW|B|X)|(DW|B|D_Work|BlockIO)_\w*"),
}
Role = Literal["input", "parameter", "constant", "written"]


@dataclass(frozen=True)
class CNumbers:
    """The numbers under one path of members of a variable.

    Attributes:
        name: their name in the shared syntax tree.
        label: their name for the user, such as `rtU.speed`.
        leaf: their type and sizes.
        root: the variable that they belong to.
        first: tree of their first values; None for arguments.
        mode: how a function takes them, if they belong to an argument.
        is_initialized: True if the file states first values.
        is_own: True if other files cannot name them.
        line: line of the declaration.
    """

    name: str
    label: str
    leaf: Leaf
    root: CVariable
    first: m.Expression | None = None
    mode: Literal["", "value", "output", "input"] = ""
    is_initialized: bool = False
    is_own: bool = False
    line: int = 0

    @property
    def labels(self) -> list[str]:
        """The name of each number, in the order of memory."""
        if not self.leaf.sizes:
            return [self.label]
        places = product(*(range(size) for size in self.leaf.sizes))
        return [f"{self.label}[{','.join(map(str, place))}]" for place in places]

    @property
    def group(self) -> tuple[str, str]:
        """The struct that they are members of."""
        return self.root.name, self.leaf.owner[0]

    @property
    def is_member(self) -> bool:
        """True if they are members of a struct."""
        return isinstance(self.root.type, CStructType)

    @property
    def is_result(self) -> bool:
        """True for the number behind a pointer such as `double *y`."""
        return self.mode == "output" and not self.is_member and not self.leaf.sizes

    def is_named(self, role: str) -> bool:
        """Return True if the struct is named as generated code names those of a role."""
        path, kind = self.leaf.owner
        own = self.label.partition(".")[0] if not path else ""
        return self.is_member and any(_NAMES[role].fullmatch(name) for name in (own, kind.removeprefix("struct ")))


@dataclass(frozen=True)
class CInterface:
    """Numbers by the part that they play for a function.

    Attributes:
        inputs: those that it reads but does not set.
        parameters: calibration values.
        written: those that it writes.
        outputs: those of them that it returns.
        states: names of those whose values before the call matter.
    """

    inputs: tuple[CNumbers, ...]
    parameters: tuple[CNumbers, ...]
    written: tuple[CNumbers, ...]
    outputs: tuple[CNumbers, ...] = ()
    states: frozenset[str] = frozenset()


def argument_numbers(function: CFunctionDeclaration) -> Iterator[CNumbers]:
    """Yield the numbers of the arguments of a function."""
    for argument in function.arguments:
        for leaf in argument.variable.leaves:
            name = f"{argument.variable.name}{leaf.path}"
            mode = "input" if argument.mode == "output" and leaf.is_constant else argument.mode
            yield CNumbers(name, name, leaf, argument.variable, mode=mode, line=function.line)


def result_numbers(function: CFunctionDeclaration) -> Iterator[CNumbers]:
    """Yield the numbers of the value that a function returns."""
    if (returned := function.returned) is not None:
        for leaf in returned.leaves:
            if not leaf.is_tag:
                name = f"{returned.name}{leaf.path}"
                yield CNumbers(name, f"{function.name}{leaf.path}", leaf, returned, line=function.line)


def static_numbers(static: StaticVariable, file: CFile) -> CNumbers:
    """Return the numbers of a variable that keeps its values."""
    tree = file.variables.get(static.label) if static.root.name.startswith(".") else None
    return CNumbers(
        static.name,
        f"{static.label}{static.leaf.path}",
        static.leaf,
        static.root,
        static.first,
        is_initialized=static.is_initialized,
        is_own=tree is None or "static" in tree.storage,
        line=static.line,
    )


def find_interface(
    arguments: Sequence[CNumbers], statics: Sequence[CNumbers], usage: Usage, written_elsewhere: Collection[str]
) -> CInterface:
    """Find what a function reads and writes; its outputs and states follow from `settle`.

    Args:
        arguments: the numbers of its arguments.
        statics: the numbers that keep their values.
        usage: the names that it reads and writes.
        written_elsewhere: names that other functions of the file write.
    """
    # reversed, so that the first variable of a struct type counts
    values = {number.leaf.owner[1]: number.root.name for number in reversed(statics) if number.is_initialized}

    def role(number: CNumbers) -> Role:
        if number.leaf.is_tag:
            return "written" if number.name in usage.writes and number.mode != "value" else "constant"
        if number.mode:
            return _argument_role(number, usage, values)
        return _static_role(number, usage, written_elsewhere)

    roles = [(role(number), number) for number in (*arguments, *statics) if _is_used(number, usage)]

    def those(wanted: Role) -> tuple[CNumbers, ...]:
        return tuple(number for kind, number in roles if kind == wanted)

    parameters = tuple(_with_values(number, values, statics) for number in those("parameter"))
    return CInterface(those("input"), parameters, those("written"))


def _is_used(number: CNumbers, usage: Usage) -> bool:
    is_plain = number.mode == "value" and not number.is_member
    return is_plain or number.name in usage.reads or number.name in usage.writes


def _argument_role(number: CNumbers, usage: Usage, values: Mapping[str, str]) -> Role:
    if number.mode == "output" and number.name in usage.writes:
        return "written"
    return "parameter" if number.is_named("parameter") and number.leaf.owner[1] in values else "input"


def _static_role(number: CNumbers, usage: Usage, written_elsewhere: Collection[str]) -> Role:
    if number.root.is_constant or number.leaf.is_constant:
        return "parameter" if number.root.is_volatile else "constant"
    if number.name in usage.writes:
        return "written"
    # a static variable of a function, which no other file can set
    if "()." in number.name:
        return "constant"
    if number.is_named("parameter"):
        return "parameter"
    # another file may set a variable that is neither static nor has a first value
    is_open = not number.is_own and not number.is_initialized
    return "input" if is_open or number.is_named("input") or number.name in written_elsewhere else "constant"


def _with_values(number: CNumbers, values: Mapping[str, str], statics: Sequence[CNumbers]) -> CNumbers:
    """Return parameters of an argument with the values of the first variable of the same struct."""
    if number.first is not None:
        return number
    path, kind = number.leaf.owner
    name = f"{values[kind]}{number.leaf.path.removeprefix(path)}"
    twin = next((static for static in statics if static.name == name and static.leaf.sizes == number.leaf.sizes), None)
    return number if twin is None else replace(number, first=twin.first)


def settle(interface: CInterface, usage: Usage, needed: Collection[str], *, returns: bool) -> CInterface:
    """Complete an interface by its outputs and states.

    Args:
        interface: the numbers by their parts.
        usage: the names that the function reads and writes.
        needed: names of written numbers whose values before the call matter.
        returns: True if the function returns a number.
    """
    written = interface.written
    # structs with inputs, or with values that the function reads back, are not results as a whole
    mixed = {number.group for number in (*interface.inputs, *interface.parameters) if number.is_member} | {
        number.group
        for number in written
        if number.name in needed and number.name in usage.reads and not number.leaf.is_tag
    }

    def is_output(number: CNumbers) -> bool:
        if number.leaf.is_tag:
            return False
        if number.is_result or number.is_named("output"):
            return True
        return bool(number.mode) and number.group not in mixed and not number.is_named("state")

    outputs = tuple(number for number in written if is_output(number))
    if not outputs and not returns:
        outputs = _results_of_procedure(written, needed)
    states = frozenset(number.name for number in written if number.name in needed)
    return replace(interface, outputs=outputs, states=states)


def _results_of_procedure(written: Sequence[CNumbers], needed: Collection[str]) -> tuple[CNumbers, ...]:
    """Return the outputs of a function that has no other results: what it sets anew, else all that others can read."""
    rules: tuple[Callable[[CNumbers], bool], ...] = (
        lambda number: bool(number.mode) and number.name not in needed and not number.is_named("state"),
        lambda number: not number.mode and not number.is_own and not number.is_named("state"),
        lambda number: bool(number.mode) or "()." not in number.name,
    )
    for rule in rules:
        if outputs := tuple(number for number in written if not number.leaf.is_tag and rule(number)):
            return outputs
    return ()

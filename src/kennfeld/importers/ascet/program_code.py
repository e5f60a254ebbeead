"""The code of a program: each method of an instance that is called, as a function of the shared syntax tree."""

from collections.abc import Callable, Sequence
from dataclasses import field
from pathlib import Path
from typing import Final, TypeAlias

from kennfeld.ascet import syntax as e
from kennfeld.base.errors import Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.ascet.declarations import FileScope
from kennfeld.importers.ascet.instances import ClassInstance, Program
from kennfeld.importers.ascet.resolved_types import Fields, NumberType, Type, describe_type, leaves_of
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError
from kennfeld.program import tree as m

_MAX_METHODS: Final = 20_000  # of all instances
RESULT: Final = "return"


@dataclass(frozen=True)
class Operand:
    """A number: the tree that calculates it, and its type."""

    tree: m.Expression
    type: NumberType


@dataclass(frozen=True)
class Place:
    """A variable or a part of it; `indices` select elements of the dimensions of its leaves, from 1."""

    label: str
    type: Type
    fields: Fields = ()
    indices: tuple[m.Expression, ...] = ()
    is_local: bool = False
    is_fixed: bool = False

    def leaf(self, path: Fields = ()) -> str:
        """Return the name of the array that holds the numbers of a field."""
        # local variables differ from those of instances by the sign between the names
        return ("->" if self.is_local else ".").join((self.label, *self.fields, *path))


@dataclass(frozen=True)
class MethodCode:
    """A method of an instance as a function.

    Attributes:
        name: name of the function.
        definition: the function.
        scope: scope of the file of its class.
        result: type of its result, None for void.
        outputs: positions of the arguments that it changes.
        is_complete: False if a statement is not supported and left out.
    """

    name: str
    definition: m.FunctionDefinition
    scope: FileScope
    result: Type | None
    outputs: tuple[int, ...]
    is_complete: bool = True


@dataclass(frozen=True)
class DependentCode:
    """The formula of a dependent characteristic, and the labels of the variables in it."""

    tree: m.Expression
    used: frozenset[str]


def leaf_names(name: str, kind: Type) -> list[str]:
    """Return the names of the local variables that hold the numbers of an argument or a result."""
    result: list[str] = []
    for path, leaf, _ in leaves_of(kind):
        if not isinstance(leaf, NumberType):
            raise UnsupportedEsdlError(f"{name} is {describe_type(kind)}, which cannot be passed to a method")
        result.append("->".join((name, *path)))
    return result


@dataclass(eq=False)
class ProgramCode:
    """The methods of a program as functions, translated when first called.

    Attributes:
        translate: translates a method of an instance under a name, for arguments of these types.
        functions: functions by name.
        dependents: formulas of dependent characteristics by label; None while a formula is translated.
        findings: what is not supported, in all translated methods.
        assigned: labels of the variables that a method assigns.
        read: labels of all variables that a method uses.
        skipped: labels of methods in C whose calls are left out.
        files: files with code in C.
        has_integer_arithmetic: True if a method adds, subtracts or multiplies integers.
    """

    program: Program
    translate: "Translate"
    functions: dict[str, MethodCode] = field(default_factory=dict)
    dependents: dict[str, DependentCode | None] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    assigned: set[str] = field(default_factory=set)
    read: set[str] = field(default_factory=set)
    skipped: dict[str, None] = field(default_factory=dict)
    files: dict[Path, None] = field(default_factory=dict)
    has_integer_arithmetic: bool = False
    _open: list[str] = field(default_factory=list)

    def method(self, instance: ClassInstance, method: e.Method, arguments: Sequence[Type | None] = ()) -> MethodCode:
        """Return a method of an instance for arguments of these types, None for numbers."""
        # a function for each combination of sizes, which the code of arrays depends on
        shapes = "".join(f",{kind!r}" for kind in arguments if kind is not None)
        name = f"{instance.label}.{method.name}(){shapes}"
        if name not in self.functions:
            if name in self._open:
                raise UnsupportedEsdlError(f"{method.name} calls itself, which is not supported", "Write it as a loop.")
            if len(self.functions) > _MAX_METHODS:
                raise UnsupportedEsdlError("the program has too many methods")
            self._open.append(name)
            try:
                self.functions[name] = self.translate(self, instance, method, name, arguments)
            finally:
                self._open.pop()
        return self.functions[name]

    def report(self, error: UnsupportedEsdlError, scope: FileScope, place: e.TextPosition, path: str) -> None:
        """Add a finding for an unsupported statement."""
        finding = Finding(scope.location(error.place or place, path), error.message, error.remedy)
        if finding not in self.findings:
            self.findings.append(finding)


Translate: TypeAlias = Callable[[ProgramCode, ClassInstance, e.Method, str, Sequence[Type | None]], MethodCode]

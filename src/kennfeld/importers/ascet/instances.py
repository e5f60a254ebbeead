"""Instances of classes with their variables, by labels such as `SOCClasses.SOC.accu.temp_curve`."""

from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path
from typing import Final, Literal, TypeAlias

import numpy as np

from kennfeld.ascet import syntax as e
from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.ascet.declarations import Declared, FileScope
from kennfeld.importers.ascet.initial_values import InitialValues, Leaves, TableValues
from kennfeld.importers.ascet.resolved_types import (
    ClassType,
    Dimension,
    NumberType,
    ResolvedArray,
    ResolvedAxis,
    ResolvedTable,
    Type,
    leaves_of,
    with_sizes,
)
from kennfeld.importers.ascet.state_machines import histories, start_leaf, state_numbers
from kennfeld.importers.ascet.type_resolution import TypeResolver, dotted
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError

Storage: TypeAlias = Literal["variable", "characteristic", "constant", "message", "step"]
_MAX_INSTANCES: Final = 2_000
_MAX_DEPTH: Final = 30


@dataclass(frozen=True, eq=False)
class ProgramVariable:
    """A number, or an array of numbers, of an instance: its type, storage and initial values."""

    label: str
    type: NumberType
    storage: Storage
    initial: Float
    location: Location
    description: str = ""
    dimensions: tuple[Dimension, ...] = ()
    is_set: bool = False
    is_get: bool = False


@dataclass(frozen=True, eq=False)
class TableElement:
    """A curve, map or cube; `shared` are the labels of the axes of a group table."""

    label: str
    type: ResolvedTable
    values: TableValues
    location: Location
    description: str = ""
    shared: tuple[str, ...] = ()
    is_constant: bool = False


@dataclass(frozen=True, eq=False)
class GroupAxis:
    """Breakpoints that group tables share."""

    label: str
    type: ResolvedAxis
    breakpoints: Float
    location: Location


@dataclass(frozen=True, eq=False)
class Holder:
    """An element of an instance, an interface or a package: where its numbers are, and how they are stored."""

    label: str
    type: Type
    storage: Storage
    element: e.Element
    scope: FileScope

    @property
    def is_dependent(self) -> bool:
        """True for a dependent parameter, which is calculated from others."""
        return self.element.formula is not None


@dataclass(eq=False)
class ClassInstance:
    """An instance of a class: its elements, and the instances within it, by name."""

    label: str
    declared: Declared
    holders: dict[str, Holder] = field(default_factory=dict)
    parts: "dict[str, ClassInstance]" = field(default_factory=dict)

    @property
    def declaration(self) -> e.ClassDeclaration:
        """The declaration of the class."""
        assert isinstance(self.declared.declaration, e.ClassDeclaration)
        return self.declared.declaration

    @property
    def scope(self) -> FileScope:
        """The scope of the file of the class."""
        return self.declared.scope

    def method(self, name: str) -> e.Method | None:
        """Return a method by its name."""
        return next((method for method in self.declaration.methods if method.name == name), None)

    def machine(self, name: str) -> e.StateMachine | None:
        """Return a state machine by its name."""
        return next((machine for machine in self.declaration.machines if machine.name == name), None)


class Program:
    """All instances of a program with their variables, built when first needed; `limits` as for `TypeResolver`."""

    def __init__(self, limits: bool | None = None) -> None:
        self.types = TypeResolver(limits)
        self.variables: dict[str, ProgramVariable] = {}
        self.tables: dict[str, TableElement] = {}
        self.axes: dict[str, GroupAxis] = {}
        self.findings: list[Finding] = []
        self._singletons: dict[str, ClassInstance] = {}
        self._interfaces: dict[str, Mapping[str, Holder]] = {}
        self._constants: dict[str, Holder] = {}
        self._count = 0

    # instances

    def instance(self, declared: Declared) -> ClassInstance:
        """Return the one instance of a class that is not part of another: the imported class, or a singleton."""
        if declared.label not in self._singletons:
            self._singletons[declared.label] = instance = ClassInstance(declared.label, declared)
            # known before it is filled, since instances in it may name it
            self._fill(instance, {}, 0)
        return self._singletons[declared.label]

    def _fill(self, instance: ClassInstance, values: Mapping[str, e.Expression], depth: int) -> None:
        """Build the elements of an instance; `values` replace initial values by name."""
        self._count += 1
        if depth > _MAX_DEPTH or self._count > _MAX_INSTANCES:
            raise UnsupportedEsdlError(f"{instance.label} has too many instances within it")
        scope = instance.scope
        elements = instance.declaration.elements
        # a stable sort: values may refer to elements that are declared before
        for element in sorted(elements, key=lambda element: self._rank(element, scope)):
            try:
                self._add(instance, element, values.get(element.name, element.value), depth)
            except UnsupportedEsdlError as error:
                self._report(error, element, scope)
        # back in the order of the declaration
        instance.holders = {
            element.name: instance.holders[element.name] for element in elements if element.name in instance.holders
        }
        for machine in instance.declaration.machines:
            self._add_state(instance, machine)

    def _rank(self, element: e.Element, scope: FileScope) -> int:
        """Return 0 for the axes of group tables, which must exist before the tables."""
        try:
            return 0 if isinstance(self.types.element(element, scope), ResolvedAxis) else 1
        except UnsupportedEsdlError:
            return 1

    def _report(self, error: UnsupportedEsdlError, element: e.Element, scope: FileScope) -> None:
        location = scope.location(error.place or element.place, element.name)
        self.findings.append(Finding(location, error.message, error.remedy))

    def _add(self, instance: ClassInstance, element: e.Element, value: e.Expression | None, depth: int) -> None:
        kind = self.types.element(element, instance.scope)
        label = f"{instance.label}.{element.name}"
        if isinstance(kind, ClassType):
            instance.parts[element.name] = self._part(label, kind.declared, value, depth)
            return
        storage: Storage = _STORAGE.get(element.kind, "variable")
        # no state: the time difference follows from the samples
        if element.has("dT"):
            storage = "step"
        # a dependent parameter has no number of its own
        if element.formula is None:
            kind = self._store(instance, Holder(label, kind, storage, element, instance.scope), value)
        instance.holders[element.name] = Holder(label, kind, storage, element, instance.scope)

    def _part(self, label: str, declared: Declared, value: e.Expression | None, depth: int) -> ClassInstance:
        assert isinstance(declared.declaration, e.ClassDeclaration)
        # one instance for all that name the class
        if declared.declaration.modifiers & {"singleton", "static"}:
            return self.instance(declared)
        # variables of its own for each element of the class, which methods are inlined for
        part = ClassInstance(label, declared)
        self._fill(part, _initializer_values(declared.declaration, value), depth + 1)
        return part

    def _store(self, instance: ClassInstance | None, holder: Holder, value: e.Expression | None) -> Type:
        """Store the variables of an element; return its type with fixed sizes."""
        reader = InitialValues(self.types, holder.scope, lambda name: self._leaves(instance, name))
        place = holder.scope.location(holder.element.place, holder.element.name)
        description = holder.element.description
        match holder.type:
            case ResolvedTable():
                shared = self._shared_axes(instance, holder)
                # a group table states values alone: its breakpoints are those of the axes it shares
                points = tuple(self.axes[label].breakpoints for label in shared) if shared else None
                values = reader.table(holder.type, value, points)
                is_constant = holder.storage != "characteristic"
                table = TableElement(holder.label, holder.type, values, place, description, shared, is_constant)
                self.tables[holder.label] = table
                if not shared:
                    self._store_searched(table)
                return holder.type
            case ResolvedAxis():
                self._store_axis(holder, reader.axis(value), place)
                return holder.type
        leaves = reader.leaves(holder.type, value)
        kind = _sized(holder.type, leaves)
        for path, leaf, dimensions in leaves_of(kind):
            if not isinstance(leaf, NumberType):
                raise UnsupportedEsdlError("tables within arrays or structs are not supported")
            element = holder.element
            self.variables[".".join((holder.label, *path))] = ProgramVariable(
                ".".join((holder.label, *path)), leaf, holder.storage, leaves[path], place, description, dimensions,
                element.has("set"), element.has("get"),
            )  # fmt: skip
        return kind

    def _store_searched(self, table: TableElement) -> None:
        """Store the variables that hold the last values searched in a table, at first its first breakpoints."""
        for label, kind, points in zip(searched_labels(table), table.type.axes, table.values.axes, strict=True):
            self.variables[label] = ProgramVariable(label, kind, "variable", np.array(float(points[0])), table.location)

    def _store_axis(self, holder: Holder, breakpoints: Float, place: Location) -> None:
        """Store an axis, with the variable that holds the last value searched on it."""
        assert isinstance(holder.type, ResolvedAxis)
        if breakpoints.ndim != 1 or np.any(np.diff(breakpoints) <= 0):
            raise UnsupportedEsdlError("the breakpoints of an axis do not increase")
        self.axes[holder.label] = GroupAxis(holder.label, holder.type, breakpoints, place)
        # before any search(), interpolate() takes the first breakpoint
        label, first = searched_label(holder.label), np.array(float(breakpoints[0]))
        self.variables[label] = ProgramVariable(label, holder.type.element, "variable", first, place)

    def _shared_axes(self, instance: ClassInstance | None, holder: Holder) -> tuple[str, ...]:
        """Return the labels of the axes of a group table: those named as its sizes, or the only ones of their types."""
        assert isinstance(holder.type, ResolvedTable)
        if holder.type.form != "group" or instance is None:
            return ()
        names = [dotted(size) for size in holder.element.sizes if size is not None]
        if names and all(name in instance.holders for name in names) and len(names) == len(holder.type.axes):
            labels = [instance.holders[name].label for name in names]
        else:
            labels = [self._axis_of_type(instance, name) for name in holder.type.axis_names]
        if unknown := [label for label in labels if label not in self.axes]:
            raise UnsupportedEsdlError(f"{unknown[0]} is not an axis", "Name its axes as sizes: G[axis_x][axis_y].")
        return tuple(labels)

    def _axis_of_type(self, instance: ClassInstance, name: str) -> str:
        labels = [
            holder.label
            for holder in instance.holders.values()
            if isinstance(holder.type, ResolvedAxis) and holder.type.name == name
        ]
        if len(labels) != 1:
            message = (
                f"{len(labels)} elements of the type {name}; which one is the axis of the group table is not known"
            )
            raise UnsupportedEsdlError(message, "Name its axes as sizes: G[axis_x][axis_y].")
        return labels[0]

    def _leaves(self, instance: ClassInstance | None, name: str) -> Leaves | None:
        """Return the initial values of an element of an instance that is already stored."""
        holder = instance.holders.get(name) if instance is not None else None
        if holder is None or holder.is_dependent:
            return None
        paths = [path for path, leaf, _ in leaves_of(holder.type) if isinstance(leaf, NumberType)]
        labels = {path: ".".join((holder.label, *path)) for path in paths}
        if not labels or any(label not in self.variables for label in labels.values()):
            return None
        return {path: self.variables[label].initial for path, label in labels.items()}

    def _add_state(self, instance: ClassInstance, machine: e.StateMachine) -> None:
        """Add the variable that holds the state of a state machine."""
        label = state_label(instance, machine)
        numbers = state_numbers(self.types, instance.scope, machine)
        first = numbers.get(start_leaf(machine), 0)
        place = instance.scope.location(machine.place, machine.name)
        kind = NumberType("enumeration", 0.0, float(max(numbers.values(), default=0)))
        self.variables[label] = ProgramVariable(label, kind, "variable", np.array(float(first)), place)
        for state, start in histories(machine).items():
            own = history_label(instance, machine, state)
            number = np.array(float(numbers.get(start, 0)))
            self.variables[own] = ProgramVariable(own, kind, "variable", number, place)

    # interfaces and constants

    def interface(self, declared: Declared) -> Mapping[str, Holder]:
        """Return the messages of a data interface by name."""
        if declared.label not in self._interfaces:
            assert isinstance(declared.declaration, e.Interface)
            holders = self._interfaces[declared.label] = dict[str, Holder]()
            for element in declared.declaration.elements:
                try:
                    holder = Holder(
                        f"{declared.label}.{element.name}",
                        self.types.element(element, declared.scope),
                        "message" if not element.kind else _STORAGE[element.kind],
                        element,
                        declared.scope,
                    )
                    kind = self._store(None, holder, element.value)
                    holders[element.name] = Holder(holder.label, kind, holder.storage, element, declared.scope)
                except UnsupportedEsdlError as error:
                    self._report(error, element, declared.scope)
        return self._interfaces[declared.label]

    def constant(self, declared: Declared) -> Holder:
        """Return a constant of a package, or an element that all components of a project share."""
        if declared.label not in self._constants:
            assert isinstance(declared.declaration, e.Constant)
            element = declared.declaration.element
            kind = self.types.element(element, declared.scope)
            storage: Storage = "message" if element.has("shared") and not element.kind else "constant"
            holder = Holder(declared.label, kind, _STORAGE.get(element.kind, storage), element, declared.scope)
            kind = self._store(None, holder, element.value)
            self._constants[declared.label] = Holder(declared.label, kind, holder.storage, element, declared.scope)
        return self._constants[declared.label]

    def instances(self) -> Iterator[ClassInstance]:
        """Yield all instances, each before those within it."""
        waiting = list(self._singletons.values())
        seen: set[int] = set()
        while waiting:
            instance = waiting.pop(0)
            # a singleton may be a part of several instances
            if id(instance) not in seen:
                seen.add(id(instance))
                yield instance
                waiting[:0] = instance.parts.values()

    def sources(self) -> tuple[Path, ...]:
        """Return the files of all instances, data interfaces and constants, those of the imported classes first."""
        interfaces = (holder for holders in self._interfaces.values() for holder in holders.values())
        scopes = [
            *(instance.scope for instance in self._singletons.values()),
            *(instance.scope for instance in self.instances()),
            *(holder.scope for holder in (*interfaces, *self._constants.values())),
        ]
        return tuple(dict.fromkeys(scope.path for scope in scopes))


_STORAGE: Final[Mapping[str, Storage]] = {
    "characteristic": "characteristic", "const": "constant", "sysconst": "constant",
}  # fmt: skip


def searched_label(axis: str) -> str:
    """Return the label of the variable that holds the last value searched on an axis."""
    return f"{axis}.search"


def searched_labels(table: TableElement) -> tuple[str, ...]:
    """Return the labels of the variables that hold the last values searched in a table, or on the axes it shares."""
    if table.shared:
        return tuple(map(searched_label, table.shared))
    return tuple(f"{searched_label(table.label)}.{axis}" for axis in "xyzu"[: len(table.type.axes)])


def state_label(instance: ClassInstance, machine: e.StateMachine) -> str:
    """Return the label of the variable that holds the state of a state machine."""
    alone = len(instance.declaration.machines) == 1
    return f"{instance.label}.sm" if alone else f"{instance.label}.{machine.name}.sm"


def history_label(instance: ClassInstance, machine: e.StateMachine, state: str) -> str:
    """Return the label of the variable that holds the inner state in which a state was left."""
    return f"{state_label(instance, machine)}.{state}"


def _sized(kind: Type, leaves: Leaves) -> Type:
    """Return a type whose open dimensions are those of its initial values."""
    if not isinstance(kind, ResolvedArray) or not leaves:
        return kind
    shape = next(iter(leaves.values())).shape[: len(kind.dimensions)]
    return with_sizes(kind, ResolvedArray(tuple(Dimension(0, size) for size in shape), kind.element))


def _initializer_values(declaration: e.ClassDeclaration, value: e.Expression | None) -> dict[str, e.Expression]:
    """Return the values that `Class.Name()` assigns, by name of the element."""
    if value is None:
        return {}
    name = dotted(value.of).rpartition(".")[2] if isinstance(value, e.Call) else ""
    body = next((item.body for item in declaration.initializers if item.name == name), None)
    if body is None:
        raise UnsupportedEsdlError(f"unknown initializer of {declaration.name}", place=value.place)
    values: dict[str, e.Expression] = {}
    for statement in body:
        if not isinstance(statement, e.Assign) or not isinstance(statement.target, e.Name):
            raise UnsupportedEsdlError(f"the initializer {name} does more than assign values", place=statement.place)
        values[statement.target.name] = statement.value
    return values

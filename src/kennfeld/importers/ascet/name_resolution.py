"""Resolution of names in methods: local variables, elements, instances, interfaces, enumerations and constants."""

from collections.abc import Mapping
from typing import TypeAlias

from kennfeld.ascet import syntax as e
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.ascet.declarations import Declared
from kennfeld.importers.ascet.instances import ClassInstance, Holder, Program, state_label
from kennfeld.importers.ascet.program_code import Place
from kennfeld.importers.ascet.resolved_types import NumberType, StructType, Type
from kennfeld.importers.ascet.type_resolution import dotted
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError


@dataclass(frozen=True)
class EnumerationName:
    """The name of an enumeration or of another type."""

    type: NumberType


@dataclass(frozen=True)
class PackageName:
    """The name of a package, or its beginning."""

    name: str


@dataclass(frozen=True)
class DependentParameter:
    """A dependent parameter of an instance."""

    instance: ClassInstance
    holder: Holder


@dataclass(frozen=True)
class MachineName:
    """A state machine of an instance."""

    instance: ClassInstance
    machine: e.StateMachine


@dataclass(frozen=True)
class EnumerationLabel:
    """A label of an enumeration."""

    value: int
    type: NumberType


Named: TypeAlias = (
    Place
    | ClassInstance
    | Mapping[str, Holder]
    | EnumerationName
    | PackageName
    | DependentParameter
    | MachineName
    | EnumerationLabel
)


class NameResolver:
    """Resolves names as the methods of an instance see them; `locals` are nested scopes of variables."""

    def __init__(self, program: Program, instance: ClassInstance) -> None:
        self.program, self.instance = program, instance
        self.locals: list[dict[str, Place]] = [{}]

    def name(self, tree: e.Name) -> Named:
        """Return what a name refers to; raises `UnsupportedEsdlError` if it is unknown."""
        # order: local variables, elements of the instance, declarations that the file knows, packages
        for scope in reversed(self.locals):
            if tree.name in scope:
                return scope[tree.name]
        if tree.name == "this":
            return self.instance
        # before declarations: an element may have the name of a class or of an enumeration
        own = self._of_instance(self.instance, tree.name)
        if own is not None:
            return own
        declared = self.instance.scope.find(tree.name)
        if declared is not None:
            return self._declared(declared)
        if self.instance.scope.tree.has_package(tree.name):
            return PackageName(tree.name)
        # only names that the method could mean: those of packages would offer too many alike
        known = [*self.locals[0], *self.instance.holders, *self.instance.parts]
        remedy = self.instance.scope.remedy_for(tree.name) or nearest(tree.name, known)
        raise UnsupportedEsdlError(f"unknown name {tree.name}", remedy, tree.place)

    def _of_instance(self, instance: ClassInstance, name: str) -> Named | None:
        if name in instance.holders:
            holder = instance.holders[name]
            return DependentParameter(instance, holder) if holder.is_dependent else place_of(holder)
        if name in instance.parts:
            return instance.parts[name]
        machine = instance.machine(name)
        return None if machine is None else MachineName(instance, machine)

    def _declared(self, declared: Declared) -> Named:
        match declared.declaration:
            case e.ClassDeclaration():
                return self.program.instance(declared)
            case e.Interface():
                return self.program.interface(declared)
            case e.Constant():
                return place_of(self.program.constant(declared))
        kind = self.program.types.declared(declared)
        if not isinstance(kind, NumberType):
            raise UnsupportedEsdlError(f"{declared.label} is not a value")
        return EnumerationName(kind)

    def member(self, of: Named, tree: e.Field) -> Named:
        """Return a member of what a name refers to."""
        name = tree.name
        match of:
            case Place():
                return self._field(of, tree)
            case ClassInstance():
                result = self._of_instance(of, name)
                if result is not None:
                    return result
                known = [*of.holders, *of.parts]
                raise UnsupportedEsdlError(
                    f"{of.declared.name} has no element {name}", nearest(name, known), tree.place
                )
            case EnumerationName(kind):
                if name not in dict(kind.labels):
                    remedy = nearest(name, dict(kind.labels))
                    raise UnsupportedEsdlError(f"{kind.name} has no label {name}", remedy, tree.place)
                return EnumerationLabel(dict(kind.labels)[name], kind)
            case PackageName(package):
                return self._in_package(package, tree)
            case Mapping():
                if name not in of:
                    message = f"{dotted(tree.of)} has no message {name}"
                    raise UnsupportedEsdlError(message, nearest(name, of), tree.place)
                return place_of(of[name])
        raise UnsupportedEsdlError(f"{dotted(tree.of)} has no member {name}", place=tree.place)

    def _in_package(self, package: str, tree: e.Field) -> Named:
        tree_of_sources = self.instance.scope.tree
        qualified = f"{package}.{tree.name}"
        declared = tree_of_sources.find(qualified)
        if declared is not None:
            return self._declared(declared)
        if tree_of_sources.has_package(qualified):
            return PackageName(qualified)
        raise UnsupportedEsdlError(f"unknown name {qualified}", place=tree.place)

    def _field(self, of: Place, tree: e.Field) -> Place:
        # indices stay as they are: of an array of structs, each field is an array of its own
        if isinstance(of.type, StructType):
            kind = dict(of.type.elements).get(tree.name)
            if kind is not None:
                return Place(of.label, kind, (*of.fields, tree.name), of.indices, of.is_local, of.is_fixed)
            names = [name for name, _ in of.type.elements]
            message = f"the struct {of.type.name} has no element {tree.name}"
            raise UnsupportedEsdlError(message, nearest(tree.name, names), tree.place)
        raise UnsupportedEsdlError(f"{of.leaf()} has no element {tree.name}", place=tree.place)


def place_of(holder: Holder) -> Place:
    """Return the place of an element."""
    return Place(holder.label, holder.type, is_fixed=holder.storage in ("constant", "characteristic", "step"))


def state_place(instance: ClassInstance, machine: e.StateMachine, kind: Type) -> Place:
    """Return the place of the state of a state machine."""
    return Place(state_label(instance, machine), kind)

"""Choice of the methods that a step calls, of components of ASCET 5 and 6."""

from collections.abc import Collection, Iterable

from kennfeld.ascet import syntax as e
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.importers.ascet.component_tree import (
    ComponentScope,
    ComponentTree,
    choose_component,
    code_components,
    open_components,
)
from kennfeld.importers.ascet.method_choice import MethodChooser
from kennfeld.importers.ascet.method_selection import MethodSelection, Process, ScheduledTask


class ComponentMethodChooser(MethodChooser):
    """Chooses the methods of a step of components."""

    warnings: Collection[Finding] = ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings on the components whose instances take part, once they are imported."""
        scopes = dict.fromkeys(instance.scope for instance in self.program.instances())
        own = [finding for scope in scopes if isinstance(scope, ComponentScope) for finding in scope.findings]
        return (*own, *self.warnings)

    def of_component(self, name: str, methods: list[str], startup: list[str]) -> MethodSelection:
        """Return the methods of a component of an `.axl` or `.amd` file, or those named with several components."""
        location = Location(self.path.name)
        if self.folders:
            message = "folders are not searched for components of ASCET 6"
            raise InputError.of(location, message, "Export an archive with all components.")
        if self.tasks.names:
            message = "tasks of ASCET 6 projects are not read"
            raise InputError.of(location, message, "Name the methods of a step.")
        tree = open_components(self.path)
        self.warnings = tree.findings
        # a module has one process for each task; a step of the engine needs those of several modules
        if not name and any("." in method for method in methods):
            processes, remarks = self._of_components(tree, methods), tuple[Finding, ...]()
            first = self._of_components(tree, startup)
        else:
            instance = self.program.instance(choose_component(tree, self.path.name, name))
            processes, remarks = self._chosen(instance, methods)
            first = self._named(instance, startup)
        return MethodSelection((ScheduledTask("", tuple(processes)),), tuple(first), self.step, remarks)

    def _of_components(self, tree: ComponentTree, labels: Iterable[str]) -> list[Process]:
        """Return the methods of several components, named `Component.method`."""
        result = []
        for label in labels:
            owner, _, method = label.rpartition(".")
            instance = self.program.instance(choose_component(tree, self.path.name, owner))
            result += self._named(instance, [method])
        return result


def component_classes(tree: ComponentTree) -> tuple[e.ClassDeclaration, ...]:
    """Return the class of an `.amd` file, or all classes and modules of an archive, with their shared elements."""
    paths = [tree.main] if tree.main else list(code_components(tree))
    result = []
    for own in paths:
        declared = tree.component_scope(own).file.declarations
        shared = tuple(item.element for item in declared if isinstance(item, e.Constant))
        classes = [item for item in declared if isinstance(item, e.ClassDeclaration)]
        result += [
            e.ClassDeclaration(item.name, (*item.elements, *shared), item.methods, item.machines, place=item.place)
            for item in classes
        ]
    return tuple(result)

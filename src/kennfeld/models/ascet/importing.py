"""Public entry of the ESDL import."""

from collections.abc import Collection, Iterable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.lexer import MAX_CHARACTERS
from kennfeld.ascet.schedule import Schedule, Task, parse_schedule
from kennfeld.calfiles.esdl.reader import read_esdl
from kennfeld.calfiles.format import CalibrationSource
from kennfeld.errors import ArgumentError, Finding, InputError, Location
from kennfeld.file_errors import convert_errors
from kennfeld.formatting import join_names, nearest
from kennfeld.models.ascet.declarations import Declared, SourceTree, read_source, root_of
from kennfeld.models.ascet.import_report import EsdlImport
from kennfeld.models.ascet.instances import ClassInstance, Program
from kennfeld.models.ascet.model_import import EsdlModelImport, MethodSelection, Process
from kennfeld.models.ascet.unsupported import UnsupportedEsdlError
from kennfeld.models.model import Model
from kennfeld.parameter_set import ParameterSet

_MAX_APPLICATIONS: Final = 50
_APPLICATION: Final = ".app"


def esdl(
    path: str | Path,
    class_name: str = "",
    methods: Iterable[str] = (),
    *,
    startup: Iterable[str] | None = None,
    task: str = "",
    parameters: ParameterSet | None = None,
    folders: Iterable[str | Path] = (),
    step: float | None = None,
) -> Model:
    """Import a class, or a task of an application, of an ASCET project.

    Args:
        path: the `.esdl` file of the class, or the `.app` file of the application.
        class_name: name of the class; needed if the file has several.
        methods: methods of the class that a step calls, in their order; by default those that the task of an
            application beside the file calls, or its only public method.
        startup: methods that run once before the first step; by default those of the application.
        task: name of the task; needed if the application has several that call methods.
        parameters: values that loops and sizes of arrays use; parameters with the long label of ASCET, such as
            `SOCClasses.SOC.accu.temp_curve`, keep that name.
        folders: folders with further projects, such as that of the SystemLib; those beside the project are searched.
        step: time step in s; by default the period of the task.

    Returns:
        The model. Its inputs are the arguments of the methods and the messages that no method writes.

    Raises:
        InputError: with all findings, if a file cannot be read or a part of the program is not supported.
    """
    arguments = (class_name, methods, startup, task, parameters, folders, step)
    result = _import(path, *arguments)
    if result.model is None:
        raise InputError(result.report.findings)
    return result.model


def import_esdl(
    path: str | Path,
    class_name: str = "",
    methods: Iterable[str] = (),
    *,
    startup: Iterable[str] | None = None,
    task: str = "",
    parameters: ParameterSet | None = None,
    folders: Iterable[str | Path] = (),
    step: float | None = None,
) -> EsdlImport:
    """Import a class or a task and report on it; the model is None if a part of it is not supported.

    The arguments are those of `esdl`.

    Raises:
        InputError: if the file cannot be read, or a class, method or task is unknown.
    """
    return _import(path, class_name, methods, startup, task, parameters, folders, step)


def _import(
    path: str | Path,
    class_name: str,
    methods: Iterable[str],
    startup: Iterable[str] | None,
    task: str,
    parameters: ParameterSet | None,
    folders: Iterable[str | Path],
    step: float | None,
) -> EsdlImport:
    if step is not None and not 0 < step < float("inf"):
        raise ArgumentError(f"step must be a finite time in s > 0, got {step!r}")
    file = Path(path)
    chooser = _MethodChooser(file, [Path(folder) for folder in folders], task, step)
    try:
        if file.suffix.lower() == _APPLICATION:
            selection = chooser.of_application()
        else:
            selection = chooser.of_class(class_name, list(methods), None if startup is None else list(startup))
        result = EsdlModelImport(chooser.program, selection, file.stem, str(file), parameters).run()
    except UnsupportedEsdlError as error:
        line = error.place.line if error.place is not None else 0
        raise InputError.of(Location(file.name, line), error.message, error.remedy) from None
    except RecursionError:
        raise InputError.of(Location(file.name), "the program is nested too deeply", "Split its expressions.") from None
    if result.model is None or file.suffix.lower() == _APPLICATION:
        return result
    values = result.model.values.from_origin(_origin(file))
    return replace(result, model=replace(result.model, values=values))


def _origin(path: Path) -> object | None:
    """Return what a calibration format keeps of the file, so that values can be written into a copy of it."""
    return read_esdl(CalibrationSource(path.name, path.read_bytes(), path)).parameters.origin


def classes_of(path: Path) -> tuple[e.ClassDeclaration, ...]:
    """Return the classes of an ESDL file; raises `InputError` with all syntax errors."""
    tree = SourceTree(path.parent)
    scope = tree.scope(path)
    if path in tree.broken:
        raise InputError(tree.broken[path])
    return tuple(item for item in scope.file.declarations if isinstance(item, e.ClassDeclaration))


class _MethodChooser:
    """Chooses the methods of a step."""

    def __init__(self, path: Path, folders: list[Path], task: str, step: float | None) -> None:
        self.path, self.folders, self.task, self.step = path, folders, task, step
        self.program = Program()

    # classes

    def of_class(self, name: str, methods: list[str], startup: list[str] | None) -> MethodSelection:
        """Return the methods of a class of an ESDL file."""
        tree = SourceTree(self.path.parent, tuple(self.folders))
        scope = tree.scope(self.path)
        if self.path in tree.broken:
            raise InputError(tree.broken[self.path])
        tree.root = root_of(self.path, scope.file.package)
        declared = self._class(scope.file, name, [Declared(item, scope) for item in scope.file.declarations])
        instance = self.program.instance(declared)
        schedules = [] if methods and startup is not None and self.step is not None else self._schedules(tree.root)
        own = self._own_task(schedules, declared.label) if not methods else None
        processes = self._named(instance, methods) if methods else self._default(instance, own)
        first = self._startup(instance, startup, schedules)
        step = self.step if self.step is not None else self._period(processes, schedules)
        return MethodSelection(tuple(processes), tuple(first), step)

    def _class(self, file: e.EsdlFile, name: str, declared: list[Declared]) -> Declared:
        classes = [item for item in declared if isinstance(item.declaration, e.ClassDeclaration)]
        names = [item.name for item in classes]
        location = Location(self.path.name)
        if not classes:
            raise InputError.of(location, "the file has no class", "Name the file of a class.")
        if name:
            short = name.removeprefix(f"{file.package}.")
            if short not in names:
                raise InputError.of(location, f"unknown class {name}", nearest(short, names) or f"It has {names[0]}.")
            return classes[names.index(short)]
        if len(classes) > 1:
            raise InputError.of(location, "the file has several classes", f"Name one of them: {join_names(names, 8)}.")
        return classes[0]

    def _named(self, instance: ClassInstance, names: Collection[str]) -> list[Process]:
        known = {method.name: method for method in instance.declaration.methods}
        location = instance.scope.location(instance.declaration.place, instance.declaration.name)
        if wrong := [name for name in names if name not in known]:
            raise InputError(
                Finding(
                    location, f"unknown method {name}", nearest(name, known) or f"It has {join_names([*known], 8)}."
                )
                for name in wrong
            )
        return [Process(instance, known[name]) for name in names]

    def _default(self, instance: ClassInstance, own: Task | None) -> list[Process]:
        """Return the methods that a task calls, or the only public method."""
        if own is not None:
            prefix = f"{instance.declared.label}."
            names = [process.removeprefix(prefix) for process in own.processes if process.startswith(prefix)]
            return self._named(instance, names)
        own_methods = instance.declaration.methods
        methods = [method for method in own_methods if "public" in method.modifiers] or list(own_methods)
        threads = [method for method in methods if method.annotation("thread") is not None]
        called = [method for method in methods if method.triggers]
        for candidates in (methods, threads, called):
            if len(candidates) == 1:
                return [Process(instance, candidates[0])]
        location = instance.scope.location(instance.declaration.place, instance.declaration.name)
        names = [method.name for method in methods]
        if not names:
            raise InputError.of(location, "the class has no public method", "Name the methods of a step.")
        remedy = f"Name those of a step in their order, of {join_names(names, 8)}."
        raise InputError.of(location, "the class has several methods", remedy)

    def _startup(self, instance: ClassInstance, names: list[str] | None, schedules: list[Schedule]) -> list[Process]:
        if names is not None:
            return self._named(instance, names)
        prefix = f"{instance.declared.label}."
        known = {method.name for method in instance.declaration.methods}
        result: dict[str, None] = {}
        for schedule in schedules:
            if any(process.startswith(prefix) for process in schedule.startup):
                own = (process.removeprefix(prefix) for process in schedule.startup if process.startswith(prefix))
                result |= dict.fromkeys(name for name in own if name in known)
                break
        return self._named(instance, list(result))

    # applications

    def _schedules(self, root: Path) -> list[Schedule]:
        """Return the applications in the folder of a project; those that cannot be read are skipped."""
        result = []
        try:
            paths = sorted(islice(root.rglob(f"*{_APPLICATION}"), _MAX_APPLICATIONS))
        except OSError:
            return []
        for path in paths:
            try:
                result.append(_read_schedule(path))
            except InputError:
                continue
        return result

    def _own_task(self, schedules: list[Schedule], label: str) -> Task | None:
        """Return the task that calls methods of a class; None if there is none."""
        tasks = [
            (schedule, task)
            for schedule in schedules
            for task in schedule.tasks
            if any(process.rpartition(".")[0] == label for process in task.processes)
        ]
        if self.task:
            tasks = [(schedule, task) for schedule, task in tasks if task.name == self.task]
            if not tasks:
                raise InputError.of(Location(self.path.name), f"no task {self.task} calls methods of {label}")
        orders = {(task.name, task.processes) for _, task in tasks}
        if len({frozenset(p for p in order if p.startswith(f"{label}.")) for _, order in orders}) > 1:
            names = sorted({task.name for _, task in tasks})
            message = f"several tasks call methods of {label}"
            raise InputError.of(Location(self.path.name), message, f"Name one: {join_names(names, 8)}.")
        return tasks[0][1] if tasks else None

    def _period(self, processes: list[Process], schedules: list[Schedule]) -> float | None:
        """Return the period of the tasks that call the methods; None if it is not the same in all of them."""
        labels = {f"{process.instance.declared.label}.{process.method.name}" for process in processes}
        periods = {
            task.period
            for schedule in schedules
            for task in schedule.tasks
            if labels & set(task.processes) and (not self.task or task.name == self.task)
        }
        return periods.pop() if len(periods) == 1 else None

    def of_application(self) -> MethodSelection:
        """Return the methods of a task of an application."""
        schedule = _read_schedule(self.path)
        task = self._task(schedule)
        tree = SourceTree(self.path.parent, tuple(self.folders))
        tree.root = self._root_for(task.processes[0], tree)
        processes = [self._process(tree, label) for label in task.processes]
        startup = [self._process(tree, label) for label in schedule.startup]
        return MethodSelection(tuple(processes), tuple(startup), self.step if self.step is not None else task.period)

    def _task(self, schedule: Schedule) -> Task:
        tasks = {task.name: task for task in schedule.tasks if task.processes}
        location = Location(self.path.name)
        if self.task:
            if self.task not in tasks:
                raise InputError.of(location, f"unknown task {self.task}", nearest(self.task, tasks))
            return tasks[self.task]
        if len(tasks) != 1:
            names = join_names(list(tasks), 8)
            message = "the application has several tasks" if tasks else "the application has no task with processes"
            raise InputError.of(location, message, f"Name one of them: {names}." if tasks else "")
        return next(iter(tasks.values()))

    def _root_for(self, label: str, tree: SourceTree) -> Path:
        """Return the folder around the application that contains the package of a class."""
        first = label.split(".", 1)[0]
        for folder in (self.path.parent, *islice(self.path.parent.parents, 5)):
            if (folder / first).is_dir():
                return folder
        return tree.root

    def _process(self, tree: SourceTree, label: str) -> Process:
        owner, _, name = label.rpartition(".")
        declared = tree.find(owner)
        location = Location(self.path.name, path=label)
        if declared is None or not isinstance(declared.declaration, e.ClassDeclaration):
            raise InputError.of(location, f"unknown class {owner}", "Name the folder of its project under folders.")
        instance = self.program.instance(declared)
        method = instance.method(name)
        if method is None:
            known = [method.name for method in instance.declaration.methods]
            raise InputError.of(location, f"unknown method {name}", nearest(name, known))
        return Process(instance, method)


def _read_schedule(path: Path) -> Schedule:
    with convert_errors(path, "cannot be read"), path.open("rb") as stream:
        text = stream.read(MAX_CHARACTERS).decode("utf-8-sig", errors="replace")
    return parse_schedule(text, path.name)


__all__ = ["classes_of", "esdl", "import_esdl", "read_source"]

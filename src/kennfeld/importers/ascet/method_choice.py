"""Choice of the methods that a step calls: of a class, or of the tasks of an application."""

from collections.abc import Collection
from itertools import islice
from pathlib import Path
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.lexer import MAX_CHARACTERS
from kennfeld.ascet.schedule import Schedule, Task, parse_schedule
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import join_names, nearest
from kennfeld.importers.ascet.component_tree import holds_components
from kennfeld.importers.ascet.declarations import Declared, SourceTree, package_of, root_of
from kennfeld.importers.ascet.default_methods import default_methods
from kennfeld.importers.ascet.instances import ClassInstance, Program
from kennfeld.importers.ascet.method_selection import MethodSelection, Process, ScheduledTask
from kennfeld.importers.ascet.task_choice import ALL_TASKS, TaskChoice, skipped_tasks, step_of_tasks
from kennfeld.models.sample_times import SampleTime

_MAX_APPLICATIONS: Final = 50
APPLICATION: Final = ".app"


class MethodChooser:
    """Chooses the methods of a step.

    Args:
        path: the file of a class, or of an application.
        folders: folders with further projects.
        tasks: the tasks.
        step: the step in s, None for that of the tasks.
        limits: whether reals are limited to the ranges of their types when they are assigned; None as generated code.
    """

    def __init__(
        self, path: Path, folders: list[Path], tasks: TaskChoice, step: float | None, limits: bool | None = None
    ) -> None:
        self.path, self.folders, self.tasks, self.step = path, folders, tasks, step
        self.program = Program(limits)

    # classes

    def of_class(self, name: str, methods: list[str], startup: list[str] | None) -> MethodSelection:
        """Return the methods of a class of an ESDL file."""
        tree = SourceTree(self.path.parent, tuple(self.folders))
        scope = tree.scope(self.path)
        if self.path in tree.broken:
            raise InputError(tree.broken[self.path])
        # the file alone tells how deep its package lies, and only then can others be found
        tree.root = root_of(self.path, scope.file.package)
        declared = self._class(scope.file, name, [Declared(item, scope) for item in scope.file.declarations])
        instance = self.program.instance(declared)
        # applications are read for what the caller leaves open
        schedules = [] if methods and startup is not None and self.step is not None else self._schedules(tree.root)
        first = self._startup(instance, startup, schedules)
        if self.tasks.is_several and not methods:
            tasks, skipped = self._tasks_of(instance, schedules)
            return self._scheduled(tasks, first, skipped)
        # methods that the user names need no task, whose ambiguity would be an error
        own = self._own_task(schedules, declared.label) if not methods else None
        processes, remarks = self._chosen(instance, methods, own)
        step = self.step if self.step is not None else self._period(processes, schedules)
        return MethodSelection((ScheduledTask("", tuple(processes)),), tuple(first), step, remarks)

    def _tasks_of(
        self, instance: ClassInstance, schedules: list[Schedule]
    ) -> tuple[list[tuple[Task, list[Process]]], list[str]]:
        """Return the chosen tasks of the application that calls methods of a class, with these, and those left out."""
        label, location = instance.declared.label, Location(self.path.name)
        for schedule in schedules:
            tasks = [task for task in schedule.tasks if any(_owner(process) == label for process in task.processes)]
            if tasks:
                chosen = self.tasks.tasks(tasks, location, [task.name for task in schedule.tasks])
                return [(task, self._of_task(instance, task)) for task in chosen], skipped_tasks(self.tasks, tasks)
        raise InputError.of(location, f"no task calls methods of {label}", "Name the methods of a step.")

    def _scheduled(
        self, tasks: list[tuple[Task, list[Process]]], startup: list[Process], skipped: list[str]
    ) -> MethodSelection:
        """Return the methods of several tasks, each at its own period; of a single one in every step."""
        step = step_of_tasks([task for task, _ in tasks], self.step, Location(self.path.name))
        remarks = [f"the task {name} has no period and is left out" for name in skipped]
        # a single task needs no clock: it runs in every step
        if len(tasks) == 1:
            alone = (ScheduledTask(tasks[0][0].name, tuple(tasks[0][1])),)
            return MethodSelection(alone, tuple(startup), step, _remarks(remarks))
        scheduled = tuple(
            ScheduledTask(task.name, tuple(processes), SampleTime(task.period or step, task.delay))
            for task, processes in tasks
        )
        order = join_names([task.name for task, _ in tasks], 8)
        remarks.append(f"tasks due at the same time run one after the other, and none interrupts another: {order}")
        return MethodSelection(scheduled, tuple(startup), step, _remarks(remarks))

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

    def _of_task(self, instance: ClassInstance, task: Task) -> list[Process]:
        """Return the methods of a class that a task calls."""
        # a task calls processes of many classes; those of this one run in their order within it
        prefix = f"{instance.declared.label}."
        return self._named(instance, [name.removeprefix(prefix) for name in task.processes if name.startswith(prefix)])

    def _chosen(
        self, instance: ClassInstance, methods: list[str], task: Task | None = None
    ) -> tuple[list[Process], tuple[Finding, ...]]:
        """Return the named methods, or those of a task, or the default ones with a remark on them."""
        if methods:
            return self._named(instance, methods), ()
        if task is not None:
            return self._of_task(instance, task), ()
        default = default_methods(instance)
        return [Process(instance, method) for method in default.methods], default.remarks

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
            paths = sorted(islice(root.rglob(f"*{APPLICATION}"), _MAX_APPLICATIONS))
        except OSError:
            return []
        for path in paths:
            try:
                result.append(read_schedule(path))
            # an application beside the class is a help, not an input: its errors are none of the class
            except InputError:
                continue
        return result

    def _own_task(self, schedules: list[Schedule], label: str) -> Task | None:
        """Return the task that calls methods of a class; None if there is none."""
        tasks = [
            (schedule, task)
            for schedule in schedules
            for task in schedule.tasks
            if any(_owner(process) == label for process in task.processes)
        ]
        if self.tasks.names:
            tasks = [(schedule, task) for schedule, task in tasks if self.tasks.admits(task)]
            if not tasks:
                raise InputError.of(Location(self.path.name), f"no task {self.tasks.names[0]} calls methods of {label}")
        # tasks with the same methods of the class, perhaps of several applications, count as one
        orders = {(task.name, task.processes) for _, task in tasks}
        if len({frozenset(p for p in order if p.startswith(f"{label}.")) for _, order in orders}) > 1:
            names = sorted({task.name for _, task in tasks})
            message = f"several tasks call methods of {label}"
            raise InputError.of(Location(self.path.name), message, _several(names))
        return tasks[0][1] if tasks else None

    def _period(self, processes: list[Process], schedules: list[Schedule]) -> float | None:
        """Return the period of the tasks that call the methods; None if it is not the same in all of them."""
        labels = {f"{process.instance.declared.label}.{process.method.name}" for process in processes}
        periods = {
            task.period
            for schedule in schedules
            for task in schedule.tasks
            if labels & set(task.processes) and self.tasks.admits(task)
        }
        return periods.pop() if len(periods) == 1 else None

    def of_application(self) -> MethodSelection:
        """Return the methods of a task of an application."""
        schedule = read_schedule(self.path)
        tree = SourceTree(self.path.parent, tuple(self.folders))
        tasks = [task for task in schedule.tasks if task.processes]
        if self.tasks.is_several:
            chosen = self.tasks.tasks(tasks, Location(self.path.name), [task.name for task in schedule.tasks])
        else:
            chosen = [self._task({task.name: task for task in tasks})]
        tree.root = root_of_package(self.path.parent, chosen[0].processes[0])
        startup = [self._process(tree, label) for label in schedule.startup]
        processes = [(task, [self._process(tree, label) for label in task.processes]) for task in chosen]
        if self.tasks.is_several:
            return self._scheduled(processes, startup, skipped_tasks(self.tasks, tasks))
        step = self.step if self.step is not None else chosen[0].period
        return MethodSelection((ScheduledTask(chosen[0].name, tuple(processes[0][1])),), tuple(startup), step)

    def _task(self, tasks: dict[str, Task]) -> Task:
        location = Location(self.path.name)
        if self.tasks.names:
            name = self.tasks.names[0]
            if name not in tasks:
                raise InputError.of(location, f"unknown task {name}", nearest(name, tasks))
            return tasks[name]
        if len(tasks) != 1:
            message = "the application has several tasks" if tasks else "the application has no task with processes"
            raise InputError.of(location, message, _several(list(tasks)) if tasks else "")
        return next(iter(tasks.values()))

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


def read_schedule(path: Path) -> Schedule:
    """Read an application file; raises `InputError` if it cannot be read."""
    with convert_errors(path, "cannot be read"), path.open("rb") as stream:
        text = stream.read(MAX_CHARACTERS).decode("utf-8-sig", errors="replace")
    return parse_schedule(text, path.name)


def _owner(process: str) -> str:
    """Return the class of a process."""
    return process.rpartition(".")[0]


def _remarks(sentences: list[str]) -> tuple[Finding, ...]:
    return tuple(Finding(Location(), text, severity="remark") for text in sentences)


def _several(names: list[str]) -> str:
    return f'Name one or several of {join_names(names, 8)}, or "{ALL_TASKS}" for all periodic ones.'


def root_of_package(folder: Path, label: str) -> Path:
    """Return the folder that contains the package of a class: this one, or one around it; this one if none does."""
    first = label.split(".", 1)[0]
    return next((each for each in (folder, *islice(folder.parents, 5)) if (each / first).is_dir()), folder)


def source_root(path: Path) -> Path:
    """Return the folder that contains the packages of a class file or an application.

    Raises:
        InputError: the file cannot be read.
    """
    is_application = path.suffix.lower() == APPLICATION
    if not is_application and holds_components(path):
        return path.parent
    if not is_application:
        return root_of(path, package_of(path))
    schedule = read_schedule(path)
    processes = [*schedule.startup, *(process for task in schedule.tasks for process in task.processes)]
    label = next(iter([*processes, *schedule.classes]), "")
    return root_of_package(path.parent, label) if label else path.parent

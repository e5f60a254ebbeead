"""Public entry of the import of ASCET: classes in ESDL, tasks of applications, and components of ASCET 5 and 6."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from kennfeld.ascet import syntax as e
from kennfeld.ascet.amd.files import DATA, component_stem
from kennfeld.base.errors import ArgumentError, Finding, InputError, Location
from kennfeld.base.formatting import join_names
from kennfeld.calfiles.amd.reader import AmdReference
from kennfeld.calfiles.esdl.reader import read_esdl
from kennfeld.calfiles.format import CalibrationSource
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.importers.ascet.component_choice import ComponentMethodChooser, component_classes
from kennfeld.importers.ascet.component_tree import holds_components, is_archive, open_components
from kennfeld.importers.ascet.declarations import SourceTree, read_source
from kennfeld.importers.ascet.import_report import EsdlImport, EsdlReport
from kennfeld.importers.ascet.method_choice import APPLICATION
from kennfeld.importers.ascet.model_import import EsdlModelImport
from kennfeld.importers.ascet.task_choice import TaskChoice
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError
from kennfeld.models.importer import ImportRequest
from kennfeld.models.model import Model


def esdl(
    path: str | Path,
    class_name: str = "",
    methods: Iterable[str] = (),
    *,
    startup: Iterable[str] | None = None,
    task: str | Iterable[str] = "",
    parameters: ParameterSet | None = None,
    folders: Iterable[str | Path] = (),
    step: float | None = None,
    limit_assignments: bool | None = None,
) -> Model:
    """Import a class, or tasks of an application, of an ASCET project.

    Args:
        path: the `.esdl` file of the class, the `.app` file of the application, or for ASCET 5 and 6 the `.axl` archive
            of components or an `.amd` file of one, whose other files are beside it.
        class_name: name of the class or module; needed if the file has several.
        methods: methods of the class that a step calls, in their order; by default those that the task of an
            application beside the file calls, or its public methods less those that start or reset it. Those of several
            components of an archive are named `Component.method`.
        startup: methods that run once before the first step; by default those of the application.
        task: name of the task, or several names, or `*` for all periodic tasks; needed if the application has several
            that call methods. Each of several tasks runs at its own period and with its own time difference; messages
            keep their last value in between.
        parameters: values that loops and sizes of arrays use; parameters with the long label of ASCET, such as
            `SOCClasses.SOC.accu.temp_curve`, keep that name.
        folders: folders with further projects, such as that of the SystemLib; those beside the project are searched.
        step: time step in s; by default the period of the task, or the longest that hits the periods of several.
        limit_assignments: whether real numbers are limited to the ranges of their types when they are assigned, as
            integers always are; by default where generated code does, that is for types with a resolution (`delta`),
            and for elements of ASCET 5 and 6 whose implementation limits assignments.

    Returns:
        The model. Its inputs are the arguments of the methods and the messages that no method writes.

    Raises:
        InputError: with all findings, if a file cannot be read or a part of the program is not supported.

    >>> model = esdl("Battery/Cell/Plant.esdl")
    >>> model.graph.inputs, model.graph.parameters["leak"]
    (('current', 'ambient'), 2)
    """
    arguments = (class_name, methods, startup, task, parameters, folders, step, limit_assignments)
    return _import(path, *arguments).require_model()


def import_esdl(
    path: str | Path,
    class_name: str = "",
    methods: Iterable[str] = (),
    *,
    startup: Iterable[str] | None = None,
    task: str | Iterable[str] = "",
    parameters: ParameterSet | None = None,
    folders: Iterable[str | Path] = (),
    step: float | None = None,
    limit_assignments: bool | None = None,
) -> EsdlImport:
    """Import a class or a task and report on it; the model is None if a part of it is not supported.

    The arguments are those of `esdl`.

    Returns:
        The model, or None, and a report.

    Raises:
        InputError: if the file cannot be read, or a class, method or task is unknown.

    >>> result = import_esdl("Battery/Cell/Plant.esdl")
    >>> result.model is not None, result.report.classes
    (True, ('Cell.Plant',))
    """
    return _import(path, class_name, methods, startup, task, parameters, folders, step, limit_assignments)


def import_requested(request: ImportRequest) -> EsdlImport:
    """Import what a project or a command names; names of parameters follow those of the calibration files."""
    options = request.options
    return import_esdl(
        request.path,
        options.class_name,
        options.methods,
        startup=options.startup or None,
        task=options.task,
        parameters=request.initial,
        folders=options.folders,
        step=options.step,
        limit_assignments=options.limit_assignments,
    )


def heading(request: ImportRequest, report: EsdlReport) -> list[str]:
    """Return the comments above the formula text of a class or of tasks."""
    return [f"{request.path.name}, {', '.join(report.methods)}", *map(str, report.remarks)]


def _import(
    path: str | Path,
    class_name: str,
    methods: Iterable[str],
    startup: Iterable[str] | None,
    task: str | Iterable[str],
    parameters: ParameterSet | None,
    folders: Iterable[str | Path],
    step: float | None,
    limit_assignments: bool | None,
) -> EsdlImport:
    if step is not None and not 0 < step < float("inf"):
        raise ArgumentError(f"step must be a finite time in s > 0, got {step!r}")
    file = Path(path)
    others = [Path(folder) for folder in folders]
    chooser = ComponentMethodChooser(file, others, TaskChoice.of(task), step, limit_assignments)
    try:
        if file.suffix.lower() == APPLICATION:
            choices = {"class": class_name, "methods": tuple(methods), "startup": tuple(startup or ())}
            _refuse_choice_of_methods(file, choices)
            selection = chooser.of_application()
        elif holds_components(file):
            selection = chooser.of_component(class_name, list(methods), [] if startup is None else list(startup))
        else:
            selection = chooser.of_class(class_name, list(methods), None if startup is None else list(startup))
        result = EsdlModelImport(chooser.program, selection, file.stem, str(file), parameters).run()
    except UnsupportedEsdlError as error:
        line, name = (error.place.line, error.place.file) if error.place is not None else (0, "")
        raise InputError.of(Location(name or file.name, line), error.message, error.remedy) from None
    # each part has a limit of its depth, but expressions in methods of instances within instances add up
    except RecursionError:
        raise InputError.of(Location(file.name), "the program is nested too deeply", "Split its expressions.") from None
    result = _with_remarks(result, chooser.findings)
    # an application states no values
    if result.model is None or file.suffix.lower() == APPLICATION:
        return result
    values = result.model.values.from_origin(_origin(file, result.report.classes))
    return replace(result, model=replace(result.model, values=values))


def _refuse_choice_of_methods(file: Path, choices: Mapping[str, object]) -> None:
    """Raise `InputError` for choices that an application makes itself: its tasks name classes and methods."""
    if chosen := [name for name, choice in choices.items() if choice]:
        verb = "requires" if len(chosen) == 1 else "require"
        message = f"{join_names(chosen, len(chosen), ' and ')} {verb} a class, and this is an application"
        raise InputError.of(Location(file.name), message, "Name a task, or the file of the class.")


def _with_remarks(result: EsdlImport, remarks: tuple[Finding, ...]) -> EsdlImport:
    """Return an import with further remarks."""
    report = replace(result.report, remarks=(*result.report.remarks, *remarks))
    model = None if result.model is None else replace(result.model, remarks=(*result.model.remarks, *remarks))
    return EsdlImport(model, report)


def _origin(path: Path, classes: tuple[str, ...]) -> object | None:
    """Return what a calibration format keeps of the file, so that values can be written into a copy of it."""
    if holds_components(path):
        data = path if is_archive(path) else path.with_name(component_stem(path.name) + DATA)
        return AmdReference(data, classes[0] if len(classes) == 1 else "")
    # the text of the class itself: only its numbers are replaced when values are written
    return read_esdl(CalibrationSource(path.name, path.read_bytes(), path)).parameters.origin


def classes_of(path: Path) -> tuple[e.ClassDeclaration, ...]:
    """Return the classes of an ESDL file, or of an `.axl` or `.amd` file; raises `InputError` with all errors."""
    if holds_components(path):
        return component_classes(open_components(path))
    tree = SourceTree(path.parent)
    scope = tree.scope(path)
    if path in tree.broken:
        raise InputError(tree.broken[path])
    return tuple(item for item in scope.file.declarations if isinstance(item, e.ClassDeclaration))


__all__ = ["classes_of", "esdl", "import_esdl", "read_source"]

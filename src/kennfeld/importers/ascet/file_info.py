"""Description of a class, a component or an application of an ASCET project."""

from collections.abc import Sequence

from kennfeld.ascet import syntax as e
from kennfeld.ascet.amd.files import DATA
from kennfeld.files.calibrations import AMD
from kennfeld.files.file_info import DescribedFile, FileInfo, Table, plain
from kennfeld.files.identification import identify
from kennfeld.importers.ascet.component_tree import is_archive
from kennfeld.importers.ascet.import_report import EsdlReport
from kennfeld.importers.ascet.importer import IMPORTER
from kennfeld.importers.ascet.importing import classes_of, import_requested
from kennfeld.importers.ascet.method_choice import APPLICATION
from kennfeld.models.import_report import describe_import
from kennfeld.models.importer import ImportRequest


def describe_esdl(file: DescribedFile) -> FileInfo:
    """Describe a class or an application of an ASCET project: what can be calibrated and what prevents it."""
    path, options = file.path, file.options
    is_application = path.suffix.lower() == APPLICATION
    classes = () if is_application else classes_of(path)
    plural = "" if len(classes) == 1 else "es"
    language = "6 components" if identify(path).format is AMD else "ESDL"
    kind = "application" if is_application else f"{language}, {len(classes)} class{plural}"
    as_json = {"content": "ASCET model", "classes": [item.name for item in classes]}
    info = FileInfo(f"{path.name}: ASCET {kind}", [] if is_application else [_class_table(classes)], [], plain(as_json))
    if not (classes or is_application):
        return info

    def inspect() -> EsdlReport:
        return import_requested(ImportRequest(path, options)).report

    return describe_import(info, inspect, chosen=options.chosen(IMPORTER.keys))


def describe_components(file: DescribedFile) -> FileInfo:
    """Describe ASCET 5 or 6 components: their methods, their values, and one of them as a model if it is selected."""
    from kennfeld.calfiles.file_info import describe_calibration

    # a file of values is one for itself, unless the user asks for its component as a model
    if file.path.name.lower().endswith(DATA) and not file.options.chosen(IMPORTER.keys):
        return describe_calibration(file)
    model = describe_esdl(file)
    if not is_archive(file.path) or "import" in model.as_json:
        return model
    values = describe_calibration(file)
    remedy = "name one by --class, and its methods by --method, to see it as a model"
    return FileInfo(values.summary, [*model.tables, *values.tables], [*values.notes, remedy], values.as_json)


def _class_table(classes: Sequence[e.ClassDeclaration]) -> Table:
    """Return a row for each class of a file: its methods, and its numbers of elements."""
    rows: list[Sequence[str]] = [("class", "methods", "characteristics", "variables", "state machines")]
    for item in classes:
        kinds = [element.kind for element in item.elements]
        methods = ", ".join(method.name for method in item.methods)
        counts = (kinds.count("characteristic"), kinds.count(""), len(item.machines))
        rows.append((item.name, methods, *map(str, counts)))
    return rows

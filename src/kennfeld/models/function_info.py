"""Describes a function of a file, such as `lag.c:lag`, or all functions of a file, without running them."""

from pathlib import Path

from kennfeld.base.formatting import count_noun, number_text, size_text
from kennfeld.domain.parameters import Parameter
from kennfeld.files.file_info import DescribedFile, FileInfo, Table, json_entry
from kennfeld.models.function_files import list_functions, read_function_file
from kennfeld.models.import_report import describe_import
from kennfeld.models.importer import NO_OPTIONS, Importer, ImportRequest
from kennfeld.models.quantities import PARAMETER_KINDS


def describe_functions(file: DescribedFile) -> FileInfo:
    """Describe the functions of a file, their arguments and results as the file declares them, or the chosen one.

    Raises:
        InputError: the file cannot be read, or has no such function.
    """
    path = file.path
    if file.choice:
        return _describe_reference(f"{path}:{file.choice}")
    functions = list_functions(path)
    rows = [(f.name, ", ".join(f.arguments), ", ".join(f.results), f.problem) for f in functions]
    as_json = {
        "content": "functions",
        "file": str(path),
        "functions": [
            {"name": f.name, "arguments": list(f.arguments), "results": list(f.results), "problem": f.problem}
            for f in functions
        ],
    }
    notes = [f"kennfeld info {path}:{functions[0].name} describes one of them."] if functions else []
    tables: list[Table] = [[("function", "arguments", "results", ""), *rows]] if rows else []
    return FileInfo(f"{path}: {count_noun(len(functions), 'function')}", tables, notes, as_json)


def describe_function(importer: Importer, file: DescribedFile) -> FileInfo:
    """Describe the functions of a file, or its only one by the report on its import, if its importer says no more."""
    if importer.lists and (importer.reads or not file.choice):
        return describe_functions(file)
    request = ImportRequest(file.path, file.options or NO_OPTIONS, file.choice)
    outline = FileInfo(f"{file.path.name}: {importer.name}", [], [], json_entry("function", file.path))
    chosen = bool(file.choice) or request.options.chosen(importer.keys)
    return describe_import(outline, lambda: importer.import_(request).report, chosen=chosen)


def _describe_reference(reference: str) -> FileInfo:
    """Describe a function: arguments with their defaults, results, parameters, states, and what runs differently."""
    function = read_function_file(reference, Path())
    defaults = ["" if item.default is None else f"{item.default:g}" for item in function.inputs]
    inputs = [(item.name, item.unit, default) for item, default in zip(function.inputs, defaults, strict=True)]
    outputs = [(item.name, item.unit) for item in function.outputs]
    parameters = function.values.parameters
    memory = ", with states" if function.memory else ""
    remarks = [str(remark) for remark in function.remarks]
    as_json = {
        "kind": "function",
        "file": reference,
        "states": function.memory,
        "inputs": [{"name": x.name, "unit": x.unit, "default": x.default} for x in function.inputs],
        "parameters": [{"name": p.name, "kind": p.kind, "values": p.values.tolist()} for p in parameters],
        "state_names": list(function.states),
        "outputs": [{"name": y.name, "unit": y.unit} for y in function.outputs],
        "remarks": remarks,
    }
    tables: list[Table] = [
        [("input", "unit", "default"), *inputs],
        [("parameter", "kind", "values", ""), *map(_parameter_row, parameters)],
        [("state",), *((name,) for name in function.states)],
        [("output", "unit"), *outputs],
    ]
    shown = [table for table in tables if len(table) > 1]
    return FileInfo(f"{reference}: function{memory}", shown, remarks, as_json)


def _parameter_row(parameter: Parameter) -> tuple[str, ...]:
    values = number_text(float(parameter.values)) if not parameter.axes else size_text(parameter.values.shape)
    return parameter.name, PARAMETER_KINDS[len(parameter.axes)], values, "locked" if parameter.locked.all() else ""

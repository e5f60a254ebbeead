"""Describes a function of a file, such as `lag.c:lag`, without running it."""

from pathlib import Path

from kennfeld.models.function_files import read_function_file
from kennfeld.terminal.describers import FileInfo


def describe_function(reference: str) -> FileInfo:
    """Describe a function: its arguments with their defaults, its results, and what runs differently.

    Raises:
        InputError: the file cannot be read, or has no such function.
    """
    function = read_function_file(reference, Path())
    defaults = ["" if item.default is None else f"{item.default:g}" for item in function.inputs]
    inputs = [(item.name, item.unit, default) for item, default in zip(function.inputs, defaults, strict=True)]
    outputs = [(item.name, item.unit) for item in function.outputs]
    memory = ", with states" if function.memory else ""
    as_json = {
        "kind": "function",
        "file": reference,
        "states": function.memory,
        "inputs": [{"name": x.name, "unit": x.unit, "default": x.default} for x in function.inputs],
        "outputs": [{"name": y.name, "unit": y.unit} for y in function.outputs],
        "remarks": [str(remark) for remark in function.remarks],
    }
    tables: list[list[tuple[str, ...]]] = [[("input", "unit", "default"), *inputs], [("output", "unit"), *outputs]]
    return FileInfo(f"{reference}: function{memory}", tables, [str(remark) for remark in function.remarks], as_json)

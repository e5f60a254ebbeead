"""C functions as model functions."""

from pathlib import Path

from kennfeld.errors import Finding, InputError, Location
from kennfeld.models.model_function import FunctionInput, FunctionOutput, ModelFunction
from kennfeld.optional_packages import optional_package


def read_function(path: Path, function: str, name: str = "", step: float | None = None) -> ModelFunction:
    """Read a function of a C file, as `read_function_file` does.

    Its number arguments become inputs, its value and what it writes through pointers the outputs, and its static
    variables states. Derivatives are exact.

    Raises:
        InputError: the file is not C, has no such function, or the function is not supported; carries all problems.
    """
    with optional_package(Location(path.name), "c"):
        from kennfeld.models.c_code.reading import read_c_file, unknown_function
        from kennfeld.models.c_code.translated import translate

    file = read_c_file(path)
    if function in file.declarations.unsupported:
        error = file.declarations.unsupported[function]
        raise InputError.of(
            Location(path.name, error.line), error.message, "Use numbers as arguments, and double *y for results."
        )
    if function not in file.declarations.functions:
        raise unknown_function(file, function)
    declared = file.declarations.functions[function]
    try:
        translated = translate(file.declarations, declared)
    except RecursionError:
        raise InputError.of(
            Location(path.name, declared.line), "it is nested too deeply", "Split its expressions."
        ) from None
    if translated.problems:
        raise InputError(Finding(Location(path.name, problem.line), problem.message) for problem in translated.problems)
    place = Location(path.name, declared.line)
    remarks = tuple(Finding(place, remark, severity="remark") for remark in translated.remarks)
    returned = [FunctionOutput(function)] if declared.result is not None else []
    return ModelFunction(
        name or function,
        tuple(FunctionInput(x.variable.name) for x in declared.arguments if x.mode == "value"),
        (*returned, *(FunctionOutput(x.variable.name) for x in declared.outputs)),
        translated.write,
        memory=bool(translated.changed),
        source=str(path),
        remarks=remarks,
    )

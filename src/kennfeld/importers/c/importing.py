"""C functions as model functions."""

import re
from pathlib import Path

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.optional_packages import optional_package
from kennfeld.models.importer import NO_OPTIONS, ImportOptions
from kennfeld.models.model_function import FunctionInput, FunctionOutput, FunctionSummary, ModelFunction


def read_function(
    path: Path, function: str, name: str = "", step: float | None = None, options: ImportOptions = NO_OPTIONS
) -> ModelFunction:
    """Read a function of a C file, as `read_function_file` does.

    Its number arguments become inputs, its value and what it writes through pointers the outputs, what it keeps between
    calls states, and `const volatile` variables parameters. Derivatives are exact. The options `target` and `float32`
    say how large `long` is, and if `float` is rounded to single precision.

    Raises:
        InputError: the file is not C, has no such function, or the function is not supported; carries all problems.
    """
    # these modules load pycparser, which is optional
    with optional_package(Location(path.name), "c"):
        from kennfeld.importers.c.number_types import known_types
        from kennfeld.importers.c.reading import read_c_file, unknown_function
        from kennfeld.importers.c.translated import OPEN_PASSES, translate

    file = read_c_file(path, known_types(options.target, float32=options.float32))
    declarations, source = file.declarations, file.source
    if function in declarations.unsupported:
        error = declarations.unsupported[function]
        remedy = error.remedy or "Use numbers, structs, and their addresses as arguments."
        raise InputError.of(source.location(error.line, error.column), error.message, remedy)
    if function not in declarations.functions:
        raise unknown_function(file, function)
    place = source.location(declarations.functions[function].line)
    try:
        translated = translate(declarations, declarations.functions[function], f"{name}." if name else "")
    except RecursionError:
        raise InputError.of(place, "it is nested too deeply", "Split its expressions.") from None
    if translated.problems:
        raise InputError(Finding(source.location(problem.line), problem.message) for problem in translated.problems)
    remarks = [Finding(place, remark, severity="remark") for remark in translated.remarks]
    endless = (
        f"the end of this loop depends on signals: it is followed for {OPEN_PASSES} passes, and results are NaN beyond"
    )
    remarks += [Finding(source.location(line), endless, severity="remark") for line in translated.open_loops]
    spell = _plain if name else str
    return ModelFunction(
        name or function,
        tuple(FunctionInput(spell(label)) for label in translated.inputs),
        tuple(FunctionOutput(spell(label)) for label in translated.outputs),
        translated.write,
        memory=bool(translated.interface.states),
        values=translated.values,
        source=str(path),
        remarks=tuple(remarks),
        states=tuple(translated.states),
    )


def list_functions(path: Path) -> list[FunctionSummary]:
    """Return the functions of a C file with the declarations of their arguments and results.

    Raises:
        InputError: the file is not C; carries all problems.
    """
    with optional_package(Location(path.name), "c"):
        from kennfeld.importers.c.reading import read_c_file

    declarations = read_c_file(path).declarations
    summaries = [
        FunctionSummary(
            name,
            tuple(argument.text for argument in function.arguments),
            (
                *([function.result.name] if function.result is not None else []),
                *(argument.text for argument in function.outputs),
            ),
        )
        for name, function in declarations.functions.items()
    ]
    return summaries + [FunctionSummary(name, (), (), str(error)) for name, error in declarations.unsupported.items()]


def _plain(label: str) -> str:
    """Return the name of an element as formula text can call it.

    >>> _plain("rtY.torque[0,1]")
    'rtY.torque.0.1'
    """
    return re.sub(r"[\[,]", ".", label).rstrip("]")

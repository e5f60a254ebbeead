"""Reading of functions in Python files, without running them."""

import ast
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from kennfeld.base.errors import Findings, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.models.model_function import FunctionInput

_MAX_BYTES: Final = 2_000_000


@dataclass(frozen=True)
class PythonFunction:
    """A function of a file.

    Attributes:
        path: the file.
        tree: the function.
        inputs: its arguments with their defaults.
        results: names of its results.
        constants: numbers that the file assigns to names outside of functions.
        modules: modules that the file imports, by the names it gives them; functions as `math.exp`.
        functions: the functions of the file.
    """

    path: Path
    tree: ast.FunctionDef
    inputs: tuple[FunctionInput, ...]
    results: tuple[str, ...]
    constants: dict[str, float]
    modules: dict[str, str]
    functions: dict[str, ast.FunctionDef]


def read_python_function(path: Path, name: str) -> PythonFunction:
    """Read a function of a Python file by its syntax.

    Raises:
        InputError: the file is not Python or has no such function, or its arguments are not numbers.
    """
    tree, functions = _read(path)
    if name not in functions:
        listed = f"The file has {', '.join(list(functions)[:8])}." if functions else "The file has no functions."
        raise InputError.of(Location(path.name), f"no function {name}", nearest(name, functions) or listed)
    function = functions[name]
    findings = Findings()
    constants = dict(_constants(tree))
    inputs = tuple(_inputs(function, constants, path, findings))
    results = _results(function, path, findings)
    findings.finish()
    modules = dict(_modules(tree))
    return PythonFunction(path, function, inputs, results, constants, modules, functions)


def function_names(path: Path) -> list[str]:
    """Return the names of the functions of a Python file.

    Raises:
        InputError: the file is not Python.
    """
    return list(_read(path)[1])


def _read(path: Path) -> tuple[ast.Module, dict[str, ast.FunctionDef]]:
    with convert_errors(path, "the file cannot be read"):
        content = path.read_bytes()
    tree = _parsed(content, path)
    return tree, {item.name: item for item in tree.body if isinstance(item, ast.FunctionDef)}


def _parsed(content: bytes, path: Path) -> ast.Module:
    if len(content) > _MAX_BYTES:
        raise InputError.of(Location(path.name), f"the file has more than {_MAX_BYTES} bytes", "Split it.")
    try:
        return ast.parse(content, path.name)
    except SyntaxError as error:
        location = Location(path.name, error.lineno or 0, column=error.offset or 0)
        raise InputError.of(location, f"not valid Python: {error.msg}", "Correct it.") from None
    except (RecursionError, MemoryError, ValueError) as error:
        message = f"not valid Python: {str(error)[:80] or 'nested too deeply'}"
        raise InputError.of(Location(path.name), message, "Correct it.") from None


def number_of(tree: ast.expr | None, constants: dict[str, float]) -> float | None:
    """Return the number that an expression writes; None if it is something else."""
    match tree:
        case ast.Constant(value=bool() | int() | float() as value):
            # an int may be too large for a double
            return float(value) if abs(value) < 1e300 or isinstance(value, float) else None
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            number = number_of(operand, constants)
            return None if number is None else -number
        case ast.Name(id=name):
            return constants.get(name)
    return None


def _constants(tree: ast.Module) -> Iterator[tuple[str, float]]:
    seen: dict[str, float] = {}
    assigned: list[str] = [
        node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    ]
    changed = {name for node in ast.walk(tree) if isinstance(node, ast.Global) for name in node.names}
    for item in tree.body:
        if isinstance(item, ast.Assign) and len(item.targets) == 1 and isinstance(item.targets[0], ast.Name):
            name, number = item.targets[0].id, number_of(item.value, seen)
            # a name that is assigned anywhere else is a variable
            if number is not None and name not in changed and assigned.count(name) == 1:
                seen[name] = number
    yield from seen.items()


def _modules(tree: ast.Module) -> Iterator[tuple[str, str]]:
    for item in tree.body:
        if isinstance(item, ast.Import):
            yield from ((alias.asname or alias.name, alias.name) for alias in item.names)
        elif isinstance(item, ast.ImportFrom) and item.module:
            yield from ((alias.asname or alias.name, f"{item.module}.{alias.name}") for alias in item.names)


def _inputs(
    function: ast.FunctionDef, constants: dict[str, float], path: Path, findings: Findings
) -> Iterator[FunctionInput]:
    arguments = function.args
    if arguments.vararg or arguments.kwarg or arguments.kwonlyargs:
        location = Location(path.name, function.lineno)
        findings.error(
            location, f"{function.name} has a variable number of arguments, or keywords", "Name all arguments."
        )
    plain = [*arguments.posonlyargs, *arguments.args]
    defaults: list[ast.expr | None] = [None] * (len(plain) - len(arguments.defaults))
    for argument, default in zip(plain, [*defaults, *arguments.defaults], strict=True):
        number = number_of(default, constants)
        if default is not None and (number is None or not math.isfinite(number)):
            message = f"the default of {argument.arg} must be a number, got {ast.unparse(default)[:40]}"
            findings.error(Location(path.name, default.lineno), message, "Write a number.")
        yield FunctionInput(argument.arg, default=number)


def returns_of(function: ast.FunctionDef) -> list[ast.Return]:
    """Return the return statements of a function, without those of functions in it."""
    result: list[ast.Return] = []
    waiting: list[ast.AST] = list(function.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Return):
            result.append(node)
        elif not isinstance(node, ast.FunctionDef | ast.Lambda | ast.ClassDef | ast.AsyncFunctionDef):
            waiting += ast.iter_child_nodes(node)
    return sorted(result, key=lambda item: item.lineno)


def _results(function: ast.FunctionDef, path: Path, findings: Findings) -> tuple[str, ...]:
    location = Location(path.name, function.lineno)
    values = [item.value for item in returns_of(function) if item.value is not None]
    if not values:
        findings.error(location, f"{function.name} returns no value", "Return a number, or several.")
        return ()
    counts = {len(value.elts) if isinstance(value, ast.Tuple) else 1 for value in values}
    if len(counts) > 1:
        findings.error(location, f"{function.name} returns different numbers of values", "Return equally many.")
        return ()
    first = values[-1]
    if not isinstance(first, ast.Tuple):
        return (function.name,)
    # the last return names the results
    names = [item.id if isinstance(item, ast.Name) else f"y{at}" for at, item in enumerate(first.elts, 1)]
    return tuple(names) if len(set(names)) == len(names) else tuple(f"y{at}" for at in range(1, len(names) + 1))

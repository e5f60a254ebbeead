"""Reading of functions in Python files, without running them."""

import ast
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import field
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
        lists: lists of numbers that the file assigns to names outside of functions, and the rows of lists of lists.
        arrays: names of those lists that are arrays of NumPy.
        closures: functions that the file makes by calls outside of functions, by the names it gives them.
    """

    path: Path
    tree: ast.FunctionDef
    inputs: tuple[FunctionInput, ...]
    results: tuple[str, ...]
    constants: dict[str, float]
    modules: dict[str, str]
    functions: dict[str, ast.FunctionDef]
    lists: dict[str, tuple[float, ...]] = field(default_factory=dict)
    closures: dict[str, ast.FunctionDef] = field(default_factory=dict)
    arrays: frozenset[str] = frozenset()


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
    constants |= dict(attribute_numbers(tree, constants))
    inputs = tuple(_inputs(function, constants, path, findings))
    results = _results(function, path, findings)
    findings.finish()
    modules = dict(_modules(tree))
    lists = dict(_lists(tree, constants, modules))
    closures = dict(_closures(tree, functions, constants))
    arrays = frozenset(name for name, value in _assigned_once(tree) if isinstance(value, ast.Call))
    return PythonFunction(path, function, inputs, results, constants, modules, functions, lists, closures, arrays)


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
    """Return the number that an expression writes, an `int` for integers.

    None if it is something else, or an integer that a double does not represent.
    """
    match tree:
        case ast.Constant(value=bool() | int() | float() as value):
            return value if isinstance(value, float) or is_exact(value) else None
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            number = number_of(operand, constants)
            return None if number is None else -number
        case ast.Name(id=name):
            return constants.get(name)
        case ast.Attribute():
            return constants.get(ast.unparse(tree))
    return None


def is_exact(number: int) -> bool:
    """Return True if a double represents an integer.

    >>> is_exact(2**53), is_exact(2**53 + 1), is_exact(2**60), is_exact(10**400)
    (True, False, True, False)
    """
    return abs(number) < 2**1023 and int(float(number)) == number


def _assigned_once(tree: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """Yield the names that a file assigns outside of functions and nowhere else, with their values."""
    assigned = Counter(n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and not isinstance(n.ctx, ast.Load))
    # a function that declares a name `global` may assign it in any call
    changed = {name for node in ast.walk(tree) if isinstance(node, ast.Global) for name in node.names}
    for item in tree.body:
        match item:
            case (
                ast.Assign(targets=[ast.Name(id=name)], value=value)
                | ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value)
            ) if name not in changed and assigned[name] == 1:
                yield name, value


def _constants(tree: ast.Module) -> Iterator[tuple[str, float]]:
    seen: dict[str, float] = {}
    for name, value in _assigned_once(tree):
        number = number_of(value, seen)
        if number is not None:
            seen[name] = number
    yield from seen.items()


def attribute_numbers(tree: ast.Module, constants: dict[str, float]) -> Iterator[tuple[str, float]]:
    """Yield numbers such as `Cal.GAIN` and `CAL.gain`: of classes without bases, and of single dataclass objects.

    A file that assigns an attribute of the same name anywhere has none of them, since it may change them.
    """
    stored = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute) and not isinstance(n.ctx, ast.Load)}
    names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    if names & {"setattr", "delattr", "vars", "exec", "eval"}:
        return
    fields: dict[str, dict[str, ast.expr | None]] = {}
    for item in tree.body:
        if isinstance(item, ast.ClassDef) and not (item.bases or item.keywords) and _is_plain_class(item):
            members = dict(_fields(item))
            if item.decorator_list:
                fields[item.name] = members
            for name, value in members.items():
                number = number_of(value, constants)
                if number is not None and name not in stored:
                    yield f"{item.name}.{name}", number
    for name, value in _assigned_once(tree):
        if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id in fields:
            members = fields[value.func.id]
            given = dict(zip(members, value.args, strict=False)) | {
                str(each.arg): each.value for each in value.keywords
            }
            for member, default in members.items():
                number = number_of(given.get(member, default), constants)
                if number is not None and member not in stored:
                    yield f"{name}.{member}", number


def _is_plain_class(tree: ast.ClassDef) -> bool:
    """Return True for a class whose attributes are what it writes: with no decorator but `dataclass`."""
    decorators = [ast.unparse(each).partition("(")[0] for each in tree.decorator_list]
    methods = {item.name for item in tree.body if isinstance(item, ast.FunctionDef)}
    special = {"__init__", "__new__", "__post_init__", "__getattr__", "__getattribute__", "__init_subclass__"}
    return all(each in ("dataclass", "dataclasses.dataclass") for each in decorators) and not methods & special


def _fields(tree: ast.ClassDef) -> Iterator[tuple[str, ast.expr | None]]:
    for item in tree.body:
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            yield item.target.id, item.value
        elif isinstance(item, ast.Assign) and not tree.decorator_list:
            yield from ((target.id, item.value) for target in item.targets if isinstance(target, ast.Name))


def _lists(
    tree: ast.Module, constants: dict[str, float], modules: dict[str, str]
) -> Iterator[tuple[str, tuple[float, ...]]]:
    # a list whose elements or methods are named otherwise than to read them may change
    changed = {
        node.value.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute | ast.Subscript) and isinstance(node.value, ast.Name)
        if isinstance(node, ast.Attribute) or not isinstance(node.ctx, ast.Load)
    }
    for name, value in _assigned_once(tree):
        match value:
            case ast.Call(func=ast.Attribute(value=ast.Name(id=module), attr="array"), args=[inner], keywords=[]):
                items = inner if modules.get(module) == "numpy" else value
            case _:
                items = value
        if isinstance(items, ast.List | ast.Tuple) and name not in changed:
            yield from _numbers_of_list(name, items, constants)


def _numbers_of_list(
    name: str, items: ast.List | ast.Tuple, constants: dict[str, float]
) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Yield the numbers of a list, or those of each row of a table, as `T[0]`, `T[1]`, ..."""
    if items.elts and all(isinstance(row, ast.List | ast.Tuple) for row in items.elts):
        rows = [(f"{name}[{at}]", row) for at, row in enumerate(items.elts) if isinstance(row, ast.List | ast.Tuple)]
    else:
        rows = [(name, items)]
    result = {}
    for label, row in rows:
        numbers = [number_of(item, constants) for item in row.elts]
        result[label] = tuple(float(number) for number in numbers if number is not None)
        if len(result[label]) < len(numbers):
            return
    yield from result.items()


def _closures(
    tree: ast.Module, functions: dict[str, ast.FunctionDef], constants: dict[str, float]
) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Yield functions as `gain = amplifier(2.0)` makes them, with the body of `amplifier` before their own."""
    for name, value in _assigned_once(tree):
        if not isinstance(value, ast.Call) or not isinstance(value.func, ast.Name) or value.keywords:
            continue
        maker = functions.get(value.func.id)
        if maker is None or len(value.args) != len(maker.args.args) or maker.args.defaults or not maker.body:
            continue
        if all(number_of(argument, constants) is not None for argument in value.args):
            closure = _closure(name, maker, value.args)
            if closure is not None:
                yield name, closure


def _closure(name: str, maker: ast.FunctionDef, values: list[ast.expr]) -> ast.FunctionDef | None:
    """Return the function that a function returns, as one that runs the latter first."""
    inner = {item.name: item.args for item in maker.body if isinstance(item, ast.FunctionDef)}
    last, body = maker.body[-1], list(maker.body[:-1])
    match last:
        case ast.Return(value=ast.Lambda(args=arguments) as made):
            body.append(ast.Assign([ast.Name("%made", ast.Store())], made))
            called = "%made"
        case ast.Return(value=ast.Name(id=called)) if called in inner:
            arguments = inner[called]
        case _:
            return None
    # names of its own, as an argument of the inner function may have that of an argument of the outer one
    own = [ast.arg(f"%{at}") for at in range(len(arguments.args))]
    bound = [
        ast.Assign([ast.Name(each.arg, ast.Store())], value)
        for each, value in zip(maker.args.args, values, strict=True)
    ]
    call = ast.Call(ast.Name(called, ast.Load()), [ast.Name(each.arg, ast.Load()) for each in own], [])
    result = ast.FunctionDef(
        name=name,
        args=ast.arguments([], own, None, [], [], None, list(arguments.defaults)),
        body=[*bound, *body, ast.Return(call)],
        decorator_list=[],
    )
    located = ast.copy_location(result, maker)
    return ast.fix_missing_locations(located)


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
            is_large = isinstance(default, ast.Constant) and isinstance(default.value, int)
            kind, remedy = (" that a double represents", "Write a float.") if is_large else ("", "Write a number.")
            message = f"the default of {argument.arg} must be a number{kind}, got {ast.unparse(default)[:40]}"
            findings.error(Location(path.name, default.lineno), message, remedy)
        yield FunctionInput(argument.arg, default=None if number is None else float(number))


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

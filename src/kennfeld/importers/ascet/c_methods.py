"""Methods in C: those whose meaning is known, those whose code is beside the class, and those that can be skipped."""

from functools import lru_cache
from pathlib import Path

from kennfeld.ascet import syntax as e
from kennfeld.ascet.c_body_parser import parse_c_body
from kennfeld.base.errors import Finding
from kennfeld.importers.ascet.declarations import read_source
from kennfeld.importers.ascet.functions import EXTERNAL
from kennfeld.importers.ascet.instances import ClassInstance
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError
from kennfeld.importers.rules import RuleFunction

_FOLDER = "_c_code_snippets"  # behind the name of a class


def known_rule(instance: ClassInstance, method: e.Method) -> RuleFunction | None:
    """Return the rule of a function of the mathematics library, by its symbol, or of one of SystemLib, by its name."""
    symbol = method.annotation("symbol")
    argument = symbol.arguments[0] if symbol is not None and symbol.arguments else None
    name = argument.value if isinstance(argument, e.Text) else ""
    rule = EXTERNAL.get(f"{instance.declared.label}.{method.name}") or EXTERNAL.get(name)
    return rule if rule is not None and rule.count == len(method.arguments) else None


def c_file(instance: ClassInstance, method: e.Method) -> Path | None:
    """Return the file with the code of a method in C; None if it is not beside the class."""
    folder = instance.scope.path.parent / f"{instance.declaration.name}{_FOLDER}"
    # the code of the implementation that the class chooses, else that for all of them
    implementation = instance.declaration.implementation
    paths = [folder / f"{method.name}.c"]
    if implementation:
        paths.insert(0, folder / implementation / f"{method.name}.c")
    return next((path for path in paths if path.is_file()), None)


def required_c_file(instance: ClassInstance, method: e.Method, place: e.TextPosition) -> Path:
    """Return the file with the code of a method in C.

    Raises:
        UnsupportedEsdlError: it is not beside the class; the error is that of a place that needs it.
    """
    path = c_file(instance, method)
    if path is None:
        raise UnsupportedEsdlError(_refusal(instance, method), place=place)
    return path


def c_body(instance: ClassInstance, method: e.Method, path: Path) -> e.Statements:
    """Return the statements of a method in C, from its file.

    Raises:
        UnsupportedEsdlError: the code has a part that is not supported.
    """
    body = _parsed(read_source(path), path.name)
    if isinstance(body, Finding):
        place = e.TextPosition(body.location.line, body.location.column, file=path.name)
        raise UnsupportedEsdlError(f"{_refusal(instance, method)}: {body.message}", body.remedy, place)
    return body


def _refusal(instance: ClassInstance, method: e.Method) -> str:
    return f"{instance.declared.name}.{method.name} is implemented in C, which is not supported"


@lru_cache(maxsize=64)
def _parsed(text: str, name: str) -> e.Statements | Finding:
    # a method is asked for when the steps of a class are chosen, where it is called, and when it is translated
    return parse_c_body(text, name)


def is_calculated(instance: ClassInstance, method: e.Method) -> bool:
    """Return True if a method becomes part of the graph, as far as its language is concerned."""
    if not method.is_in_c or known_rule(instance, method) is not None:
        return True
    path = c_file(instance, method)
    if path is None:
        return False
    try:
        c_body(instance, method, path)
    except UnsupportedEsdlError:
        return False
    return True


def changes_nothing(instance: ClassInstance, method: e.Method) -> bool:
    """Return True for a method that returns nothing and has no variable of ESDL to change, such as one of Assert."""
    declaration = instance.declaration
    # a variable of the class, an argument or a message could be changed; drivers and assertions have none
    return (
        method.result is None
        and all(argument.direction == "in" for argument in method.arguments)
        and all(element.kind for element in declaration.elements)
        and not declaration.writes
    )

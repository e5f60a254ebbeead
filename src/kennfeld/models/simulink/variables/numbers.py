"""Expressions that only numbers can tell, and scripts: by the evaluator of MATLAB, which executes nothing."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.matlab.errors import MatlabError
from kennfeld.matlab.evaluation import evaluate, names
from kennfeld.matlab.functions import REGISTERED
from kennfeld.matlab.objects import ENUMERATION, LookupTable, parameter_of
from kennfeld.matlab.parser import read_script
from kennfeld.matlab.scripts import run_script
from kennfeld.matlab.values import Cell, Struct, text
from kennfeld.matlab.values import Value as MatlabValue
from kennfeld.models.simulink.variables.scopes import Value, Variable

__all__ = ["Evaluated", "Unknown", "evaluated", "known", "made_by", "variable_from"]


class Evaluated(NamedTuple):
    """The value of an expression, and the variables that it took."""

    value: Value
    names: tuple[str, ...]


class Unknown(NamedTuple):
    """Why an expression has no value, and the variable that nothing gives one, if that is why."""

    why: str
    undefined: str = ""


def evaluated(tree: m.Expression, variable: Callable[[str], Value | None]) -> Evaluated | Unknown:
    """The value of an expression over the variables that `variable` gives, or why it has none."""
    given = {name: value for name in sorted(names(tree)) if (value := variable(name)) is not None}
    try:
        found = known(evaluate(tree, given, {"get_param": _asked, "eval": _meant}))
    except MatlabError as error:
        missing = [name for name in sorted(names(tree)) if name not in given and name not in REGISTERED]
        return Unknown(error.findings[0].what, missing[0] if missing else "")
    return Evaluated(found, tuple(given)) if found is not None else Unknown("its value is neither numbers nor text")


def made_by(code: str, variable: Callable[[str], Value | None]) -> dict[str, Value]:
    """The variables that a text of MATLAB makes of those that `variable` gives."""
    script, _ = read_script(code)
    wanted = sorted(_taken(script.statements))
    given = {name: value for name in wanted if (value := variable(name)) is not None}
    outcome = run_script(code, "mask", given, functions={"get_param": _asked, "eval": _meant})
    values = {name: known(value) for name, value in outcome.variables.items()}
    return {name: value for name, value in values.items() if value is not None}


def _asked(holder: MatlabValue, key: MatlabValue) -> MatlabValue:
    """A text that a model says of itself."""
    said = holder.fields.get(text(key)) if isinstance(holder, Struct) else None
    if said is None:
        raise MatlabError.at("mask", m.Place(), f"get_param asks for {text(key)[:40]}, which only Simulink can tell")
    return said


def _meant(written: MatlabValue) -> MatlabValue:
    """The value of an expression without variables."""
    return evaluate(text(written))


def _taken(statements: object) -> frozenset[str]:
    """All names in statements."""
    if isinstance(statements, m.Expression):
        return names(statements)
    if isinstance(statements, tuple):
        return frozenset().union(*map(_taken, statements))
    if is_dataclass(statements):
        return frozenset().union(*(_taken(getattr(statements, one.name)) for one in fields(statements)))
    return frozenset()


def known(value: Any) -> Value | None:
    """A value of MATLAB as blocks use it; None for what they cannot."""
    found = variable_from(value, "")
    return found.value if found is not None else None


def variable_from(value: Any, source: str) -> Variable | None:
    """A variable with the limits, unit and description that an object has."""
    meant = parameter_of(value)
    if meant is not None:
        held: Value = _table(meant) if isinstance(meant, LookupTable) else np.asarray(meant.value, dtype=np.float64)
        made = Variable(held, unit=meant.unit, description=meant.description, source=source)
        return made.limited(meant.min, meant.max)
    plain = _plain(value)
    fixed = isinstance(value, Struct) and value.kind == ENUMERATION
    return Variable(plain, source=source, fixed=fixed) if plain is not None else None


def _table(meant: LookupTable) -> dict[str, Value]:
    points = {f"Breakpoints{i + 1}": np.asarray(one.value) for i, one in enumerate(meant.breakpoints)}
    return {"Table": np.asarray(meant.value, dtype=np.float64), **points}


def _plain(value: Any) -> Value | None:
    if isinstance(value, Struct):
        return _struct(value)
    if isinstance(value, Cell):
        parts = [known(part) for part in value.values.ravel(order="F")]
        return tuple(part for part in parts if part is not None)
    if not isinstance(value, np.ndarray):
        return None
    if value.dtype.kind == "U":
        return "".join(value.ravel())
    if value.dtype.kind == "O":
        return str(value.ravel()[0]) if value.size == 1 else tuple(map(str, value.ravel(order="F")))
    return np.asarray(value, dtype=np.float64)


def _struct(value: Struct) -> Value:
    elements = [
        {name: part for name, inner in one.items() if (part := known(inner)) is not None}
        for one in value.elements.ravel(order="F")
    ]
    return elements[0] if len(elements) == 1 else tuple(elements)

"""The variables of an FMU of a function, with their value references, in the order of the description."""

import re
from collections.abc import Iterator
from itertools import product
from typing import Literal, NamedTuple

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import one_line
from kennfeld.export.prepared import PreparedFunction
from kennfeld.graph.node import CLOCK
from kennfeld.graph.traversal import ancestors

Causality = Literal["input", "output", "parameter", "independent"]
TIME = "time"
_STRUCTURED = re.compile(r"(der\()?[A-Za-z_]\w*(\[\d+(,\d+)*\])?(\.[A-Za-z_]\w*(\[\d+(,\d+)*\])?)*\)?", re.ASCII)


class ExportedVariable(NamedTuple):
    """A variable of an FMU.

    Attributes:
        name: its name in the function, with indices from 1 if it is a value of a table.
        causality: as the standard calls it.
        member: expression of its place in the struct, such as `MapX[3]`.
        size: number of its values.
        start: its values, Float[shape]; None for an output.
        unit: its unit.
        description: what it is.
    """

    name: str
    causality: Causality
    member: str
    size: int = 1
    start: Float | None = None
    unit: str = ""
    description: str = ""


def interface_of(function: PreparedFunction, *, arrays: bool) -> tuple[ExportedVariable, ...]:
    """Return the variables; with `arrays`, a table is one variable, else each of its values is."""
    inputs = [
        ExportedVariable(u.name, "input", u.member, start=np.zeros(()), unit=one_line(u.unit))
        for u in function.inputs
        if u.name not in CLOCK
    ]
    outputs = [ExportedVariable(y.name, "output", y.member, unit=one_line(y.unit)) for y in function.outputs]
    # FMI 3.0 requires a variable for the time, FMI 2.0 does not
    time = [ExportedVariable(TIME, "independent", "", unit="s")] if arrays else []
    return (*inputs, *outputs, *_parameters(function, arrays), *time)


def _parameters(function: PreparedFunction, arrays: bool) -> Iterator[ExportedVariable]:
    for p in function.parameters:
        size, texts = p.values.size, (one_line(p.unit), one_line(p.remark))
        if not p.shape:
            yield ExportedVariable(p.name, "parameter", p.member, 1, p.values, *texts)
        elif arrays:
            yield ExportedVariable(p.name, "parameter", p.member, size, p.values, *texts)
        else:
            # rows first, as the standard counts them and as the values lie in memory
            for at, index in enumerate(product(*(range(count) for count in p.shape))):
                name = f"{p.name}[{','.join(str(i + 1) for i in index)}]"
                yield ExportedVariable(name, "parameter", f"{p.member}[{at}]", 1, p.values[index], *texts)


def input_dependencies(function: PreparedFunction, output: int) -> tuple[str, ...]:
    """Return the names of the inputs from which an output is computed within a step."""
    needed = ancestors(function.nodes, [function.roots[output]])
    used = {function.nodes[at].payload for at in needed if function.nodes[at].op == "input"}
    return tuple(u.name for u in function.inputs if u.name in used and u.name not in CLOCK)


def naming_convention(variables: tuple[ExportedVariable, ...]) -> Literal["structured", "flat"]:
    """Return the naming convention that all names follow."""
    return "structured" if all(_STRUCTURED.fullmatch(v.name) for v in variables) else "flat"

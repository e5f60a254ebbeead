"""Formula texts of any length: arithmetic, functions, lookups and a few states, all of it needed by the one output."""

import random

import numpy as np

from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map, Parameter, Scalar

__all__ = ["INPUTS", "parameters", "text"]

INPUTS = ("u", "v", "w")
CURVES, MAPS, SCALARS = 12, 8, 20
RECENT = 25  # how far back a line reads


def text(nodes: int, states: int = 5, seed: int = 0) -> str:
    """A formula text whose graph has about `nodes` nodes."""
    draw = random.Random(seed)
    names: list[str] = list(INPUTS)
    unread: dict[str, None] = {}
    lines, count = [], 0
    lags = {round(nodes * (i + 0.5) / states) for i in range(states)}
    while count < nodes - 2 * len(unread):
        name = f"n{len(lines)}"
        due = {at for at in lags if at <= count}
        lags -= due
        expression, cost = ("PT1({}, 0.5)", 6) if due else _line(draw)
        wanted = expression.count("{}")
        operands = [draw.choice(names[-RECENT:]) for _ in range(wanted)]
        if len(unread) > RECENT:
            operands[0] = next(iter(unread))
        for operand in operands:
            unread.pop(operand, None)
        lines.append(f"{name} = {expression.format(*operands)}")
        names.append(name)
        unread[name] = None
        count += cost
    return "\n".join([*lines, f"y = ({' + '.join(unread)}) / {len(unread)}"]) + "\n"


def _line(draw: random.Random) -> tuple[str, int]:
    """An expression whose value stays small, and about how many nodes it makes."""
    kind = draw.random()
    if kind < 0.06:
        return f"C{draw.randrange(CURVES)}({{}})", 1
    if kind < 0.1:
        return f"M{draw.randrange(MAPS)}({{}}, {{}})", 1
    if kind < 0.2:
        return f"K{draw.randrange(SCALARS)} * {{}} + {draw.uniform(-1, 1):.3f}", 4
    if kind < 0.35:
        return f"{draw.choice(('sin', 'cos', 'tanh', 'atan'))}({{}} + {draw.uniform(-1, 1):.3f})", 3
    if kind < 0.4:
        return "sqrt(1 + {}^2)", 4
    if kind < 0.5:
        return f"{draw.choice(('min', 'max'))}({{}}, {{}})", 1
    if kind < 0.55:
        return "if({} > {}, {}, {})", 2
    if kind < 0.7:
        return "{} / (1 + abs({}))", 3
    if kind < 0.85:
        return "0.7 * {} - 0.5 * {}", 3
    return "tanh({} * {})", 2


def parameters(seed: int = 0) -> ParameterSet:
    """The tables and scalars of these texts."""
    draw = np.random.default_rng(seed)
    x, y = Axis(np.linspace(-3, 3, 9)), Axis(np.linspace(-2, 2, 7))
    tables: list[Parameter] = [Curve(f"C{i}", x, draw.normal(0, 0.5, 9)) for i in range(CURVES)]
    tables += [Map(f"M{i}", x, y, draw.normal(0, 0.5, (9, 7))) for i in range(MAPS)]
    tables += [Scalar(f"K{i}", draw.uniform(-1, 1)) for i in range(SCALARS)]
    return ParameterSet(tables)

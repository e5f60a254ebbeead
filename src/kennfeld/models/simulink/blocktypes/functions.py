"""MATLAB Function blocks: assignments, decisions, loops with fixed bounds, and elementary functions.

Both sides of a decision are built; each variable then takes the side whose condition holds. Loops are unrolled.
"""

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_script
from kennfeld.models.simulink.blocktypes.registry import UnsupportedError, block
from kennfeld.models.simulink.expressions import NoValueError, each
from kennfeld.models.simulink.signals import Nodes, Signal, Wired, fastest
from kennfeld.models.simulink.site import Site, as_vector

_MOST_STATEMENTS = 20_000
_MEND = "Draw it as blocks, or bind its outputs."


@block("MATLAB Function")
def matlab_function(site: Site) -> tuple[Wired, ...]:
    """What the function's results are, in the order in which it names them."""
    try:
        script = parse_script(site.atom.block.script, site.atom.path)
    except InputError as error:
        raise UnsupportedError(str(error.findings[0]), _MEND) from None
    if not script.functions or script.statements:
        raise UnsupportedError("its code is no function", _MEND)
    function, inputs = script.functions[0], site.inputs
    names = {name: _matrix(one.nodes) for name, one in zip(function.parameters, inputs, strict=False)}
    work = _Body(site, names)
    work.run(function.body)
    period = fastest([one.period for one in inputs])
    return tuple(work.result(name, period) for name in function.results)


def _matrix(nodes: Nodes) -> Nodes:
    return nodes.reshape(-1, 1) if nodes.ndim == 1 else nodes


class _Body:
    """The statements of a function, and its variables so far."""

    def __init__(self, site: Site, names: dict[str, Nodes], done: list[int] | None = None) -> None:
        self.site = site
        self.names = names
        self.done = done if done is not None else [0]

    def run(self, body: tuple[m.Statement, ...]) -> None:
        """Follow statements."""
        for statement in body:
            self.done[0] += 1
            if self.done[0] > _MOST_STATEMENTS:
                raise UnsupportedError(f"its code unfolds to more than {_MOST_STATEMENTS} statements", _MEND)
            self._statement(statement)

    def result(self, name: str, period: float) -> Signal:
        """A variable as an output."""
        if name not in self.names:
            raise UnsupportedError(f"its code gives {name} no value, or not in every case", _MEND)
        return Signal(as_vector(self.names[name]), period)

    def _statement(self, statement: m.Statement) -> None:
        match statement:
            case m.Assign((target,), value):
                self._assign(target, self._value(value))
            case m.If(branches, otherwise):
                self._if(branches, otherwise)
            case m.For(m.Name(name), values, body):
                for column in self._value(values).T:
                    self.names[name] = column.reshape(-1, 1)
                    self.run(body)
            case _:
                kind = type(statement).__name__.lower()
                raise UnsupportedError(f"its code has a statement that is not supported ({kind})", _MEND)

    def _value(self, tree: m.Expression) -> Nodes:
        try:
            return self.site.weaver.expressions.computed(tree, self.site.atom.scope, self.names)
        except NoValueError as error:
            raise UnsupportedError(f"its code in line {tree.place.line}: {error}", _MEND) from None

    def _assign(self, target: m.Expression | None, value: Nodes) -> None:
        if isinstance(target, m.Name):
            self.names[target.name] = value
        elif isinstance(target, m.Call) and isinstance(target.of, m.Name) and target.of.name in self.names:
            self._assign_element(target.of.name, target, value)
        else:
            raise UnsupportedError("its code assigns to what is no variable that is there already", _MEND)

    def _assign_element(self, name: str, target: m.Call, value: Nodes) -> None:
        places = [self._value(one) for one in target.arguments]
        array = self.names[name].copy()
        try:
            numbers = [int(self.site.weaver.expressions.values(one).item()) - 1 for one in places]
            at = np.unravel_index(numbers[0], array.shape, order="F") if len(numbers) == 1 else tuple(numbers)
            if min(numbers) < 0 or value.size != 1:
                raise ValueError
            array[at] = value.item()
        except (NoValueError, ValueError, IndexError):
            what = f"its code in line {target.place.line} assigns to elements of {name} that change or are not there"
            raise UnsupportedError(what, _MEND) from None
        self.names[name] = array

    def _if(self, branches: tuple[m.Branch, ...], otherwise: tuple[m.Statement, ...]) -> None:
        if not branches:
            self.run(otherwise)
            return
        condition = self._value(branches[0].condition)
        if condition.size != 1:
            raise UnsupportedError("its code decides by a condition of several elements", _MEND)
        yes, no = (_Body(self.site, dict(self.names), self.done) for _ in range(2))
        fixed = self.site.loom.value(int(condition.item()))
        if fixed is None or fixed:
            yes.run(branches[0].body)
        if not fixed:
            no._if(branches[1:], otherwise)
        if fixed is not None:
            self.names = yes.names if fixed else no.names
        else:
            self.names = self._joined(condition, yes.names, no.names)

    def _joined(self, condition: Nodes, yes: dict[str, Nodes], no: dict[str, Nodes]) -> dict[str, Nodes]:
        """The variables after a decision; one that only one side knows is known no more."""
        made: dict[str, Nodes] = {}
        for name in yes.keys() & no.keys():
            if np.array_equal(yes[name], no[name]):
                made[name] = yes[name]
            elif yes[name].shape == no[name].shape:
                made[name] = each(self.site.loom, "select", condition, yes[name], no[name])
        return made

"""Functions of a chart, drawn as flow charts or written as code: each call has variables of its own."""

from dataclasses import replace
from typing import TYPE_CHECKING

from kennfeld.errors import InputError
from kennfeld.matlab.parser import parse_script
from kennfeld.models.simulink.code.errors import MEND
from kennfeld.models.simulink.expressions.signals import Nodes
from kennfeld.models.simulink.stateflow.context import Context
from kennfeld.models.simulink.stateflow.diagram import Function
from kennfeld.models.simulink.stateflow.guards import Guard
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.execution import Machine

__all__ = ["Functions"]


class Functions:
    """The functions of a machine's chart."""

    def __init__(self, machine: "Machine") -> None:
        self.machine = machine
        self.diagram = machine.diagram
        self.variables = machine.variables
        self._frames = 0

    def call(
        self, function: Function, given: list[Nodes | None], context: Context, guard: Guard
    ) -> tuple[list[Nodes], Guard | None]:
        """Run a function of the chart; what it gives, and the guard where it comes back."""
        if function.refused:
            raise UnsupportedError(f"{function.name} is {function.refused}, which is not supported", MEND)
        if len(given) > len(function.parameters):
            raise UnsupportedError(f"{context.place}: {function.name} is given {len(given)} values")
        with self.machine.deeper(f"calls {function.name}"):
            frame, after = self._followed(function, given, context, guard)
        results = [f"{frame}.{name}" for name in function.results]
        missing = [name for name in results if name not in self.variables]
        if missing and after is not None:
            raise UnsupportedError(f"its function {function.name} gives {missing[0].split('.')[-1]} no value")
        return [self.variables.values[name] for name in results], after

    def _followed(
        self, function: Function, given: list[Nodes | None], context: Context, guard: Guard
    ) -> tuple[str, Guard | None]:
        """Follow a function; the frame that its variables are in, and the guard where it comes back."""
        self._frames += 1
        frame = f"{function.name}#{self._frames}"
        here = replace(context, scope=function.state, frame=frame, place=f"its function {function.name}")
        here = replace(here, alive=lambda found: found)
        self._bind(function, frame, given)
        after = self._coded(function, here, guard) if function.script else self._drawn(function, here, guard)
        return frame, after

    def _bind(self, function: Function, frame: str, given: list[Nodes | None]) -> None:
        for name, nodes in zip(function.parameters, given, strict=False):
            if nodes is not None:
                self.variables.values[f"{frame}.{name}"] = nodes
        if function.script:
            return
        for data in self.diagram.data.values():
            mine = self.diagram.holder(data.written.parent) is function.state
            if mine and data.written.scope in ("FUNCTION_OUTPUT_DATA", "TEMPORARY_DATA"):
                start = self.variables.values[data.key]
                self.variables.values[f"{frame}.{data.written.name}"] = start

    def _drawn(self, function: Function, context: Context, guard: Guard) -> Guard | None:
        self.machine.flow(function.state, context, guard)
        return guard

    def _coded(self, function: Function, context: Context, guard: Guard) -> Guard | None:
        try:
            script = parse_script(function.script, function.name)
        except InputError as error:
            raise UnsupportedError(f"its function {function.name}: {error.findings[0].what}") from None
        found = next((one for one in script.functions if one.name == function.name), None)
        if found is None:
            raise UnsupportedError(f"the code of its function {function.name} defines no function of that name")
        for name, other in zip(found.parameters, function.parameters, strict=False):
            value = self.variables.values.get(f"{context.frame}.{other}")
            if value is not None:
                self.variables.values[f"{context.frame}.{name}"] = value
        after = self.machine.statements.function(found.body, context, guard)
        for name, other in zip(found.results, function.results, strict=False):
            value = self.variables.values.get(f"{context.frame}.{name}")
            if value is not None:
                self.variables.values[f"{context.frame}.{other}"] = value
        return after

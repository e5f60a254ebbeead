"""Nodes of calls of FMUs for co-simulation: a state holds the ticket of the trajectory, which each step states.

A step takes the inputs of the sample before, which states hold, so that inputs may depend on the outputs of the same
sample. At the start, an input that does so has the start value that the FMU states.

Kennfeld solves continuous states by several evaluations within a step, but the FMU advances once a step. Its outputs
are therefore held.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from kennfeld.base.errors import InputError, Location
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.external_function import ExternalFunction
from kennfeld.importers.fmu.description import FmuDescription, FmuVariable
from kennfeld.importers.fmu.fmu_parameters import ParameterValue
from kennfeld.importers.fmu.trajectories import inputs_of, outputs_of, trajectory_layout
from kennfeld.models.model_function import Deferred

_MODULE = "kennfeld.importers.fmu.trajectories"


class TrajectoryCalls:
    """Writes the nodes of calls of an FMU.

    Args:
        description: the FMU.
        values: its parameters and the start values of its states.
        path: its file.
        arguments: whole path, digest, and names of further outputs.
    """

    def __init__(
        self,
        description: FmuDescription,
        values: Sequence[ParameterValue],
        path: Path,
        arguments: tuple[str, str, str],
    ) -> None:
        layout = trajectory_layout(description, "")
        self.path, self.values, self.single = path, tuple(values), layout.slots == 1
        self.inputs = _order(description.number_inputs, inputs_of(description))
        self.starts = [v.start_of(k) for v in inputs_of(description) for k in range(v.size)]
        self.outputs = _order(outputs_of(description), description.number_outputs)
        taken = 2 + layout.arguments
        function = partial(ExternalFunction, native=True)
        self.start = function(f"{path.stem} start", taken + layout.set_at_start, 1, f"{_MODULE}:load_start", arguments)
        self.step = function(path.stem, taken, layout.results, f"{_MODULE}:load_step", arguments, sequential=True)

    def write(self, builder: GraphBuilder, arguments: Sequence[int | Deferred]) -> Sequence[int]:
        """Add the nodes of one step, and return those of the outputs.

        Raises:
            InputError: the FMU allows one instance only, and the graph already has a call.
        """
        time, place = builder.time(), self._place(builder)
        inputs = [_before(builder, arguments[at], start) for at, start in zip(self.inputs, self.starts, strict=True)]
        parameters = [builder.lookup(v.parameter, *map(builder.const, v.coordinates)) for v in self.values]
        # the start has one result, the ticket: what depends on it is initialized after it, in the same instance
        (first,) = builder.external(self.start, builder.const(float(place)), time, *inputs, *parameters)
        # a state, because all steps of a piece of data go to one trajectory, and each piece starts anew
        ticket = builder.state()
        builder.close(ticket, first, ticket)
        results = builder.external(self.step, ticket, time, *inputs)
        return [builder.node("hold", (results[position],)) for position in self.outputs]

    def _place(self, builder: GraphBuilder) -> int:
        """Return the number of a call, different for all calls of a graph."""
        # equal calls are one node: their arguments tell calls apart
        starts = {n.args for n in builder.nodes if n.op == "external" and n.payload.function == self.start}
        places = [builder.value(args[0]) or 0.0 for args in starts]
        if self.single and places:
            message = "allows one instance in a process, so that formula text can call it with the same inputs only"
            raise InputError.of(Location(self.path.name), message, "Name its inputs, and call it with these.")
        return int(max(places, default=-1.0)) + 1


def _before(builder: GraphBuilder, x: int | Deferred, start: float) -> int:
    """Return the value of an input at the sample before; at the first sample, its value there or else `start`."""
    return builder.remember_input(x, start, 1) if callable(x) else builder.prev(x, x)


def _order(variables: Sequence[FmuVariable], other: Sequence[FmuVariable]) -> list[int]:
    """Return for each value of the other variables its position among the values of variables."""
    positions: dict[str, int] = {}
    for variable in variables:
        for element in variable.elements:
            positions[element] = len(positions)
    return [positions[element] for variable in other for element in variable.elements]

"""Nodes of calls of FMUs for co-simulation: a state holds the ticket of the trajectory, which each step states.

Kennfeld solves continuous states by several evaluations within a step, but the FMU advances once a step. Its outputs
are therefore held.
"""

from collections.abc import Sequence
from pathlib import Path

from kennfeld.errors import InputError, Location
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.external_function import ExternalFunction
from kennfeld.models.fmu.description import FmuDescription, FmuVariable
from kennfeld.models.fmu.fmu_parameters import ParameterValue
from kennfeld.models.fmu.trajectories import inputs_of, outputs_of, trajectory_layout

_MODULE = "kennfeld.models.fmu.trajectories"


class TrajectoryCalls:
    """Writes the nodes of calls of an FMU; `values` are its parameters and the start values of its states."""

    def __init__(self, description: FmuDescription, values: Sequence[ParameterValue], path: Path, digest: str) -> None:
        layout = trajectory_layout(description, "")
        arguments = (str(path.resolve()), digest)
        self.path, self.values, self.single = path, tuple(values), layout.slots == 1
        self.inputs = _order(description.number_inputs, inputs_of(description))
        self.outputs = _order(outputs_of(description), description.number_outputs)
        taken = 2 + layout.arguments
        self.start = ExternalFunction(
            f"{path.stem} start", taken + layout.set_at_start, 1, f"{_MODULE}:load_start", arguments
        )
        self.step = ExternalFunction(
            path.stem, taken, layout.results, f"{_MODULE}:load_step", arguments, sequential=True
        )

    def write(self, builder: GraphBuilder, arguments: Sequence[int]) -> Sequence[int]:
        """Add the nodes of one step, and return those of the outputs.

        Raises:
            InputError: the FMU allows one instance only, and the graph already has a call.
        """
        time, place = builder.input("t"), self._place(builder)
        inputs = [arguments[position] for position in self.inputs]
        parameters = [builder.lookup(v.parameter, *map(builder.const, v.coordinates)) for v in self.values]
        (first,) = builder.external(self.start, builder.const(float(place)), time, *inputs, *parameters)
        ticket = builder.state()
        builder.close(ticket, first, ticket)
        results = builder.external(self.step, ticket, time, *inputs)
        return [builder.node("hold", (results[position],)) for position in self.outputs]

    def _place(self, builder: GraphBuilder) -> int:
        """Return the number of a call, different for all calls of a graph."""
        starts = {n.args for n in builder.nodes if n.op == "external" and n.payload.function == self.start}
        places = [builder.value(args[0]) or 0.0 for args in starts]
        if self.single and places:
            message = "allows one instance in a process, so that formula text can call it with the same inputs only"
            raise InputError.of(Location(self.path.name), message, "Name its inputs, and call it with these.")
        return int(max(places, default=-1.0)) + 1


def _order(variables: Sequence[FmuVariable], other: Sequence[FmuVariable]) -> list[int]:
    """Return for each value of the other variables its position among the values of variables."""
    positions: dict[str, int] = {}
    for variable in variables:
        for element in variable.elements:
            positions[element] = len(positions)
    return [positions[element] for variable in other for element in variable.elements]

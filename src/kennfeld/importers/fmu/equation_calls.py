"""Nodes of calls of FMUs for model exchange: states of the model, and the equations that give their derivatives."""

from collections.abc import Sequence
from functools import partial
from itertools import islice
from pathlib import Path

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.external_function import ExternalFunction
from kennfeld.importers.fmu.description import FmuDescription
from kennfeld.importers.fmu.fmu_parameters import ParameterValue
from kennfeld.importers.fmu.instance import layout_of

_MODULE = "kennfeld.importers.fmu.instance"
_UNLIMITED = float("inf")


class EquationCalls:
    """Writes the nodes of calls of an FMU.

    Args:
        description: the FMU.
        values: the values of parameters, in the order in which the code takes them.
        start_values: those of states at the start.
        arguments: path, digest, names of further outputs, and 1 if the outputs may depend on the time.
    """

    def __init__(
        self,
        description: FmuDescription,
        values: Sequence[ParameterValue],
        start_values: Sequence[ParameterValue],
        arguments: tuple[str, str, str, int],
    ) -> None:
        layout = layout_of(description, "")
        name, self.timed = Path(arguments[0]).stem, arguments[3] == 1
        taken, self.states = layout.arguments, layout.states
        self.values, self.start_values = values, start_values
        self.description = description
        self.order = _input_order(description)
        self.jumps = layout.jumps
        function = partial(ExternalFunction, native=True)
        self.equations = function(name, taken, layout.results, f"{_MODULE}:load_equations", arguments)
        started = layout.start_arguments
        self.start = function(f"{name} start", started, layout.states, f"{_MODULE}:load_start", arguments[:3])
        self.events = function(f"{name} events", taken, layout.states, f"{_MODULE}:load_events", arguments[:3])

    def write(self, builder: GraphBuilder, arguments: Sequence[int]) -> Sequence[int]:
        """Add the nodes of one step, and return those of the outputs.

        Args:
            builder: builder of the graph.
            arguments: nodes of the elements of the inputs, in the order of the description.
        """
        time = builder.time() if self.timed else builder.const(0.0)
        inputs = [arguments[number] for number in self.order]
        parameters, starts = (_look_up(builder, values) for values in (self.values, self.start_values))
        states = [builder.state() for _ in range(self.states)]
        x: Sequence[int] = states
        if self.jumps:  # events change the states at samples, not within steps
            x = builder.external(self.events, time, *states, *inputs, *parameters)
        results = builder.external(self.equations, time, *x, *inputs, *parameters)
        limits = builder.const(-_UNLIMITED), builder.const(_UNLIMITED)
        # the FMU itself computes the states at the start, by its initial equations
        first = builder.external(self.start, time, *inputs, *parameters, *starts) if states else ()
        for state, start, now, derivative in zip(states, first, x, results, strict=False):
            builder.close(state, start, builder.node("advance", (now, derivative, *limits)))
        return self._outputs(x, results)

    def _outputs(self, states: Sequence[int], results: Sequence[int]) -> Sequence[int]:
        """Return the nodes of the outputs, of which some are states or their derivatives."""
        # an output that is a state is its node, of which the derivative along the state is exact
        nodes, remaining = iter((*states, *results[: self.states])), iter(results[self.states :])
        known = (*self.description.states, *(d.variable for d in self.description.derivatives))
        own = {v.reference: list(islice(nodes, v.size)) for v in known}
        others = {output.name: list(islice(remaining, output.size)) for output in self.description.computed_outputs}
        outputs = self.description.number_outputs
        return [node for y in outputs for node in (others[y.name] if y.name in others else own[y.reference])]


def _look_up(builder: GraphBuilder, values: Sequence[ParameterValue]) -> list[int]:
    return [builder.lookup(value.parameter, *map(builder.const, value.coordinates)) for value in values]


def _input_order(description: FmuDescription) -> list[int]:
    """Return the numbers of the elements of inputs in the order in which the code takes them."""
    inputs = description.number_inputs
    numbers, sizes = iter(range(sum(v.size for v in inputs))), {v.name: v.size for v in inputs}
    places = {name: list(islice(numbers, size)) for name, size in sizes.items()}
    return [number for variable in description.sorted_by_type(inputs) for number in places[variable.name]]

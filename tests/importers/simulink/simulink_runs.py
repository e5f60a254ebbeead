"""Runs models of blocks: one block between inports and outports, or a whole drawing, through the interpreter."""

import numpy as np

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.interpreter import Interpreter, evaluate
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.graph.node import extract
from kennfeld.importers.simulink.importing import simulink
from kennfeld.native.simulator import Simulator
from tests.clocks import even_clock
from tests.importers.simulink.simulink_files import Model


def alone(kind, /, inputs=1, outputs=1, *, model=None, special=None, **parameters):
    """A model of one block "B" with inports u1, u2, ... and outports y1, y2, ..."""
    drawn = model or Model(step="0.1", solver="FixedStepDiscrete")
    if special:
        drawn.link("B", "lib/B", special, ports=(inputs, outputs), **parameters)
    else:
        drawn.block(kind, "B", ports=(inputs, outputs), **parameters)
    drawn.between([f"u{at}" for at in range(1, inputs + 1)], "B", [f"y{at}" for at in range(1, outputs + 1)])
    return drawn


def switch_case(conditions, *values):
    """A drawing of a Switch Case over u whose cases, the last one by default, each give y a value."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("SwitchCase", "Case", ports=(1, len(values)), CaseConditions=conditions)
    drawn.line("u", "Case")
    drawn.block("Merge", "M", ports=(len(values), 1), Inputs=str(len(values)))
    for at, value in enumerate(values, 1):
        inner = drawn.subsystem(f"A{at}")
        inner.block("ActionPort", "P")
        inner.block("Constant", "C", Value=str(value))
        inner.outport("y")
        inner.chain("C", "y")
        drawn.line(f"Case:{at}", f"A{at}#ifaction")
        drawn.line(f"A{at}", f"M:{at}")
    drawn.outport("y")
    drawn.line("M", "y")
    return drawn


def imported(drawn, folder, layout="slx parts", **options):
    """The model of a drawing."""
    return simulink(drawn.write(folder, layout), **options)


def run(model, columns=None, dt=0.1, parameters=None, samples=None):
    """The values of all nodes over the samples, by name."""
    inputs = {name: np.asarray(column, dtype=float) for name, column in (columns or {}).items()}
    count = samples or next(iter(inputs.values())).size
    step = model.step or dt
    return evaluate(model.graph, {**inputs, **even_clock(step, count)}, parameters or model.values)


def run_natively(model, columns, dt=0.1):
    """The values of all named nodes over the samples, by machine code: for many samples of large models."""
    columns = {name: np.asarray(column, dtype=float) for name, column in columns.items()}
    count = next(iter(columns.values())).size
    step = model.step or dt
    lowered = lower_lookups(model.graph, model.values)
    simulator = Simulator(lowered, list(lowered.graph.names.values()), model.values)
    values = simulator.over({**columns, **even_clock(step, count)}, count, model.values, (0,))
    return dict(zip(lowered.graph.names, values, strict=True))


def slopes(model, columns, name, output, dt=0.1):
    """The derivatives of an output with respect to the values of a parameter: exact, and by central differences.

    Each is Float[samples, values].
    """
    inputs = {key: np.asarray(column, dtype=float) for key, column in columns.items()}
    count = next(iter(inputs.values())).size
    step = model.step or dt
    full = {**inputs, **even_clock(step, count)}
    lowered = lower_lookups(model.graph, model.values)
    line = differentiate(lowered.graph, [lowered.graph.names[output]], (name,))
    exact = Interpreter(lowered, model.values).rows(line, {name: 0}, full)
    return exact.jacobian[:, 0, :], _differences(lowered, model.values, full, name, output)


def _differences(lowered, parameters, columns, name, output):
    parameter, graph = parameters[name], lowered.graph
    part = extract(graph.nodes, graph.states, {output: graph.names[output]}, {}, ())
    slopes_of_values = []
    for place in range(parameter.size):
        ends = []
        for sign in (1, -1):
            values = parameter.values.ravel().copy()
            values[place] += sign * 1e-5
            changed = ParameterSet(
                parameter.with_values(values) if each.name == name else each for each in parameters.values()
            )
            ends.append(Interpreter(lowered, changed).run(part.nodes, part.states, columns)[part.names[output]])
        slopes_of_values.append((ends[0] - ends[1]) / 2e-5)
    return np.stack(slopes_of_values, axis=1)


def crossings(x):
    """Where a signal crosses zero as a trigger sees it, rising and falling: it may come to rest at zero on the way."""
    rising, falling = np.zeros(len(x), dtype=bool), np.zeros(len(x), dtype=bool)
    side = np.sign(x[0])
    came = 0  # 1 or -1 while at zero that was reached in the step before, from below or above
    for k in range(1, len(x)):
        now = np.sign(x[k])
        rising[k] = (side < 0 <= now) or (side == 0 < now and came != 1)
        falling[k] = (side > 0 >= now) or (side == 0 > now and came != -1)
        came = -int(side) if now == 0 else 0
        side = now
    return rising, falling

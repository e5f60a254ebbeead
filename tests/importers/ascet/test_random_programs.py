"""Random ESDL classes: lowered, as formula text and compiled, against the same class in Python."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import event

from kennfeld.graph.derivative import differentiate
from kennfeld.graph.interpreter import Interpreter, evaluate
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.models.formula import formula, to_text
from kennfeld.native.simulator import Simulator
from tests.clocks import even_clock
from tests.draws import few_or_many
from tests.graph.noise import assert_close, spread, steady
from tests.importers.ascet.esdl_projects import class_model, run
from tests.importers.ascet.random_programs import classes_of_methods, programs, run_oracle

SAMPLES = 12
COLUMNS = {
    "x": np.array([0.5, -1.0, 2.0, 0.25, 3.5, -2.5, 0.0, 1.0, 1.5, -0.75, 4.0, 0.5]),
    "y": np.array([1.0, 0.0, -1.5, 2.0, 0.5, 0.5, -3.0, 1.0, 0.0, 2.5, -0.5, 1.25]),
    "on": np.array([1, 0, 0, 1, 1, 0, 1, 0, 0, 1, 0, 1], dtype=float),
}
CLOCK = even_clock(0.1, SAMPLES)


def lowered(text):
    with tempfile.TemporaryDirectory() as folder:
        return class_model(Path(folder), text, class_name="Own")


def columns_of(model):
    """The column of each argument: those of a second method are named after it, `update.x`."""
    return {name: COLUMNS[name.rpartition(".")[2]] for name in model.graph.inputs}


def noisy(model):
    """Values of all named nodes with the change that rounding causes, and which of them can be compared."""
    low = lower_lookups(model.graph, model.values)
    interpreter = Interpreter(low, model.values)

    def names(each):
        values = each.run(low.graph.nodes, low.graph.states, {**COLUMNS, **columns_of(model), **CLOCK})
        return np.array([values[at] for at in low.graph.names.values()])

    exact = names(interpreter)
    change = spread(interpreter, names, exact)
    sound = steady(exact, change)
    # a state that rounding moved moves whatever follows
    return low, exact, change, np.logical_and.accumulate(sound.all(axis=0))[None, :] & sound


def assert_runs_like(model, expected):
    nodes = run(model, {**COLUMNS, **columns_of(model)})
    _, _, _, sound = noisy(model)
    event("steady" if sound.all() else "unsteady")
    for at, name in enumerate(model.graph.names):
        if name in expected:
            where = sound.all(axis=0) & sound[at]
            values = np.array(expected[name], dtype=float)
            np.testing.assert_allclose(nodes[name][where], values[where], rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.slow
@few_or_many(programs(), few=8, many=60)
def test_a_program_runs_like_the_same_program_in_python(program):
    text, code = program
    assert_runs_like(lowered(text), run_oracle(code, COLUMNS))


@few_or_many(classes_of_methods(), few=8, many=60)
def test_a_class_of_several_methods_runs_like_the_same_class_in_python(program):
    model = lowered(program.text)
    assert set(program.called) <= set(model.graph.outputs)
    assert_runs_like(model, run_oracle(program.python, COLUMNS, program.called))


@few_or_many(programs(), few=5, many=40)
def test_formula_text_and_compiled_code_agree_with_the_interpreter(program):
    model = lowered(program[0])
    low, exact, change, sound = noisy(model)
    read = formula(to_text(model.graph, model.step), parameters=model.values)
    again = evaluate(read.graph, {**COLUMNS, **CLOCK}, model.values)
    for at, name in enumerate(model.graph.names):
        np.testing.assert_array_equal(again[name], exact[at], err_msg=name)
    roots = list(low.graph.names.values())
    compiled = Simulator(low, roots, model.values).over({**COLUMNS, **CLOCK}, SAMPLES, model.values, (0,))
    assert_close(np.asarray(compiled).reshape(exact.shape), exact, change, sound)


@pytest.mark.slow
@few_or_many(programs(), few=3, many=25)
def test_derivatives_are_those_of_differences(program):
    model = lowered(program[0])
    low, exact, _, sound = noisy(model)
    for name in model.values:
        own = model.values[name]
        if own.locked.all():
            continue
        line = differentiate(low.graph, [low.graph.names["calc"]], (name,))
        slopes = Interpreter(low, model.values).rows(line, {name: 0}, {**COLUMNS, **CLOCK}).jacobian[:, 0, :]
        for at in range(own.size):
            ends = []
            for step in (1e-5, -1e-5, 2e-5, -2e-5):
                values = own.values.ravel().copy()
                values[at] += step
                ends.append(
                    run(model, COLUMNS, parameters=model.values.with_parameters(own.with_values(values)))["calc"]
                )
            near, far = (ends[0] - ends[1]) / 2e-5, (ends[2] - ends[3]) / 4e-5
            smooth = sound.all(axis=0) & (np.abs(near - far) <= 1e-4 * (1 + np.abs(near)))
            one_sided = np.abs((ends[0] + ends[1]) / 2 - exact[list(low.graph.names).index("calc")])
            smooth &= one_sided <= 1e-7 * (1 + np.abs(exact[list(low.graph.names).index("calc")]))
            event("smooth" if smooth.all() else "kink")
            np.testing.assert_allclose(slopes[smooth, at], near[smooth], rtol=1e-3, atol=1e-4, err_msg=name)

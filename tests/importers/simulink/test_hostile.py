"""Settings that make no sense: every block either works or says what is wrong; nothing breaks or hangs."""

import contextlib
import random

import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from kennfeld.importers.simulink.lowering.registry import BLOCK_TYPES
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import alone

JUNK = [
    "", " ", "0", "-1", "1e9", "inf", "nan", "[]", "[1 2 3]", "[1;2]", "[1 2; 3 4]", "x", "'text'", "{1,2}", "1:5",
    "on", "off", "zeros(0,3)", "1/0", "a.b.c", "f(", "2 2", "[1 2;", "-inf", "1.5", "ones(3,3,3)", "eye(2)", "u1 > ",
    "%c",
]  # fmt: skip


@pytest.mark.parametrize("draws", [pytest.param(1, id="few"), pytest.param(10, id="many", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", sorted(BLOCK_TYPES))
def test_every_block_with_settings_that_make_no_sense(kind, draws, tmp_path):
    chance = random.Random(kind)
    defaults = BLOCK_TYPES[kind].defaults
    for _ in range(draws):
        parameters = {name: chance.choice(JUNK) for name in defaults if chance.random() < 0.5}
        inputs = chance.choice([0, 1, 2, 3])
        solver = chance.choice(["ode3", "FixedStepDiscrete", "ode45"])
        drawn = alone(kind, inputs, chance.choice([1, 2]), model=Model(solver=solver, step="0.1"), **parameters)
        with contextlib.suppress(InputError):
            result = import_simulink(drawn.write(tmp_path))
            assert result.model is not None or result.report.findings


def test_settings_of_the_solver_that_make_no_sense(tmp_path):
    for step in JUNK:
        drawn = alone("Integrator", model=Model(solver="ode4", step=step, start="0", stop=step))
        result = import_simulink(drawn.write(tmp_path))
        assert result.model is None or result.model.step is None or result.model.step > 0

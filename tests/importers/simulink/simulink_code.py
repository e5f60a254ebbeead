"""A MATLAB Function between inports and outports, run over random inputs."""

import numpy as np

from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import imported, run, slopes

RANDOM = np.random.default_rng(20)
U = RANDOM.normal(size=30)
V = RANDOM.normal(size=30)


def function(code, inputs=("u", "v"), outputs=("y",), model=None):
    """A drawing of one MATLAB Function "F"."""
    drawn = model or Model(step="0.1", solver="FixedStepDiscrete")
    drawn.function("F", code, inputs, outputs)
    drawn.between(inputs, "F", [f"{name}{at}" for at, name in enumerate(outputs, 1)])
    return drawn


def body(text, result="y"):
    """A function of u and v with these statements."""
    return f"function {result} = f(u, v)\n{text}\nend\n"


def outputs(code, folder, u=U, v=V, **options):
    """Return the first output of a function of u and v over the samples."""
    return run(imported(function(code), folder, **options), {"u": u, "v": v})["y1"]


def stepwise(rule, u=U, v=V):
    """A rule of one sample over the samples."""
    return np.array([float(rule(a, b)) for a, b in zip(u, v, strict=True)])


def check_slopes(code, folder, name, value, u=U, v=V, tolerance=1e-6):
    """Exact derivatives with respect to a parameter against central differences."""
    model = imported(function(code), folder, parameters=[{name: value}])
    exact, near = slopes(model, {"u": u, "v": v}, name, "y1")
    np.testing.assert_allclose(exact, near, rtol=tolerance, atol=1e-7)
    assert np.any(exact != 0)

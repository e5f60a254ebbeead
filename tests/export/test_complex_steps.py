"""Directional derivatives of FMUs against complex steps of the same function, written once more in Python."""

import numpy as np
import pytest

from kennfeld import Axis, Curve, Map, ParameterSet, Scalar
from kennfeld.export.api import export_function
from tests.export.compiled import needs_compiler
from tests.export.fmi2_instance import OK, Fmi2
from tests.export.fmi3_instance import Fmi3

TEXT = """
output y
output z
lagged = PT1(M(Speed, Load) * K, 0.5 + K ^ 2)
y = lagged * exp(-Load / 8) + K * tanh(prev(y, 0.2) * Speed) + Curve(Speed) ^ 2
z = sqrt(1 + y * y) + log(2 + Load ^ 2) * M(Load, Speed) / (3 + sin(delay(z, 2, 0.1)))
"""
X, Y, POINTS = np.array([0.0, 1, 2, 5]), np.array([-1.0, 2, 3]), np.array([0.0, 0.7, 1.3, 3, 4.5])
STEP, SAMPLES, SMALL = 0.1, 12, 1e-30


def _values():
    random = np.random.default_rng(1)
    return ParameterSet(
        [
            # 4 x 3 with unequal axes: a transposed table would be another one
            Map("M", X, Y, random.normal(size=(4, 3))),
            Curve("Curve", Axis(POINTS, free=True), random.normal(size=5), extrapolation="linear"),
            Scalar("K", 0.3),
        ]
    )


def _cell(points, x, clip):
    """Return the number of the cell and the share below x, complex."""
    i = int(np.clip(np.searchsorted(np.real(points), np.real(x), side="right") - 1, 0, len(points) - 2))
    share = (x - points[i]) / (points[i + 1] - points[i])
    return i, min(max(share, 0.0, key=np.real), 1.0, key=np.real) if clip else share


def _map(values, x, y):
    (i, f), (j, g) = _cell(X, x, True), _cell(Y, y, True)
    low, high = (values[k, j] * (1 - g) + values[k, j + 1] * g for k in (i, i + 1))
    return low * (1 - f) + high * f


def _curve(points, values, x):
    i, f = _cell(points, x, False)
    return values[i] * (1 - f) + values[i + 1] * f


def _sample(p, u, memory):
    """Return y, z and the next memory: lagged, y, and the last two z."""
    speed, load, k = u["Speed"], u["Load"], p["K"]
    before, y_before, z_before = memory
    target = _map(p["M"], speed, load) * k
    lagged = target if before is None else before + STEP / (0.5 + k**2 + STEP) * (target - before)
    y = lagged * np.exp(-load / 8) + k * np.tanh(y_before * speed) + _curve(p["Curve.x"], p["Curve"], speed) ** 2
    z = np.sqrt(1 + y * y) + np.log(2 + load**2) * _map(p["M"], load, speed) / (3 + np.sin(z_before[0]))
    return y, z, (lagged, y, (z_before[1], z))


def _cases():
    """Yield inputs of each sample, and the changes of outputs in three directions at the last one."""
    random, values = np.random.default_rng(7), _values()
    p = {name: values[name].values for name in ("M", "Curve", "K")} | {"Curve.x": POINTS}
    memory = (None, 0.2, (0.1, 0.1))
    inputs = [{"Speed": random.uniform(-1, 6), "Load": random.uniform(-1, 4)} for _ in range(SAMPLES)]
    for u in inputs[:-1]:
        y, z, memory = _sample(p, u, memory)
    directions = []
    for _ in range(3):
        d = {name: random.normal(size=np.shape(value)) for name, value in {**inputs[-1], **p}.items()}
        shifted = {name: value + 1j * SMALL * d[name] for name, value in p.items()}
        moved = {name: value + 1j * SMALL * d[name] for name, value in inputs[-1].items()}
        y, z, _ = _sample(shifted, moved, memory)
        directions.append((d, (np.imag(y) / SMALL, np.imag(z) / SMALL)))
    return inputs, (np.real(y), np.real(z)), directions


def _of_fmi2(path, folder, inputs, directions):
    instance = Fmi2(path, folder).instance().begin(**inputs[0])
    for k, u in enumerate(inputs[1:]):
        instance.set(**u)
        assert instance.step(k * STEP, STEP) == OK

    def scalars(direction):
        flat = {}
        for name, value in direction.items():
            for index, number in np.ndenumerate(value):
                flat[f"{name}[{','.join(str(i + 1) for i in index)}]" if index else name] = float(number)
        return flat

    return instance.get("y", "z"), [[instance.derivative(name, scalars(d)) for name in "yz"] for d, _ in directions]


def _of_fmi3(path, folder, inputs, directions):
    instance = Fmi3(path, folder)
    instance.begin(inputs[0])
    for k, u in enumerate(inputs[1:]):
        instance.set(u)
        instance.step(k * STEP, STEP)
    return instance.get("y", "z"), [[instance.derivative(name, d) for name in "yz"] for d, _ in directions]


@needs_compiler
@pytest.mark.parametrize(("fmi", "run"), [(2, _of_fmi2), (3, _of_fmi3)])
def test_derivatives_by_inputs_and_parameters_are_those_of_complex_steps(fmi, run, tmp_path):
    path = export_function(TEXT, _values(), tmp_path, to="fmu", name="engine", fmi=fmi, step=STEP).files[0]
    inputs, outputs, directions = _cases()
    got, derivatives = run(path, tmp_path / "unpacked", inputs, directions)
    np.testing.assert_allclose(got, outputs, rtol=1e-12)
    np.testing.assert_allclose(derivatives, [expected for _, expected in directions], rtol=1e-9)

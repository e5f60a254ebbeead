"""Small fits that designs are made around."""

import numpy as np

import kennfeld as kf
from kennfeld.design.fitted_function import FittedFunction

MAP = "input n\ninput l\ny = M(n, l)"
LAG = "input u\ny = PT1(C(u), T)"
PRODUCT = "input n\ninput g\nideal = C(n)\ny = ideal * E(g) - D(n)"


def surface(n, l):  # noqa: E741
    return 3 * n - 2 * l + n * l


def map_fit(count=40, seed=0, upper=1.0, smoothness=0.01):
    """A map of 4 x 4 values on points with n below `upper`, so that grid points beyond it have no data."""
    random = np.random.default_rng(seed)
    n, l = random.uniform(0, upper, count), random.uniform(0, 1, count)  # noqa: E741
    data = {"n": n, "l": l, "m": surface(n, l) + random.normal(0, 0.05, count)}
    axis = np.linspace(0, 1, 4)
    start = kf.ParameterSet([kf.Map("M", axis, axis, np.zeros((4, 4)))])
    return kf.calibrate(MAP, data, start, "m", smoothness=smoothness)


def drive(seconds, levels, seed=0, step=0.1, name="drive"):
    """A recording of a curve behind a lag of 1 s, whose input stays at random levels for 3 s each."""
    random = np.random.default_rng(seed)
    time = step * np.arange(round(seconds / step))
    u = random.choice(levels, time.size // 30 + 1).repeat(30)[: time.size] + random.uniform(-0.02, 0.02, time.size)
    truth = kf.ParameterSet([kf.Curve("C", np.linspace(0, 1, 5), [0.0, 1.0, 3.0, 4.0, 4.5]), kf.Scalar("T", 1.0)])
    clean = kf.simulate(LAG, kf.Dataset.of(name, {"u": u}, time=time), truth)["y"].values
    return kf.Dataset.of(name, {"u": u, "m": clean + random.normal(0, 0.02, time.size)}, time=time)


def lag_fit(data):
    start = kf.ParameterSet([kf.Curve("C", np.linspace(0, 1, 5), np.zeros(5)), kf.Scalar("T", 2.0, lower=0.01)])
    return kf.calibrate(LAG, data, start, "m", smoothness={"C": 1e-3})


def product_fit(seed=0, count=200, free=("*",)):
    """A curve times an efficiency less a drag, much like a larger curve and a flatter efficiency.

    With a known efficiency, a larger curve and a larger drag can hardly be distinguished.
    """
    random = np.random.default_rng(seed)
    n, g = random.uniform(0, 1, count), random.uniform(0.4, 0.6, count)
    points = np.linspace(0, 1, 3)
    truth = (50 + 20 * n) * (1 - 0.4 * abs(g - 0.5)) - 10 * n - 5
    data = kf.Dataset.of("fired", {"n": n, "g": g, "m": truth + random.normal(0, 0.1, count)})
    start = kf.ParameterSet(
        [
            kf.Curve("C", points, [40.0, 50.0, 60.0]),
            kf.Curve("E", np.linspace(0, 1, 3), [0.8, 1.0, 0.8]),
            kf.Curve("D", points, [4.0, 8.0, 12.0]),
        ]
    )
    return kf.calibrate(PRODUCT, data, start, "m", pins=[kf.Pin("E", (0.5,), 1.0)] if "*" in free else (), free=free)


def fitted(result):
    return FittedFunction.of(result)

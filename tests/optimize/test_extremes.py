"""Numbers at the ends of what a double can hold: a result or a finding, and no warning of numpy (these are errors)."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import KennfeldError
from kennfeld.domain.criteria import ROBUST_LOSSES

X = np.linspace(0, 10, 40)
Z = np.sin(X) + 2
EXTREMES = [1e300, 1e-300, 1.7e308, 1e160]
WAYS = {
    "x": lambda s: {"data": {"x": X / 10 * s, "z": Z}},
    "target": lambda s: {"data": {"x": X, "z": Z / 4 * s}},
    "weight": lambda s: {"criteria": [kf.Criterion("m", "z", weight=s)]},
    "scale": lambda s: {"criteria": [kf.Criterion("m", "z", scale=s)]},
    **{loss: lambda s, loss=loss: {"criteria": [kf.Criterion("m", "z", loss=loss, delta=s)]} for loss in ROBUST_LOSSES},
    "smoothness": lambda s: {"smoothness": s},
    "start": lambda s: {"level": s},
}
QUICK = dict.fromkeys(["x", "target", "scale"], 1e-300)  # not slow, as the largest size of the other ways


@pytest.mark.parametrize(
    ("way", "size"),
    [
        pytest.param(way, size, marks=() if size == QUICK.get(way, 1e300) else pytest.mark.slow)
        for way in WAYS
        for size in EXTREMES
    ],
)
def test_a_calibration_of_extreme_numbers_ends_without_a_warning(way, size):
    arguments = {"data": {"x": X, "z": Z}, "smoothness": 0.0, "level": 1.0} | WAYS[way](size)
    start = kf.ParameterSet([kf.Curve("C", np.linspace(0, 10, 5), np.full(5, arguments["level"])), kf.Scalar("k", 1.0)])
    criteria = arguments.get("criteria") or [kf.Criterion("m", "z")]
    try:
        options = kf.Options(max_iterations=15)
        data, smoothness = arguments["data"], arguments["smoothness"]
        result = kf.calibrate(
            "m = C(k * x)", data, start, criteria=criteria, smoothness={"C": smoothness}, options=options
        )
    except KennfeldError:
        return
    assert result.status in ("converged", "max_iterations", "failed")
    assert result.trust is not None
    assert str(result)
    assert result.as_json()

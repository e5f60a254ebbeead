import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.constraints import Shape
from tests.calfiles.a2l_files import axis, label, layout, method, module

X = np.linspace(0, 10, 400)
DATA = {"x": X, "m": 8 + 5 * np.sin(X) + 0.4 * X + np.random.default_rng(0).normal(0, 0.05, X.size)}


@pytest.fixture
def storage(tmp_path):
    """An A2L file in which Byte has steps of 1, and Single is a number in single precision."""
    points = axis("FIX_AXIS", 4, "FIX_AXIS_PAR_DIST 0 1 4")
    blocks = (
        layout("FNC_VALUES 1 SBYTE ROW_DIR DIRECT", name="B"),
        layout("FNC_VALUES 1 FLOAT32_IEEE ROW_DIR DIRECT", name="F"),
        method("CV", "LINEAR", "COEFFS_LINEAR 1 0"),
        label("CURVE", points, name="Byte", conversion="CV", record="B"),
        label("CURVE", points, name="Single", record="F"),
    )
    path = tmp_path / "ecu.a2l"
    path.write_bytes(module(*blocks))
    return path


def calibrate(storage, rounding="joint", constraints=(), **single):
    byte = kf.Curve("Byte", [0, 2.5, 5, 7.5, 10], np.zeros(5))
    # between the breakpoints of Byte and at some of them
    own = kf.Curve("Single", [0, 1, 3.5, 5, 6, 8.5, 10], np.zeros(7), **single)
    start = kf.ParameterSet([byte, own])
    settings = {"rounding": rounding, "storage": storage} if rounding else {}
    return kf.calibrate(
        "y = Byte(x) + Single(x)", DATA, start, "m", constraints=constraints, smoothness=1e-4, **settings
    )


def test_floating_values_make_up_for_the_rounding_of_bytes_and_are_those_of_the_storage(storage):
    result, fit = calibrate(storage), calibrate(storage, rounding=None)
    errors = {name: getattr(result.rounding, name)["y/training"] for name in ("unrounded", "nearest", "joint")}
    assert errors["joint"] - errors["unrounded"] < 0.3 * (errors["nearest"] - errors["unrounded"])
    single, byte = result.parameters["Single"].values, result.parameters["Byte"].values
    np.testing.assert_array_equal(single, single.astype(np.float32))
    np.testing.assert_array_equal(byte, np.rint(byte))
    assert np.abs(single - fit.parameters["Single"].values).max() > 0.05


def test_floating_values_only_become_those_of_the_storage_if_each_is_rounded_on_its_own(storage):
    result, fit = calibrate(storage, "nearest"), calibrate(storage, rounding=None)
    np.testing.assert_array_equal(
        result.parameters["Single"].values, fit.parameters["Single"].values.astype(np.float32)
    )


def test_floating_values_keep_their_limits_while_they_make_up_for_others(storage):
    # 0.7 is no number of single precision; the nearest one, 0.699999988, is beyond the bound
    rising = Shape("Single", 0, "slope", lower=0.0)
    result = calibrate(storage, constraints=[rising], lower=0.7, upper=2.3)
    single = result.parameters["Single"].values
    assert single.min() >= 0.7
    assert single.max() <= 2.3
    assert np.diff(single).min() >= 0.0

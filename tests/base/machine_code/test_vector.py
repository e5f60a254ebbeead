"""Arithmetic on eight doubles, against numpy."""

import numpy as np

from kennfeld.base.machine_code.engine import compile_functions
from kennfeld.base.machine_code.ir import EIGHT, LANES, FunctionWriter, Vector


def test_the_exponential_is_right_within_two_units_in_the_last_place():
    f = FunctionWriter("exps", [("ptr", "x"), ("ptr", "y"), ("i64", "groups")])
    with f.loop(0, "%groups") as group:
        at = f.mul(group, LANES)
        f.store(Vector(f).exp(f.load(f.at("%x", at), kind=EIGHT)), f.at("%y", at), kind=EIGHT)
    run = compile_functions(f)["exps"]
    x = -np.concatenate([np.linspace(0, 2, 8000), np.geomspace(1e-12, 699, 8000)])
    y = np.empty_like(x)
    run(x.ctypes.data, y.ctypes.data, x.size // LANES)
    exact = np.exp(x)
    assert np.max(np.abs(y - exact) / np.spacing(exact)) <= 2

"""Directional derivatives in C, against central differences of the same code."""

import ctypes

import numpy as np
import pytest

from kennfeld import RBF, Axis, Curve, Expansion, Map, ParameterSet, Scalar, formula
from kennfeld.base.fmi_platform import LIBRARY_SUFFIX
from kennfeld.domain.parameters import Block
from kennfeld.export.c_code import write_c
from kennfeld.export.host_compiler import HostCompiler
from kennfeld.graph import GraphBuilder
from kennfeld.graph.dense_layer import ACTIVATIONS, DenseLayer
from kennfeld.models import Model
from tests.export.compiled import STRICT, needs_compiler, prepared

# structs of doubles alone, which are arrays for the test
DRIVER = """
#include "f.h"
void run(const double *p, const double *u, const double *dp, const double *du, double *out)
{
    f_states s; f_outputs y; f_outputs dy; int k; const int n = (int)(sizeof(y) / sizeof(double));
    f_init(&s);
    f_tangent((const void *)p, &s, (const void *)u, (const void *)dp, (const void *)du, &dy);
    f_step((const void *)p, &s, (const void *)u, &y);
    for (k = 0; k < n; k++) {
        out[k] = ((const double *)(const void *)&y)[k];
        out[n + k] = ((const double *)(const void *)&dy)[k];
    }
}
"""


class Compiled:
    """A function in C; calling it returns outputs and their changes."""

    def __init__(self, model, parameters, folder):
        function = prepared(model, parameters)
        for name, text in write_c(function, tangent=True).items():
            (folder / name).write_text(text)
        (folder / "driver.c").write_text(DRIVER)
        library = folder / f"f{LIBRARY_SUFFIX}"
        HostCompiler.find().shared_library([folder / "driver.c", folder / "f.c"], library, STRICT)
        self.run, self.outputs = ctypes.CDLL(str(library)).run, len(function.outputs)
        self.parameters = np.concatenate([np.zeros(0), *(np.ravel(p.values) for p in function.parameters)])
        self.inputs = len(function.inputs)

    def __call__(self, p, u, dp, du):
        out = np.empty(2 * self.outputs)
        arrays = [np.ascontiguousarray(x, dtype=np.float64) for x in (p, u, dp, du)]
        self.run(*(ctypes.c_void_p(x.ctypes.data) for x in (*arrays, out)))
        return out[: self.outputs], out[self.outputs :]


def check(model, parameters, folder, reach=(-1.0, 2.0), samples=8):
    function, random, step = Compiled(model, parameters, folder), np.random.default_rng(1), 1e-6
    for _ in range(samples):
        u, p = random.uniform(*reach, function.inputs), function.parameters
        du, dp = random.normal(size=u.size), random.normal(size=p.size)
        ahead, behind = (function(p + h * dp, u + h * du, dp, du)[0] for h in (step, -step))
        difference = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(function(p, u, dp, du)[1], difference, rtol=3e-8, atol=3e-8)


@needs_compiler
def test_tables_with_free_and_fixed_axes(tmp_path):
    random = np.random.default_rng(2)
    values = ParameterSet(
        [
            Map("M", Axis([-1, 0.3, 1.1, 2], free=True), [-1, 0.7, 2], random.normal(size=(4, 3))),
            Curve("C", Axis([-0.5, 0.4, 1.3], free=True), random.normal(size=3), extrapolation="linear"),
            Map("Flat", [-1, 0, 2], [0.5], random.normal(size=(3, 1))),
            Scalar("K", 1.7),
        ]
    )
    text = "y = M(u, C(v)) * K + C(u) / (2 + v ^ 2) + Flat(v, u)\nz = if(u > v, M(u, v), exp(v)) + max(u, v) * K"
    check(formula(text, parameters=["M", "C", "Flat", "K"]), values, tmp_path)


@needs_compiler
def test_elementary_functions(tmp_path):
    text = "y = sin(u) + cos(v) * tan(u / 3) + atan2(u, v) + log(3 + u) + sqrt(2 + v) + (3 + u) ^ v + tanh(v) + abs(u)"
    check(formula(text), ParameterSet(), tmp_path)


@needs_compiler
@pytest.mark.parametrize("kernel", ["gaussian", "matern52"])
def test_expansions(kernel, tmp_path):
    random = np.random.default_rng(3)
    bells = (random.normal(size=5), random.normal(size=(5, 2)), random.uniform(0.3, 2, (5, 2)))
    values = ParameterSet([RBF("R", Expansion(1.0, [0.5, -1], *bells, kernel))])
    check(formula("y = R(u, v ^ 2)", parameters=["R"]), values, tmp_path)


@needs_compiler
def test_dense_layers_of_every_activation(tmp_path):
    random, b, names = np.random.default_rng(4), GraphBuilder(), {}
    u, v = b.input("u"), b.input("v")
    blocks = []
    for activation in ACTIVATIONS:
        layer = DenseLayer(activation, 2, 3, activation, 0.3)
        names |= {f"{activation}{i}": at for i, at in enumerate(b.dense(layer, u, b.call("sin", v)))}
        blocks.append(Block(activation, random.normal(size=layer.shape)))
    check(Model(b.finish(names), name="layers"), ParameterSet(blocks), tmp_path)

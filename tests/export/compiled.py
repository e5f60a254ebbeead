"""Exported C code in the memory of the test process, and what Kennfeld simulates."""

import numpy as np
import pytest

from kennfeld.base.errors import Findings, Location
from kennfeld.export.host_compiler import CompiledFunction, HostCompiler
from kennfeld.export.prepared import PreparedFunction, prepare
from kennfeld.models import Model
from kennfeld.optimize.quality.quality import NodeSimulator

STRICT = ("-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Werror")

needs_compiler = pytest.mark.skipif(HostCompiler.find() is None, reason="this machine has no C compiler")


def prepared(model: Model, parameters, outputs=(), name="f", precision="double") -> PreparedFunction:
    return prepare(model, parameters, name, Location("test"), Findings(), outputs, precision)


def in_c(model, parameters, columns, starts=(0,), *, precision="double", outputs=(), flags=()):
    """Return all outputs, Float[outputs, samples], computed by exported code without a warning."""
    function = prepared(model, parameters, outputs, precision=precision)
    compiled = CompiledFunction(function, precision, HostCompiler.find(), (*STRICT, *flags))
    return compiled.over(columns, _samples(columns), starts)


def simulated(model, parameters, columns, starts=(0,), outputs=()):
    """Return the same by native code."""
    names = outputs or model.graph.outputs
    return NodeSimulator(model.graph, parameters, list(names)).over(columns, _samples(columns), parameters, starts)


def _samples(columns):
    return len(next(iter(columns.values())))


def hostile(seed, samples, names, reach=6.0):
    """Return columns with NaN, infinities, zeros and breakpoints among random numbers."""
    random = np.random.default_rng(seed)
    columns = {name: random.uniform(-reach, reach, samples) for name in names}
    for column in columns.values():
        at = random.permutation(samples)
        special = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, 2.0, 5.0, 1e300, 5e-324]
        column[at[: len(special)]] = special
    return columns

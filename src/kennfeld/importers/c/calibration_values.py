"""Calibration values of C code as parameters: scalars, and tables over the indices of their elements."""

from itertools import product

import numpy as np

from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Parameter, ParameterAttributes, parameter
from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.c.interface import CNumbers
from kennfeld.models.imperative.node_arrays import Nodes


def parameter_of(numbers: CNumbers, values: list[float], prefix: str = "") -> Parameter:
    """Return the parameter of calibration values; its axes count the elements from 0, as indices in C do.

    Args:
        numbers: the calibration values.
        values: their numbers, in the order of memory.
        prefix: text that precedes the name.
    """
    axes = [Axis(np.arange(float(size))) for size in numbers.leaf.sizes]
    word = numbers.leaf.type.word
    attributes: ParameterAttributes = {}
    if word is not None:  # a switch rather than a quantity, whose derivative is 0
        limits = (0.0, 1.0) if numbers.leaf.type.truth else (float(word.least), float(word.most))
        attributes = {"lower": limits[0], "upper": limits[1], "locked": np.True_}
    return parameter(prefix + numbers.label, np.reshape(values, numbers.leaf.sizes), axes, **attributes)


def lookups(builder: GraphBuilder, numbers: CNumbers, prefix: str = "") -> Nodes:
    """Return the nodes that read calibration values."""
    places = product(*(range(size) for size in numbers.leaf.sizes))
    nodes = [builder.lookup(prefix + numbers.label, *(builder.const(float(at)) for at in place)) for place in places]
    return np.array(nodes, dtype=np.int64)

"""Small models with data, written out: what the other tests of this folder calibrate."""

import numpy as np

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Curve, Map, Scalar
from kennfeld.graph import GraphBuilder
from kennfeld.graph.dense_layer import DenseLayer
from tests.clocks import even_clock
from tests.graph.random_graphs import Case, Criterion
from tests.native.external_functions import PRODUCT_AND_SQUARE

FREE = ("K", "L", "C", "M", "Inner", "Outer")
X, Y = np.array([-2.0, -0.7, 0.4, 1.9]), np.array([-1.5, 0.1, 1.2])


def parameters(seed=0):
    random = np.random.default_rng(seed)
    return ParameterSet(
        [
            Scalar("K", 0.37),
            Scalar("L", -0.3),
            Curve("C", X, random.standard_normal(4)),
            Map("M", X, Y, random.standard_normal((4, 3))),
            Block("Inner", random.standard_normal((3, 9))),
            Block("Outer", random.standard_normal((10, 2))),
        ]
    )


def case(graph, samples=500, starts=(0,), *, free=FREE, seed=0, loss="square", values=None):
    """The graph on random data, a criterion an output, NaN among the targets."""
    random = np.random.default_rng(seed)
    columns = {name: random.uniform(-2.5, 2.5, samples) for name in ("u", "v", "w")}
    columns |= even_clock(0.1, samples)
    criteria = []
    for number, name in enumerate(graph.names):
        target = random.standard_normal(samples)
        target[:: 7 + number] = np.nan
        criteria.append(Criterion(name, target, random.uniform(0.2, 2.0, len(starts)), 0.5 + number, loss, 0.8))
    parameter_values = values or parameters(seed)
    used = tuple(name for name in free if name in graph.parameters)
    return Case(graph, parameter_values, used, columns, tuple(starts), tuple(criteria), seed)


def static():
    """A map times a curve of a curve, with the map looked up twice."""
    b = GraphBuilder()
    u, v = b.input("u"), b.input("v")
    inner = b.lookup("C", u)
    y = b.call("mul", b.lookup("M", u, v), b.lookup("C", inner))
    return b.finish({"y": b.call("add", y, b.call("mul", b.lookup("K"), b.lookup("M", v, u)))})


def external():
    """A state whose next value and output come from one function outside of the graph, and one call of it beside."""
    b = GraphBuilder()
    state = b.state()
    product, square = b.external(PRODUCT_AND_SQUARE, b.lookup("C", b.input("u")), state)
    b.close(state, b.lookup("K"), b.call("mul", b.const(0.4), product))
    other, _ = b.external(PRODUCT_AND_SQUARE, b.input("v"), b.lookup("L"))
    return b.finish({"y": b.call("add", square, other), "z": product})


def layers():
    """A network of two layers whose second output is a state, which it reads together with a curve."""
    b = GraphBuilder()
    state = b.state()
    inner = b.dense(DenseLayer("Inner", 2, 9, "tanh"), b.lookup("C", b.input("u")), state)
    y, z = b.dense(DenseLayer("Outer", 9, 2, "elu", 0.7), *inner)
    b.close(state, b.lookup("K"), b.call("mul", b.const(0.4), b.call("tanh", z)))
    return b.finish({"y": y, "z": b.call("add", z, b.call("mul", inner[3], inner[8]))})


def lag():
    """One state: y += K' (M(u, y) - y), from a first value that depends on a parameter."""
    b = GraphBuilder()
    state = b.state()
    target = b.lookup("M", b.input("u"), state)
    share = b.call("mul", b.const(0.3), b.call("tanh", b.lookup("C", b.input("v"))))
    b.close(
        state, b.lookup("C", b.input("w")), b.call("add", state, b.call("mul", share, b.call("sub", target, state)))
    )
    return b.finish({"y": b.call("add", state, b.lookup("K"))})


def coupled(count):
    """`count` states that drive each other round, two outputs that see several of them."""
    b = GraphBuilder()
    u, v = b.input("u"), b.input("v")
    states = [b.state() for _ in range(count)]
    for i, state in enumerate(states):
        before, after = states[i - 1], states[(i + 1) % count]
        drive = b.call("sin", b.call("mul", before, b.lookup("C", b.call("add", u, after))))
        step = b.call("add", b.call("mul", b.const(0.5), state), b.call("mul", b.const(0.6), drive))
        first = b.lookup("K") if i == 0 else b.call("mul", states[0], b.lookup("L"))
        b.close(state, first, b.call("add", step, b.call("mul", b.const(0.1), b.lookup("M", u, v))))
    total = states[0]
    for state in states[1:]:
        total = b.call("add", total, state)
    direct = b.call("add", b.lookup("L"), b.call("mul", b.lookup("M", v, states[-1]), total))
    return b.finish({"y": total, "z": direct})


def delayed():
    """A dead time of three steps within the feedback."""
    b = GraphBuilder()
    state = b.state(3)
    now = b.call("add", b.call("mul", b.lookup("C", state), b.const(0.3)), b.lookup("M", b.input("u"), b.input("v")))
    b.close(state, b.lookup("K"), now)
    return b.finish({"y": b.call("add", now, b.prev(now, b.lookup("L"))), "z": state})


MODELS = {
    "static": static,
    "lag": lag,
    "coupled2": lambda: coupled(2),
    "coupled3": lambda: coupled(3),
    "delayed": delayed,
    "external": external,
    "layers": layers,
}

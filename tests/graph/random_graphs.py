"""Random models with data, as Hypothesis strategies: every operation, every kind of table, states, pieces, criteria.

Hypothesis draws the structure; numbers come from a generator whose seed it draws, so that no value sits on a breakpoint
or a tie by chance. Where one does by construction (x - x, whole numbers), `Noisy` of `noise.py` finds it.
"""

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st

from kennfeld.domain.axis import Axis
from kennfeld.domain.criteria import ROBUST_LOSSES
from kennfeld.domain.free_axes import AxisKey, free_axes, with_breakpoints
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Parameter, Scalar
from kennfeld.domain.rbf import RBF, Expansion
from kennfeld.graph import OPERATIONS, Graph, GraphBuilder
from kennfeld.native.rbf_code import KERNELS

INPUTS = ("u", "v", "w")
LOSSES = ("square", *ROBUST_LOSSES)
DRAWN = tuple(sorted(set(OPERATIONS) - {"guard"}))  # `guard` occurs in derivatives alone


@dataclass(frozen=True)
class Criterion:
    """A named node against a target, and how the difference counts."""

    node: str
    target: np.ndarray  # [samples], NaN where nothing was measured
    scores: np.ndarray  # [pieces]
    scale: float
    loss: str
    delta: float


@dataclass(frozen=True, repr=False)
class Case:
    """A model, its parameters, and data to run it on."""

    graph: Graph
    parameters: ParameterSet
    free: tuple[str, ...]
    columns: dict[str, np.ndarray]
    starts: tuple[int, ...]
    criteria: tuple[Criterion, ...]
    seed: int
    axes: tuple[AxisKey, ...] = ()  # those whose breakpoints are fitted

    def __repr__(self) -> str:
        nodes = "; ".join(f"{i} {op}{args} {payload}" for i, (op, args, payload) in enumerate(self.graph.nodes))
        return (
            f"seed {self.seed}, free {self.fitted}, starts {self.starts}, states {self.graph.states}, "
            f"names {dict(self.graph.names)}, nodes {nodes}"
        )

    def _repr_pretty_(self, printer, cycle) -> None:
        printer.text(repr(self))

    @property
    def samples(self) -> int:
        return self.columns["u"].size

    @property
    def ends(self) -> tuple[int, ...]:
        return (*self.starts[1:], self.samples)

    @property
    def fitted(self) -> tuple[str | AxisKey, ...]:
        """Parameters and axes."""
        return (*self.free, *self.axes)

    def with_other_values(self, by: float = 0.1) -> "Case":
        """The same model with other values of its free parameters."""
        random = np.random.default_rng(self.seed + 1)
        changed = [self.parameters[n] for n in self.free]
        changed = [p.with_values(p.values + by * random.standard_normal(p.values.shape)) for p in changed]
        changed_set = self.parameters.with_parameters(*changed)
        points = {key: free_axes(changed_set)[key].axis.breakpoints for key in self.axes}
        moved = {key: x + 0.3 * np.diff(x).min() * random.uniform(-1, 1, x.size) for key, x in points.items()}
        return replace(self, parameters=with_breakpoints(changed_set, moved))


def sizes_of(names, parameters):
    """Number of values of each parameter or axis."""
    axes = free_axes(parameters)
    return [parameters[n].size if isinstance(n, str) else len(axes[n].axis) for n in names]


@st.composite
def cases(
    draw, *, states=None, max_latency=3, max_states=3, max_outputs=3, operations=14, nan=True, kinks=True, nested=False
):
    """A `Case`. `states` None leaves open whether it has memory; `nested` makes sure of a lookup of lookups."""
    seed = draw(st.integers(0, 2**32 - 1))
    random = np.random.default_rng(seed)
    parameters = ParameterSet(draw(tables(random)))
    fixed = draw(st.sets(st.sampled_from(sorted(parameters)), max_size=2))
    count = draw(st.integers(1, max_states)) if states or (states is None and draw(st.booleans())) else 0
    latencies = draw(st.lists(st.integers(1, max_latency), min_size=count, max_size=count))
    b = GraphBuilder()
    pool = [b.input(name) for name in (*INPUTS, "dt", "dt_next", "t")] + [b.const(value) for value in (2.0, -1.5)]
    memory = [b.state(latency) for latency in latencies]
    pool += memory
    grow = _Growth(b, draw, parameters, pool, memory, kinks=kinks)
    for _ in range(draw(st.integers(2, operations))):
        grow.more()
    if nested:
        grow.nest()
    for number, state in enumerate(memory):
        grow.close(state, memory[:number])
    outputs = draw(st.integers(1, max_outputs))
    names = grow.outputs(outputs)
    graph = b.finish(names)
    samples = draw(st.integers(1, 16))
    starts = draw(st.sets(st.integers(0, samples - 1), max_size=3)) | {0}
    columns = _columns(random, samples)
    if nan and draw(st.integers(0, 4)) == 0:
        columns["v"][draw(st.integers(0, samples - 1))] = np.nan
    criteria = tuple(draw(_criterion(random, name, samples, len(starts), nan)) for name in names)
    free = tuple(name for name in parameters if name not in fixed)
    axes = tuple(key for key in free_axes(parameters) if draw(st.integers(0, 3)))
    return Case(graph, parameters, free, columns, tuple(sorted(starts)), criteria, seed, axes)


def _columns(random, samples):
    columns = {name: random.uniform(-3, 3, samples) for name in INPUTS}
    columns["dt"] = random.uniform(0.01, 0.2, samples)
    columns["dt_next"] = random.uniform(0.01, 0.2, samples)
    columns["t"] = np.cumsum(columns["dt"])
    return columns


@st.composite
def _criterion(draw, random, name, samples, pieces, nan):
    target = random.standard_normal(samples)
    if nan:
        target[random.random(samples) < draw(st.sampled_from([0.0, 0.3]))] = np.nan
    scores = random.uniform(0.1, 3.0, pieces)
    return Criterion(
        name,
        target,
        scores,
        scale=draw(st.sampled_from([1.0, 0.25, 30.0])),
        loss=draw(st.sampled_from(LOSSES)),
        delta=draw(st.sampled_from([1.0, 0.3, 5.0])),
    )


@st.composite
def tables(draw, random) -> list[Parameter]:
    """One parameter of every kind at least; curves and maps twice, so that axes can be shared, also free ones."""
    free = draw(st.booleans())
    single = draw(st.sampled_from([0, 0, 1]))

    def axis(most=5):
        count = 1 if single and draw(st.booleans()) else draw(st.integers(2, most))
        return _rising(random, count)

    def extrapolation():
        return draw(st.sampled_from(["clip", "linear"]))

    def values(*axes):
        return random.standard_normal(tuple(len(a) for a in axes))

    x, y = axis(), axis()
    third, fourth = [axis(3) for _ in range(3)], [axis(3) for _ in range(4)]
    group = Axis(x, name="G", free=free)
    third[1] = Axis(third[1], free=free)
    return [
        Scalar("K", random.standard_normal()),
        Scalar("K2", random.standard_normal()),
        Curve("C", Axis(x, free=free), values(x), extrapolation=extrapolation()),
        Curve("C2", y, values(y), extrapolation=extrapolation()),
        Map("M", group, y, values(x, y), extrapolation=extrapolation()),
        Map("M2", group, group, values(x, x), extrapolation=extrapolation()),
        Cube("Q3", third, values(*third), extrapolation=extrapolation()),
        Cube("Q4", fourth, values(*fourth), extrapolation=extrapolation()),
        Block("B", random.standard_normal(draw(st.integers(1, 4)))),
        Block("B2", random.standard_normal((2, 3))),
        RBF("R2", expansion(random, draw(st.sampled_from([0, 1, 3, 8, 10])), 2, draw(st.sampled_from(KERNELS)))),
        RBF("R5", expansion(random, 2, 5, "matern52")),
    ]


def expansion(random, size, inputs, kernel="gaussian"):
    """Bells of about the size of the coordinates."""
    centres, widths = random.standard_normal((size, inputs)), random.uniform(0.7, 2.0, (size, inputs))
    slopes, weights = random.standard_normal(inputs), random.standard_normal(size)
    return Expansion(random.standard_normal(), slopes, weights, centres, widths, kernel)


def _rising(random, count):
    return -1.5 + np.cumsum(random.uniform(0.2, 3.0 / count, count))


class _Growth:
    """A graph under construction: operations on what there is already."""

    def __init__(self, b, draw, parameters, pool, memory, *, kinks):
        self.b, self.draw, self.parameters, self.pool, self.memory = b, draw, parameters, pool, memory
        self.made = []
        self.wild = draw(st.integers(0, 5)) == 0
        self.operations = DRAWN if kinks else SMOOTH

    def pick(self):
        return self.draw(st.sampled_from(self.pool))

    def more(self):
        """One more node: a lookup as often as an operation."""
        if self.draw(st.integers(0, 9)) < 4:
            node = self.lookup()
        else:
            node = self.operation(self.draw(st.sampled_from(self.operations)))
        self.pool.append(node)
        self.made.append(node)

    def lookup(self):
        name = self.draw(st.sampled_from(sorted(self.parameters)))
        return self.b.lookup(name, *(self.pick() for _ in range(self.parameters[name].coordinates)))

    def nest(self):
        """A lookup of two lookups, themselves of what there is."""
        node = self.b.lookup(self.draw(st.sampled_from(["M", "M2", "B2"])), self.lookup(), self.lookup())
        self.pool.append(node)
        self.made.append(node)

    def operation(self, op):
        args = [self.pick() for _ in range(OPERATIONS[op].arity)]
        if op == "pow" and self.draw(st.booleans()):
            return self.b.call("pow", _positive(self.b, args[0]), self.b.const(self.draw(st.integers(-4, 5))))
        if self.wild or op not in DOMAIN:
            return self.b.call(op, *args)
        node = self.b.call(op, *(tame(self.b, a) for a, tame in zip(args, DOMAIN[op], strict=True)))
        if self.draw(st.booleans()):
            return node
        # the operation on the raw value, where a condition says that it is defined
        condition = self.b.call("gt", args[0], self.b.const(0.0))
        return self.b.call("select", condition, self.b.call(op, *args), node)

    def close(self, state, earlier):
        """Draw the first and the next value of a state from earlier states, parameters and inputs."""
        starts = [self.b.const(0.3), self.b.input("u"), self.b.lookup("K2"), self.b.lookup("C2", self.b.input("w"))]
        starts += [self.b.call("add", s, self.b.lookup("K")) for s in earlier] + earlier
        expression = self.pick()
        kind = self.draw(st.integers(0, 9))
        if kind < 8:  # contractive
            kept = self.b.call("mul", state, self.b.call("tanh", self.lookup()))
            bounded = self.b.call("sin", expression)
            expression = self.b.call("add", self.b.call("mul", self.b.const(0.4), kept), bounded)
        self.b.close(state, self.draw(st.sampled_from(starts)), expression)

    def outputs(self, count):
        """Every node that nothing else uses, summed up in `count` outputs."""
        used = {a for node in self.b.nodes for a in node.args}
        loose = [at for at in (*self.memory, *self.made) if at not in used] or [self.pick()]
        names = {}
        for number in range(count):
            total = self.b.call("mul", self.b.lookup("K"), self.pick())
            for at in loose[number::count]:
                total = self.b.call("add", total, at)
            names[f"y{number}"] = total
        return names


def _always(b, x):
    return x


def _bounded(b, x):
    return b.call("mul", b.const(0.9), b.call("sin", x))


def _positive(b, x):
    return b.call("add", b.call("abs", x), b.const(0.4))


DOMAIN = {
    "div": (_always, _positive),
    "mod": (_always, _positive),
    "pow": (_positive, _bounded),
    "exp": (_bounded,),
    "sinh": (_bounded,),
    "cosh": (_bounded,),
    "tan": (_bounded,),
    "asin": (_bounded,),
    "acos": (_bounded,),
    "log": (_positive,),
    "log10": (_positive,),
    "sqrt": (_positive,),
    "atan2": (_positive, _always),
    "mul": (_bounded, _always),
}
STEPS = {"floor", "ceil", "round", "sign", "lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not", "mod"}
# differences see the steps of `single`
SMOOTH = tuple(op for op in DRAWN if op not in STEPS | {"min", "max", "select", "abs", "single"})

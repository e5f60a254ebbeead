"""Expected results of the native code, written down in numpy."""

from dataclasses import dataclass

import numpy as np

from kennfeld.graph.interpreter import Interpreter
from kennfeld.graph.lookup_lowering import LoweredGraph, lower_lookups
from kennfeld.native.accumulator import Accumulator
from kennfeld.native.kernel import Kernel
from kennfeld.native.sample_loop import Output
from kennfeld.native.samples import Piece, Samples
from tests.graph.random_graphs import Case, Criterion, sizes_of


def loss(r, kind, delta):
    """Return rho(r), and rho'(r) / (2 r)."""
    match kind:
        case "square":
            return r * r, np.ones_like(r)
        case "huber":
            far = np.abs(r) > delta
            size = np.where(r == 0, 1.0, np.abs(r))
            return np.where(far, 2 * delta * np.abs(r) - delta**2, r * r), np.where(far, delta / size, 1.0)
        case "soft_l1":
            root = np.sqrt(1 + (r / delta) ** 2)
            return 2 * r * r / (root + 1), 1 / root
        case "excess":
            return np.where(r > 0, r * r, 0.0), np.where(r > 0, 1.0, 0.0)
    raise AssertionError(f"the loss {kind} is missing in tests/native/reference.py")


@dataclass(frozen=True)
class Compiled:
    """A case made ready: the lowered graph, its kernel, and the samples in the kernel's order."""

    case: Case
    lowered: LoweredGraph
    kernel: Kernel
    samples: Samples

    @property
    def values(self):
        return self.kernel.values.pack(self.case.parameters)

    def accumulator(self, **options) -> Accumulator:
        return Accumulator(self.kernel, self.samples, **options)

    def interpreter(self, widths=()) -> Interpreter:
        return Interpreter(self.lowered, self.case.parameters, widths)

    def free_offsets(self):
        values = self.kernel.values
        return {n: at for n, at in (values.offsets | values.moving).items() if at < values.free}

    def run(self, interpreter):
        """Outputs [samples, outputs] and Jacobian [samples, outputs, free], side by side in the last axis."""
        rows = interpreter.rows(self.kernel.line, self.free_offsets(), self.case.columns, self.case.starts)
        width = sum(sizes_of(self.free_offsets(), self.case.parameters))
        assert width == self.kernel.values.free
        return np.concatenate([rows.values[:, :, None], rows.jacobian], axis=2)


def compiled(case: Case, smooth=()) -> Compiled:
    """Lower and compile a case."""
    low = lower_lookups(case.graph, case.parameters, smooth)
    outputs = [Output(low.graph.names[c.node], c.scale, c.loss, c.delta) for c in case.criteria]
    kernel = Kernel(low, outputs, case.parameters, case.fitted)
    return Compiled(case, low, kernel, samples_of(case, kernel))


def samples_of(case: Case, kernel: Kernel) -> Samples:
    """The data of a case, its channels in the kernel's order."""
    data = np.array([case.columns[name] for name in kernel.layout.inputs]).reshape(-1, case.samples)
    pieces = tuple(
        Piece(a, b, np.array([c.scores[i] for c in case.criteria]))
        for i, (a, b) in enumerate(zip(case.starts, case.ends, strict=True))
    )
    return Samples(data, np.array([c.target for c in case.criteria]), pieces)


@dataclass(frozen=True)
class Scored:
    """Residuals [samples] of one criterion, over its scale, with weights of rho and of the equivalent square."""

    residual: np.ndarray
    score: np.ndarray
    loss: np.ndarray
    weight: np.ndarray
    scored: np.ndarray


def scored(case: Case, criterion: Criterion, values: np.ndarray) -> Scored:
    """Return residual, score and weights of each value of a criterion's node."""
    score = np.concatenate(
        [np.full(b - a, s) for a, b, s in zip(case.starts, case.ends, criterion.scores, strict=True)]
    )
    with np.errstate(all="ignore"):
        r = (values - criterion.target) / criterion.scale
        rho, weight = loss(r, criterion.loss, criterion.delta)
    return Scored(r, score, rho, weight * score, ~np.isnan(criterion.target))


@dataclass(frozen=True)
class Sums:
    """Costs [outputs], gradient [free], matrix [free, free]."""

    costs: np.ndarray
    gradient: np.ndarray
    matrix: np.ndarray


def sums(case: Case, outputs: np.ndarray) -> Sums:
    """Direct sums over the rows of `Compiled.run`."""
    free = outputs.shape[2] - 1
    costs, gradient, matrix = np.zeros(len(case.criteria)), np.zeros(free), np.zeros((free, free))
    for at, criterion in enumerate(case.criteria):
        s = scored(case, criterion, outputs[:, at, 0])
        on = s.scored
        jacobian = outputs[on, at, 1:] / criterion.scale
        with np.errstate(all="ignore"):
            costs[at] = (s.score * s.loss)[on].sum()
            gradient += jacobian.T @ (s.weight * s.residual)[on]
            matrix += jacobian.T @ (s.weight[on, None] * jacobian)
    return Sums(costs, gradient, matrix)


def weighted_rows(case: Case, outputs: np.ndarray):
    """Residuals and rows times the root of their weight, as `Accumulator.rows` gives them; 0 where not scored."""
    residual, jacobian = outputs[:, :, 0].copy(), outputs[:, :, 1:].copy()
    for at, criterion in enumerate(case.criteria):
        s = scored(case, criterion, outputs[:, at, 0])
        root = np.sqrt(s.weight)
        with np.errstate(all="ignore"):
            residual[:, at] = np.where(s.scored, root * s.residual, 0.0)
            rows = root[:, None] * outputs[:, at, 1:] / criterion.scale
        jacobian[:, at] = np.where(s.scored[:, None], rows, 0.0)
    return residual, jacobian

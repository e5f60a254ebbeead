"""How the outputs of a model count: residuals and losses in LLVM IR."""

from dataclasses import dataclass
from typing import Literal

from kennfeld.native.emitter import Step
from kennfeld.native.ir import Function, literal
from kennfeld.native.rows import load_sample

__all__ = ["Loss", "Output", "counts", "loss_of", "scaled_residual", "weighted"]

Loss = Literal["square", "huber", "soft_l1", "excess"]
ZERO = literal(0.0)


@dataclass(frozen=True)
class Output:
    """How the difference between a node and its target counts; node `weight` is a factor on the loss of each sample."""

    node: int
    scale: float = 1.0
    loss: Loss = "square"
    delta: float = 1.0
    weight: int | None = None

    @property
    def nodes(self) -> tuple[int, ...]:
        """The nodes that its loss needs."""
        return (self.node,) if self.weight is None else (self.node, self.weight)


def scaled_residual(step: Step, at: int, output: Output) -> tuple[str, str]:
    """(value - target) / scale, and whether the sample is scored: a target of NaN is not."""
    f = step.f
    target, scored = _target(f, at)
    difference = f.new(f"fsub double {step.value(output.node)}, {target}")
    return f.fmul(difference, literal(1.0 / output.scale)), scored


def _target(f: Function, at: int) -> tuple[str, str]:
    """The target of an output, and whether there is one."""
    target = load_sample(f, "%targets", at, "%k")
    return target, f.new(f"fcmp ord double {target}, {target}")


def counts(f: Function, at: int) -> str:
    """Whether an output has a target and a weight: what is switched off does not count, even where it is not finite."""
    weighted = f.new(f"fcmp one double {f.load('%scores', at)}, {ZERO}")
    return f.new(f"and i1 {_target(f, at)[1]}, {weighted}")


def weighted(step: Step, factor: str, output: Output) -> str:
    """A factor of the loss, times the weight of the sample."""
    return factor if output.weight is None else step.f.fmul(factor, step.value(output.weight))


def loss_of(f: Function, r: str, output: Output) -> tuple[str, str]:
    """The loss of a residual, and its slope over 2 r, the weight of the equivalent square."""
    square = f.fmul(r, r)
    delta = literal(output.delta)
    match output.loss:
        case "square":
            return square, literal(1.0)
        case "huber":
            size = f.new(f"call double @llvm.fabs.f64(double {r})")
            beyond = f.new(f"fcmp ogt double {size}, {delta}")
            line = f.fmul(delta, f.new(f"fsub double {f.fmul(literal(2.0), size)}, {delta}"))
            return f.select(beyond, line, square), f.select(beyond, f.new(f"fdiv double {delta}, {size}"), literal(1.0))
        case "soft_l1":
            ratio = f.new(f"fdiv double {r}, {delta}")
            share = f.fmul(ratio, ratio)
            root = f.new(f"call double @llvm.sqrt.f64(double {f.new(f'fadd double {literal(1.0)}, {share}')})")
            # 2 r^2 / (root + 1) is 2 delta^2 (root - 1) without the cancellation
            loss = f.new(f"fdiv double {f.fmul(literal(2.0), square)}, {f.fadd(root, literal(1.0))}")
            return loss, f.new(f"fdiv double {literal(1.0)}, {root}")
        case "excess":
            beyond = f.new(f"fcmp ogt double {r}, {ZERO}")
            return f.select(beyond, square, ZERO), f.select(beyond, literal(1.0), ZERO)

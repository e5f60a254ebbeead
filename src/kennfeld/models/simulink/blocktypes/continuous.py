"""Continuous states, which the solver advances."""

from collections.abc import Iterable

import numpy as np

from kennfeld.models.simulink.expressions.arrays import fold
from kennfeld.models.simulink.expressions.signals import Nodes, Signal, Wired, scalar
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block
from kennfeld.models.simulink.weaving.site import Site

__all__ = [
    "applied",
    "fed_through",
    "matrices",
    "passes",
    "rational",
    "reset_signal",
    "resetting",
    "scaled",
    "with_saturation",
]


def resetting(site: Site) -> str:
    """The kind of external reset, "none" where there is none."""
    kind = site.text("ExternalReset")
    return "none" if kind.casefold() == "none" else kind


def _integrator_needs(site: Site) -> Iterable[int]:
    return range(1, site.count)


@block("Integrator", needs=_integrator_needs, InitialCondition="0", InitialConditionSource="internal",
       ExternalReset="none", LimitOutput="off", UpperSaturationLimit="inf", LowerSaturationLimit="-inf",
       ShowSaturationPort="off", ShowStatePort="off", WrapState="off")  # fmt: skip
def integrator(site: Site) -> Wired | tuple[Wired, ...]:
    """The integral of the input over time, reset on demand, within limits."""
    if site.on("WrapState"):
        raise UnsupportedError("WrapState is on, which is not supported")
    kind = resetting(site)
    external = site.text("InitialConditionSource") == "external"
    init = site.input(site.count - 1) if external else site.parameter("InitialCondition")
    limits = None
    if site.on("LimitOutput"):
        limits = (site.parameter("LowerSaturationLimit"), site.parameter("UpperSaturationLimit"))
    reset = reset_signal(site, site.input(1), kind) if kind != "none" else None
    x = site.integrate(init, lambda _: site.input(0), reset, limits, ported=True)
    return with_saturation(site, x if limits is None else site.clip(x, *limits))


def with_saturation(site: Site, y: Signal) -> Wired | tuple[Wired, ...]:
    """The output of an integrator, and on demand whether it is at a limit: 1 the upper, -1 the lower."""
    return (y, _saturated(site, y)) if site.on("ShowSaturationPort") else y


def _saturated(site: Site, y: Signal) -> Signal:
    if not site.on("LimitOutput"):
        return site.call("mul", site.constant(0.0), y)
    low, high = site.parameter("LowerSaturationLimit"), site.parameter("UpperSaturationLimit")
    below = site.select(site.call("le", y, low), site.constant(-1.0), site.constant(0.0))
    return site.select(site.call("ge", y, high), site.constant(1.0), below)


def reset_signal(site: Site, u: Signal, kind: str, sampled: bool = False) -> Signal:
    """1 where an external reset takes place; a `sampled` one looks at no more than whether a signal is positive."""
    u, zero = site.discrete(u), site.constant(0.0)
    kind = kind.casefold()
    if kind in ("rising", "falling", "either"):
        return site.sampled_edge(u, kind) if sampled else site.edge(u, kind)
    if kind in ("level hold", "sampled level"):
        return site.call("ne", u, zero)
    if kind == "level":
        before = site.remember(zero, lambda _: u)
        return site.call("or", site.call("ne", u, zero), site.call("ne", before, zero))
    raise UnsupportedError(f"its reset is {kind!r}, which is not supported")


@block("TransferFcn", needs=lambda site: _through(site), Numerator="[1]", Denominator="[1 2 1]")
def transfer_function(site: Site) -> Wired:
    """b(s)/a(s) in controllable form, from zero states."""
    numerator, denominator = site.matrix("Numerator"), site.matrix("Denominator").ravel()
    if numerator.shape[0] != 1:
        raise UnsupportedError("its numerator has several rows, for several outputs")
    return rational(site, [int(n) for n in numerator.ravel()], [int(n) for n in denominator])


def rational(site: Site, numerator: list[int], denominator: list[int]) -> Signal:
    """The quotient of two polynomials in s, by their coefficients with the highest power first, from zero states."""
    order = len(denominator) - 1
    b = [scaled(site, node, denominator[0]) for node in _padded(site, numerator, order + 1)]
    a = [scaled(site, node, denominator[0]) for node in denominator[1:]]
    if order == 0:
        return site.call("mul", scalar(b[0]), site.input())
    A = np.full((order, order), site.loom.const(0.0), dtype=np.int64)
    A[0, :] = [site.loom.call("neg", node) for node in a]
    for row in range(1, order):
        A[row, row - 1] = site.loom.const(1.0)
    B = np.array([[site.loom.const(1.0)]] + [[site.loom.const(0.0)]] * (order - 1), dtype=np.int64)
    gains = [site.loom.call("sub", b[i + 1], site.loom.call("mul", a[i], b[0])) for i in range(order)]
    zeros = Signal(np.full((order,), site.loom.const(0.0), dtype=np.int64))
    return _state_space(site, A, B, np.array([gains], dtype=np.int64), np.array([[b[0]]], dtype=np.int64), zeros)


def _through(site: Site) -> Iterable[int]:
    return (0,) if passes(site) else ()


def passes(site: Site) -> bool:
    """Whether a transfer function passes its input through: its numerator has the order of its denominator."""
    numerator = site.matrix("Numerator")
    same_order = numerator.shape[-1] >= site.matrix("Denominator").size
    return same_order and any(site.loom.value(int(node)) != 0 for node in numerator[..., 0])


def _padded(site: Site, nodes: list[int], count: int) -> list[int]:
    if len(nodes) > count:
        raise UnsupportedError("the order of its numerator is above that of its denominator")
    return [site.loom.const(0.0)] * (count - len(nodes)) + nodes


def scaled(site: Site, node: int, lead: int) -> int:
    """A coefficient over the leading one; one that is 0 stays 0 whatever that is."""
    return node if site.loom.value(node) == 0 else site.loom.call("div", node, lead)


@block("StateSpace", needs=lambda site: fed_through(site), A="1", B="1", C="1", D="1", InitialCondition="0",
       X0="0")  # fmt: skip
def state_space(site: Site) -> Wired:
    """The state space model x' = A x + B u, y = C x + D u."""
    A, B, C, D, first = matrices(site)
    return _state_space(site, A, B, C, D, first)


def fed_through(site: Site) -> tuple[int, ...]:
    """The input of a state space model, where its output depends on it within the step."""
    return (0,) if any(site.loom.value(int(node)) != 0 for node in site.matrix("D").ravel()) else ()


def _state_space(site: Site, A: Nodes, B: Nodes, C: Nodes, D: Nodes, init: Signal) -> Signal:
    def slope(x: Signal) -> Signal:
        return site.call("add", applied(site, A, x), applied(site, B, site.input()))

    x = site.integrate(init, slope, None, None)
    y = applied(site, C, x)
    if all(site.loom.value(int(node)) == 0 for node in D.ravel()):
        return y
    return site.call("add", y, applied(site, D, site.input()))


def matrices(site: Site) -> tuple[Nodes, Nodes, Nodes, Nodes, Signal]:
    """The matrices A, B, C and D of a state space model, and its initial values."""
    A, B, C, D = (site.matrix(name) for name in "ABCD")
    key = "InitialCondition" if site.atom.block.value("InitialCondition") is not None else "X0"
    init = site.parameter(key)
    first = Signal(np.full((A.shape[0],), init.flat[0], dtype=np.int64)) if init.size == 1 else init
    if A.shape[0] != A.shape[1] or first.size != A.shape[0]:
        raise UnsupportedError(f"A of {A.shape} and {first.size} initial values do not fit each other")
    return A, B, C, D, first


def applied(site: Site, matrix: Nodes, x: Signal) -> Signal:
    """A matrix times a vector."""
    if matrix.shape[1] != x.size:
        raise UnsupportedError(f"a matrix of {matrix.shape} does not fit a vector of {x.size}")
    rows = [
        fold(site.loom, "add", [site.loom.call("mul", int(a), b) for a, b in zip(row, x.flat, strict=True)])
        for row in matrix
    ]
    return Signal(np.array(rows, dtype=np.int64), x.period)


@block("Derivative", CoefficientInTFapproximation="inf")
def derivative(site: Site) -> Wired:
    """The change of the input since the major step before over the time between; 0 at first."""
    u = site.discrete(site.input())
    before = site.remember(u, lambda _: u)
    return site.call("div", site.call("sub", u, before), site.major_step)

"""Filters at the hits of a sample time: quotients of polynomials in z or in 1/z."""

from collections.abc import Iterable
from functools import cached_property

from kennfeld.models.simulink.blocktypes.continuous import passes, reset_signal, resetting, scaled
from kennfeld.models.simulink.expressions.signals import CONSTANT, Signal, Wired, scalar
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block
from kennfeld.models.simulink.weaving.site import Site, Then

__all__ = ["direct_form"]


def _first_order(site: Site) -> Iterable[int]:
    """A transfer function passes its input through where its numerator has the order of its denominator."""
    return range(0 if passes(site) else 1, site.count)


def _filter_needs(site: Site) -> Iterable[int]:
    """A filter passes its input through unless the first coefficient of its numerator is 0."""
    return range(1 if site.loom.value(int(site.matrix("Numerator").ravel()[0])) == 0 else 0, site.count)


@block("DiscreteTransferFcn", needs=_first_order, Numerator="[1]", Denominator="[1 0.5]", InitialStates="0",
       NumeratorSource="Dialog", DenominatorSource="Dialog", InitialStatesSource="Dialog", ExternalReset="None",
       FilterStructure="Direct form II", SampleTime="-1")  # fmt: skip
def discrete_transfer_function(site: Site) -> Wired:
    """b(z)/a(z) in powers of z, the highest first."""
    b, a = _coefficients(site)
    if b.size > a.size:
        raise UnsupportedError("the order of its numerator is above that of its denominator")
    zero = site.loom.const(0.0)
    return _filtered(site, [zero] * (a.size - b.size) + b.flat, a.flat)


@block("DiscreteFilter", needs=_filter_needs, Numerator="[1]", Denominator="[1 0.5]", InitialStates="0",
       NumeratorSource="Dialog", DenominatorSource="Dialog", InitialStatesSource="Dialog", ExternalReset="None",
       FilterStructure="Direct form II", SampleTime="-1")  # fmt: skip
def discrete_filter(site: Site) -> Wired:
    """b/a in powers of 1/z, the lowest first."""
    b, a = _coefficients(site)
    size = max(b.size, a.size)
    zero = site.loom.const(0.0)
    return _filtered(site, b.flat + [zero] * (size - b.size), a.flat + [zero] * (size - a.size))


_FIR_STRUCTURES = (
    "Direct form", "Direct form symmetric", "Direct form antisymmetric", "Direct form transposed",
)  # fmt: skip


@block("DiscreteFir", Coefficients="[0.5 0.5]", InitialStates="0", CoefSource="Dialog", ExternalReset="None",
       FilterStructure="Direct form", ShowEnablePort="off", SampleTime="-1")  # fmt: skip
def fir_filter(site: Site) -> Wired:
    """B in powers of 1/z, the lowest first."""
    site.chosen("CoefSource", "Dialog", "Dialog parameters")
    kind = site.chosen("FilterStructure", *_FIR_STRUCTURES)
    _check_starts(site, kind != "Direct form transposed")
    if site.on("ShowEnablePort"):
        raise UnsupportedError("it has an enable port")
    b = _row(site, "Coefficients").flat
    return _filtered(site, b, [site.loom.const(1.0)] + [site.loom.const(0.0)] * (len(b) - 1))


def _coefficients(site: Site) -> tuple[Signal, Signal]:
    site.chosen("NumeratorSource", "Dialog")
    site.chosen("DenominatorSource", "Dialog")
    site.chosen("InitialStatesSource", "Dialog")
    _check_starts(site, site.text("FilterStructure") == "Direct form II")
    return _row(site, "Numerator"), _row(site, "Denominator")


def _row(site: Site, name: str) -> Signal:
    """The coefficients of one filter."""
    found = site.parameter(name)
    if found.nodes.ndim > 1:
        raise UnsupportedError(f"its {name} is a matrix of {found.shape[0]} filters")
    return found


def _check_starts(site: Site, known: bool) -> None:
    """Raise `UnsupportedError` where states begin with values in a structure whose states are others than here."""
    if not known and any(site.loom.value(node) != 0 for node in site.parameter("InitialStates").flat):
        raise UnsupportedError(f"its states in the {site.text('FilterStructure').lower()} have initial values")


def _filtered(site: Site, b: list[int], a: list[int]) -> Signal:
    kind = resetting(site)
    anew = reset_signal(site, site.input(1), kind) if kind != "none" else None
    return direct_form(site, b, a, site.parameter("InitialStates"), anew)


def direct_form(site: Site, b: list[int], a: list[int], inits: Signal, anew: Signal | None = None) -> Signal:
    """Direct form II: states w of the hits before, w = u - a1 w1 - ..., y = b0 w + b1 w1 + ..., for each element.

    The coefficients are those over a0, w is a0 times the state. `inits` are the states at first, and where they begin
    `anew`.
    """
    lead = a[0]
    order, ahead = len(a) - 1, [scaled(site, node, lead) for node in b]
    line = _Line(site, [scaled(site, node, lead) for node in a[1:]])
    states = line.remembered(_starts(site, inits, order, lead), anew)
    terms = [site.call("mul", scalar(node, CONSTANT), state) for node, state in zip(ahead[1:], states, strict=True)]
    if site.loom.value(ahead[0]) != 0:
        terms.insert(0, site.call("mul", scalar(ahead[0], CONSTANT), line.entering))
    return site.fold("add", terms) if terms else site.constant(0.0)


def _starts(site: Site, inits: Signal, order: int, lead: int) -> list[Signal]:
    """What the states begin with, times the leading coefficient."""
    if inits.size not in (1, order) and order:
        raise UnsupportedError(f"it has {inits.size} initial states for an order of {order}")
    found = [scalar(site.loom.call("mul", lead, node)) for node in inits.flat]
    return found * order if inits.size == 1 else found[:order]


class _Line:
    """The delay line of a filter: what enters it in this hit, and what has entered in those before."""

    def __init__(self, site: Site, back: list[int]) -> None:
        self.site = site
        self.back = back
        self.states: list[Signal] = []

    def remembered(self, first: list[Signal], anew: Signal | None) -> list[Signal]:
        """The states, the youngest first; `first` at first, and where they begin anew."""
        site = self.site
        found = [site.remember(one, self._following(at)) for at, one in enumerate(first)]
        if anew is not None:
            found = [site.select(anew, one, state) for one, state in zip(first, found, strict=True)]
        self.states += found
        return found

    def _following(self, at: int) -> Then:
        return lambda _: self.entering if at == 0 else self.states[at - 1]

    @cached_property
    def entering(self) -> Signal:
        """The input less what is fed back, w = u - a1 w1 - ..."""
        w = self.site.discrete(self.site.input())
        for node, state in zip(self.back, self.states, strict=True):
            w = self.site.call("sub", w, self.site.call("mul", scalar(node, CONSTANT), state))
        return w

"""Signals passed on between sample times: held for a slower one, a hit late for a faster one.

Where a transition need not be deterministic, a faster sample time sees what the slower one has left last: that of the
same step in a single task, that of the step before where each sample time is a task of its own.
"""

from collections.abc import Iterator
from dataclasses import replace

from kennfeld.models.simulink.expressions.signals import CONSTANT, CONTINUOUS, Bus, OpenBus, Signal, Wired
from kennfeld.models.simulink.files.tree import Block
from kennfeld.models.simulink.flattening.atoms import Atom
from kennfeld.models.simulink.weaving.registry import KINDS, UnsupportedError, block
from kennfeld.models.simulink.weaving.schedule import IN_TIME, Rate
from kennfeld.models.simulink.weaving.site import Site

_NEAR = 1e-6  # of a sample time, as far as it may be rounded
_OPTIONS = ("Specify", "Inherit", "Multiple of input port sample time")


def _sample_of_output(one: Block) -> str:
    """The parameter with the sample time of the output, where one may be stated."""
    return "OutPortSampleTime" if (one.value("OutPortSampleTimeOpt") or "Specify") == "Specify" else ""


@block("RateTransition", sample=_sample_of_output, held=False, Integrity="on", Deterministic="on", X0="0",
       OutPortSampleTimeOpt="Specify", OutPortSampleTime="-1", OutPortSampleTimeMultiple="1")  # fmt: skip
def rate_transition(site: Site) -> Wired:
    """The signal itself; a slower sample time holds it, a faster one sees it a hit of its own late.

    Where no sample time is stated for the output, it is the shortest one that the blocks behind it state.
    """
    return _passed(site, site.wired(0))


def _passed(site: Site, wired: Wired) -> Wired:
    if isinstance(wired, OpenBus):
        return wired
    if isinstance(wired, Bus):
        return Bus({name: _passed(site, member) for name, member in wired.members.items()})
    if wired.period == CONSTANT:
        return wired
    wanted = _stated(site, wired)
    if wanted is not None and wanted > wired.period * (1 + _NEAR):
        return site.weaver.timing.held(site.atom, wired, Rate(wanted))
    wanted = min(_behind(site), default=wired.period) if wanted is None else wanted
    if wanted >= wired.period * (1 - _NEAR):
        return wired
    if site.on("Integrity") and site.on("Deterministic"):
        return replace(_late(site, wired), period=wanted)
    return _at_own_hits(site, _as_tasks_leave_it(site, wired), wanted)


def _as_tasks_leave_it(site: Site, u: Signal) -> Signal:
    """A slower signal as a faster task reads it, which runs before the slower one where both are hit."""
    tasks = site.weaver.clock.multitasking
    if tasks is None:
        site.remark(
            "passes on what a slower sample time makes in the same step, as in a single task; the file does not say "
            "whether each sample time is a task of its own, where it would be what the step before has left. Set "
            "Deterministic, or the model's SolverMode or EnableMultiTasking"
        )
    return site.remember(_initial(site), lambda _: u) if tasks else u


def _at_own_hits(site: Site, u: Signal, period: float) -> Signal:
    """A signal that changes at the hits of a sample time only."""
    if period == CONTINUOUS:
        return replace(u, period=period)
    return site.weaver.timing.held(site.atom, u, Rate(period))


def _stated(site: Site, u: Signal) -> float | None:
    """The sample time that is stated for the output; None where it is inherited."""
    if site.chosen("OutPortSampleTimeOpt", *_OPTIONS) != "Multiple of input port sample time":
        return site.weaver.timing.stated_period(site.atom)
    if u.period == CONTINUOUS:
        raise UnsupportedError("its sample time is a multiple of that of its input, which states none")
    return u.period * site.number("OutPortSampleTimeMultiple")


def _behind(site: Site) -> Iterator[float]:
    """The sample times that blocks behind it state, those that come first on each way."""
    seen, waiting = set[Atom](), [site.atom]
    while waiting:
        for reader in site.weaver.flat.readers.get(waiting.pop(), ()):
            kind, period = KINDS.get(reader.kind), site.weaver.timing.stated_period(reader)
            if reader in seen or (kind is not None and kind.sink) or reader.kind == "RateTransition":
                continue
            seen.add(reader)
            if reader.kind in IN_TIME:
                yield CONTINUOUS
            elif period is None or period == CONSTANT:
                waiting.append(reader)
            else:
                yield period


def _late(site: Site, u: Signal) -> Signal:
    """What a signal was before the last hit of its own sample time; an initial value before the first."""
    init = _initial(site)
    made: list[Signal] = []
    before, shown = site.remember(init, lambda _: u), site.remember(init, lambda _: made[0])
    made.append(site.select(site.weaver.timing.hits(u.period), before, shown))
    return made[0]


def _initial(site: Site) -> Signal:
    """What a faster sample time sees before the first hit of the slower one."""
    return site.parameter("InitialCondition" if site.atom.block.value("InitialCondition") is not None else "X0")

"""Subsystems that do not run in every step, and what decides and joins them."""

from collections.abc import Sequence

from kennfeld.models.simulink.blocktypes.continuous import reset_signal
from kennfeld.models.simulink.blocktypes.places import cases_of
from kennfeld.models.simulink.expressions.arrays import fold
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.expressions.signals import Bus, OpenBus, Signal, Wired, fastest, scalar
from kennfeld.models.simulink.flattening.atoms import Source, resets
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block
from kennfeld.models.simulink.weaving.site import Site, resized

__all__ = ["restart"]


@block("Control")
def control(site: Site) -> tuple[Wired, ...]:
    """Whether a conditional subsystem runs, and whether the memories in it begin anew."""
    ports = [port for port in site.atom.special if port != "reset"]
    conditions = {port: _condition(site, port, _at(site, port)) for port in ports}
    outer = site.weaver.gates.active(site.atom)
    if outer is not None:
        conditions["outer"] = scalar(outer)
    active = _all(site, list(conditions.values()))
    if "trigger" not in conditions:
        return active, restart(site, active)
    triggered = _all(site, [conditions[port] for port in ("trigger", "outer") if port in conditions])
    return active, restart(site, active, triggered)


def _at(site: Site, port: str) -> Signal:
    """The signal at one of the special ports, which are the inputs in their order."""
    return site.input(list(site.atom.special).index(port))


def _all(site: Site, conditions: list[Signal]) -> Signal:
    return site.weaver.timing.at_major(site.fold("and", conditions or [site.constant(1.0)]))


def restart(site: Site, active: Signal, triggered: Signal | None = None) -> Signal:
    """1 where the memories of a subsystem begin anew: those around it do, it is enabled again, or it is reset.

    Whether a subsystem with a trigger is enabled is only seen where it is `triggered`.
    """
    around = site.weaver.gates.restart(site.atom)
    events = [] if around is None else [scalar(around)]
    if resets(site.atom):
        events.append(_enabled_again(site, active, triggered))
    if "reset" in site.atom.special:
        port = site.atom.special["reset"]
        events.append(reset_signal(site, _at(site, "reset"), port.value("ResetTriggerType") or "level"))
    return site.fold("or", events) if events else site.constant(0.0)


def _enabled_again(site: Site, active: Signal, triggered: Signal | None) -> Signal:
    """1 where a subsystem runs that was not enabled when that was last seen."""
    made: list[Signal] = []
    before = site.weaver.memories.always_later(site, site.constant(0.0), lambda: made[0])
    made.append(active if triggered is None else site.select(triggered, active, before))
    return site.call("and", active, site.call("not", before))


def _condition(site: Site, port: str, u: Signal) -> Signal:
    special = site.atom.special[port]
    zero = site.constant(0.0)
    if port == "enable":
        return _any(site, site.call("gt", u, zero))
    kind = special.value("TriggerType") or "rising"
    if port == "ifaction" or kind == "function-call":
        if u.size > 1:
            mend = "Give each caller a subsystem of its own."
            raise UnsupportedError(f"{u.size} calls arrive at its {port} port, which is not supported", mend)
        return site.call("ne", u, zero)
    if kind not in ("rising", "falling", "either"):
        raise UnsupportedError(f"TriggerType is {kind!r}, which is not supported")
    return _any(site, site.edge(site.weaver.timing.at_major(u), kind))


def _any(site: Site, truths: Signal) -> Signal:
    """1 where one of the elements is: a control signal that is a vector counts by any of them."""
    return scalar(fold(site.loom, "or", truths.flat), truths.period)


@block("Held", InitialOutput="[]", OutputWhenDisabled="held")
def held(site: Site) -> Wired:
    """An output of a conditional subsystem: what it computes while it runs, else what it was or the initial value."""
    return _held(site, site.wired(0))


def _held(site: Site, wired: Wired) -> Wired:
    wired = wired.signal if isinstance(wired, OpenBus) else wired
    if isinstance(wired, Bus):
        return Bus({name: _held(site, member) for name, member in wired.members.items()})
    init = site.initial_output() or site.constant(0.0)
    active = site.weaver.gates.active(site.atom)
    if active is None:
        return wired
    runs = scalar(active, wired.period)
    init = Signal(resized(init.nodes, wired.shape))
    control_of = site.atom.control
    resettable = control_of is not None and "trigger" not in control_of.special
    if site.text("OutputWhenDisabled") == "reset" and resettable:
        return site.select(runs, wired, init)
    made: list[Signal] = []
    before = site.weaver.memories.always_later(site, init, lambda: made[0])
    made.append(site.select(runs, wired, before))
    return made[0]


@block("Merge", Inputs="2", InitialOutput="[]")
def merge(site: Site) -> Wired:
    """The output of the subsystem that ran last; of several that run in a step, of the last one."""
    sources = [source for source in site.atom.inputs if source is not None]
    init = _merged_initially(site, sources)
    return _merged(site, init, [_runs(site, source) for source in sources], [site.weaver.value(s) for s in sources])


def _merged(site: Site, init: Signal, running: list[Signal], arriving: list[Wired]) -> Wired:
    buses = [wired for wired in arriving if isinstance(wired, Bus) and not isinstance(wired, OpenBus)]
    if not buses:
        signals = [wired.signal if isinstance(wired, OpenBus) else wired for wired in arriving]
        return _last(site, init, running, [signal for signal in signals if isinstance(signal, Signal)])
    names = list(buses[0].members)
    if len(buses) < len(arriving) or any(list(bus.members) != names for bus in buses):
        raise UnsupportedError("it merges buses that do not have the same signals")
    return Bus({name: _merged(site, init, running, [bus.members[name] for bus in buses]) for name in names})


def _last(site: Site, init: Signal, running: list[Signal], signals: list[Signal]) -> Signal:
    """The last of those signals whose subsystem runs, else what was there before."""
    made: list[Signal] = []
    y = site.weaver.memories.always_later(site, site.spread(init, *signals)[0], lambda: made[0])
    for runs, signal in zip(running, signals, strict=True):
        y = site.select(runs, signal, y)
    made.append(y)
    return y


def _merged_initially(site: Site, sources: Sequence[Source]) -> Signal:
    """What a Merge begins with: its own initial output, else the last one that the outputs before it state."""
    stating = [site, *(site.weaver.site(source.atom) for source in reversed(sources) if source.atom.kind == "Held")]
    for one in stating:
        if (stated := one.initial_output()) is not None:
            return stated
    return site.constant(0.0)


def _runs(site: Site, source: Source) -> Signal:
    if source.atom.kind != "Held" or source.atom.control is None:
        raise UnsupportedError(f"its input from {source.atom.path} is not the output of a conditional subsystem")
    return site.weaver.signal(Source(source.atom.control, 0))


@block("If", IfExpression="u1 > 0", ElseIfExpressions="", ShowElse="on", NumInputs="1", SampleTime="-1")
def if_block(site: Site) -> tuple[Wired, ...]:
    """For each output whether it is the first whose condition holds."""
    texts = [site.text("IfExpression"), *(t for t in site.text("ElseIfExpressions").split(",") if t.strip())]
    names = {f"u{at + 1}": site.input(at).nodes.reshape(-1, 1) for at in range(site.count)}
    outputs: list[Wired] = []
    none = site.constant(1.0)
    for text in texts:
        try:
            nodes = site.weaver.expressions.array(text, site.atom.scope, names=names)
        except NoValueError as error:
            raise UnsupportedError(
                f"its condition {text[:60]} cannot be built: {error}", undefined=error.undefined
            ) from None
        if nodes.size != 1:
            raise UnsupportedError(f"its condition {text[:60]} has {nodes.size} values where one is expected")
        holds = Signal(nodes.ravel(), fastest([one.period for one in site.inputs]))
        outputs.append(site.call("and", none, holds))
        none = site.call("and", none, site.call("not", holds))
    return (*outputs, none) if site.on("ShowElse") else tuple(outputs)


@block("SwitchCase", CaseConditions="{1}", ShowDefaultCase="on", CaseShowDefault="on", SampleTime="-1")
def switch_case(site: Site) -> tuple[Wired, ...]:
    """For each output whether the input is among its cases; the last one where it is among none."""
    u = site.truncated(site.input())
    outputs: list[Wired] = []
    none = site.constant(1.0)
    for cases in cases_of(site, "CaseConditions"):
        holds = site.among(u, cases)
        outputs.append(site.call("and", none, holds))
        none = site.call("and", none, site.call("not", holds))
    return (*outputs, none)


@block("Function-Call Generator", sample_time="1", numberOfIterations="1")
def function_call_generator(site: Site) -> Wired:
    """A call at each hit of its sample time."""
    if site.number("numberOfIterations") != 1:
        raise UnsupportedError("it calls several times in a step")
    return site.weaver.timing.hits(site.number("sample_time"))

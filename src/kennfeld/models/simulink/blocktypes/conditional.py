"""Subsystems that do not run in every step, and what decides and joins them."""

import numpy as np

from kennfeld.models.simulink.blocktypes.continuous import reset_signal
from kennfeld.models.simulink.blocktypes.places import cases_of
from kennfeld.models.simulink.blocktypes.registry import UnsupportedError, block
from kennfeld.models.simulink.expressions import NoValueError, fold
from kennfeld.models.simulink.flatten import Source, resets
from kennfeld.models.simulink.signals import Bus, OpenBus, Signal, Wired
from kennfeld.models.simulink.site import Site

__all__ = ["restart"]


@block("Control")
def control(site: Site) -> tuple[Wired, ...]:
    """Whether a conditional subsystem runs, and whether the memories in it begin anew."""
    special = list(site.atom.special)
    conditions = [_condition(site, port, site.input(at)) for at, port in enumerate(special) if port != "reset"]
    active = site.weaver.at_major(site.fold("and", conditions or [site.constant(1.0)]))
    outer = site.weaver.active(site.atom)
    if outer is not None:
        active = site.call("and", Signal(np.array([outer], dtype=np.int64)), active)
    return active, restart(site, active)


def restart(site: Site, active: Signal) -> Signal:
    """1 where the memories of a subsystem begin anew: those around it do, it is enabled again, or it is reset."""
    around = site.weaver.restart(site.atom)
    events = [] if around is None else [Signal(np.array([around], dtype=np.int64))]
    if resets(site.atom):
        before = site.weaver.always(site, site.constant(0.0), active)
        events.append(site.call("and", active, site.call("not", before)))
    if "reset" in site.atom.special:
        port = site.atom.special["reset"]
        signal = site.input(list(site.atom.special).index("reset"))
        events.append(reset_signal(site, signal, port.value("ResetTriggerType") or "level"))
    return site.fold("or", events) if events else site.constant(0.0)


def _condition(site: Site, port: str, u: Signal) -> Signal:
    special = site.atom.special[port]
    zero = site.constant(0.0)
    if port == "enable":
        truths = site.call("gt", u, zero)
        return Signal(np.array([fold(site.loom, "or", truths.flat)], dtype=np.int64), u.period)
    if port == "ifaction":
        return site.call("ne", u, zero)
    kind = special.value("TriggerType") or "rising"
    if kind == "function-call":
        return site.call("ne", u, zero)
    if kind not in ("rising", "falling", "either"):
        raise UnsupportedError(f"TriggerType is {kind!r}, which is not supported")
    return site.edge(site.weaver.at_major(u), kind)


@block("Held", InitialOutput="[]", OutputWhenDisabled="held")
def held(site: Site) -> Wired:
    """An output of a conditional subsystem: what it computes while it runs, else what it was or the initial value."""
    return _held(site, site.wired(0))


def _held(site: Site, wired: Wired) -> Wired:
    wired = wired.signal if isinstance(wired, OpenBus) else wired
    if isinstance(wired, Bus):
        return Bus({name: _held(site, member) for name, member in wired.members.items()})
    text = site.text("InitialOutput")
    init = site.constant(0.0) if text in ("[]", "") else site.parameter("InitialOutput")
    active = site.weaver.active(site.atom)
    if active is None:
        return wired
    runs = Signal(np.array([active], dtype=np.int64), wired.period)
    init = Signal(np.broadcast_to(init.nodes, wired.shape) if init.size == 1 else init.nodes.reshape(wired.shape))
    control_of = site.atom.control
    resettable = control_of is not None and "trigger" not in control_of.special
    if site.text("OutputWhenDisabled") == "reset" and resettable:
        return site.select(runs, wired, init)
    made: list[Signal] = []
    before = site.weaver.always_later(site, init, lambda: made[0])
    made.append(site.select(runs, wired, before))
    return made[0]


@block("Merge", Inputs="2", InitialOutput="[]")
def merge(site: Site) -> Wired:
    """The output of the subsystem that ran last; of several that run in a step, of the last one."""
    sources = [source for source in site.atom.inputs if source is not None]
    text = site.text("InitialOutput")
    init = site.constant(0.0) if text in ("[]", "") else site.parameter("InitialOutput")
    shape = site.weaver.value(sources[0]) if sources else init
    if not isinstance(shape, Signal):
        raise UnsupportedError("it merges buses")
    first = Signal(np.broadcast_to(init.nodes, shape.shape) if init.size == 1 else init.nodes)
    made: list[Signal] = []
    y = site.weaver.always_later(site, first, lambda: made[0])
    for source in sources:
        y = site.select(_runs(site, source), site.weaver.signal(source), y)
    made.append(y)
    return y


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
        holds = Signal(nodes.ravel()[:1], min(one.period for one in site.inputs))
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
    return site.weaver.hits(site.number("sample_time"))

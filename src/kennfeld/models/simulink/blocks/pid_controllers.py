"""PID controllers: P e + I integral(e) + D N (e - filter), in parallel or ideal form, continuous or discrete.

The ideal form multiplies the whole sum by P. Beside the sum there are limits of the output and of the integral, what
keeps the integral from winding up at them, resets, and the tracking of another signal.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from kennfeld.models.simulink.blocks.continuous import reset_signal, resetting
from kennfeld.models.simulink.flattening.flat_model import is_triggered
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.reader.model_tree import ModelBlock
from kennfeld.models.simulink.signals import Signal, SignalOrBus

_DEFAULTS = {
    "Controller": "PID", "TimeDomain": "Continuous-time", "Form": "Parallel", "P": "1", "I": "1", "D": "0", "N": "100",
    "UseFilter": "on", "IntegratorMethod": "Forward Euler", "FilterMethod": "Forward Euler", "SampleTime": "-1",
    "InitialConditionForIntegrator": "0", "InitialConditionForFilter": "0", "DifferentiatorICPrevScaledInput": "0",
    "ExternalReset": "none", "InitialConditionSource": "internal", "TrackingMode": "off", "Kt": "1", "Kb": "1",
    "ControllerParametersSource": "internal", "LimitOutput": "off", "SatLimitsSource": "internal",
    "LimitIntegrator": "off", "AntiWindupMode": "none", "UpperSaturationLimit": "inf",
    "LowerSaturationLimit": "-inf", "UpperIntegratorSaturationLimit": "inf", "LowerIntegratorSaturationLimit": "-inf",
    "InitialConditionSetting": "Auto", "UseExternalTs": "off", "UseKiTs": "off", "UseExternalDerivativeSource": "off",
}  # fmt: skip
_PLAIN = {
    "SatLimitsSource": ("internal",),
    "UseExternalTs": ("off",),
    "UseKiTs": ("off",),
    "UseExternalDerivativeSource": ("off",),
    "AntiWindupMode": ("none", "back-calculation", "clamping"),
    "InitialConditionSetting": ("Auto", "State (most efficient)", "State"),
}


def _sample(one: ModelBlock) -> str:
    """A continuous controller keeps the sample time of a discrete one, which does not count."""
    return "SampleTime" if one.value("TimeDomain") == "Discrete-time" else ""


def _ports(site: BlockContext, errors: int) -> dict[str, int]:
    """The inputs behind those of the error, by name."""
    return {name: errors + at for at, name in enumerate(_names(site))}


def _names(site: BlockContext) -> Iterator[str]:
    parts = _parts(site)
    filtered = "D" in parts and site.on("UseFilter")
    if site.chosen("ControllerParametersSource", "internal", "external") == "external":
        yield from parts
        yield from ["N"] if filtered else []
    if resetting(site) != "none":
        yield "reset"
    if site.chosen("InitialConditionSource", "internal", "external") == "external":
        yield from ["I0"] if "I" in parts else []
        yield from ["D0"] if filtered else []
    if site.on("TrackingMode"):
        yield "TR"


def _parts(site: BlockContext) -> str:
    return site.chosen("Controller", "PID", "PI", "PD", "P", "I")


def _needs(errors: int) -> Callable[[BlockContext], Iterable[int]]:
    """All inputs but the one that is tracked, which only moves the integral."""

    def needed(site: BlockContext) -> Iterable[int]:
        tracked = _ports(site, errors).get("TR")
        return [at for at in range(site.count) if at != tracked]

    return needed


@block("PID 1dof", needs=_needs(1), sample=_sample, **_DEFAULTS)  # type: ignore[arg-type]
def pid(site: BlockContext) -> SignalOrBus:
    """A PID controller of one degree of freedom."""
    e = site.input()
    return _PidController(site, _ports(site, 1)).output(e, e, e)


@block("PID 2dof", needs=_needs(2), sample=_sample, b="1", c="1", **_DEFAULTS)  # type: ignore[arg-type]
def pid_with_set_point(site: BlockContext) -> SignalOrBus:
    """A PID controller of two degrees of freedom: b r - y for P, r - y for I, c r - y for D."""
    if site.text("ControllerParametersSource") == "external":
        raise UnsupportedError("its gains are inputs")
    r, y = site.input(0), site.input(1)
    weighted = [site.call("sub", site.call("mul", site.parameter(name), r), y) for name in ("b", "c")]
    return _PidController(site, _ports(site, 2)).output(weighted[0], site.call("sub", r, y), weighted[1])


@dataclass
class _PidController:
    site: BlockContext
    ports: dict[str, int]

    def __post_init__(self) -> None:
        for name, known in _PLAIN.items():
            self.site.chosen(name, *known)
        self.parts = _parts(self.site)
        domain = self.site.chosen("TimeDomain", "Continuous-time", "Discrete-time")
        self.is_continuous = domain == "Continuous-time"
        self.is_ideal = self.site.chosen("Form", "Parallel", "Ideal") == "Ideal" and "P" in self.parts
        if not self.is_continuous and is_triggered(self.site.atom):
            raise UnsupportedError("it integrates over time in a triggered subsystem")

    def output(self, proportional: Signal, integral: Signal, derivative: Signal) -> Signal:
        """The control signal for the errors that its parts see."""
        site, terms = self.site, list[Signal]()
        self.error, self.made = integral, list[Signal]()
        if "P" in self.parts:
            terms.append(proportional if self.is_ideal else self._times("P", proportional))
        if "I" in self.parts:
            terms.append(self._integral())
        if "D" in self.parts:
            terms.append(self._derivative(self._times("D", derivative)))
        total = site.fold("add", terms)
        before = self._times("P", total) if self.is_ideal else total
        self.made += [before, self._limited(before)]
        return self.made[1]

    def _gain(self, name: str) -> Signal:
        return self.site.input(self.ports[name]) if name in self.ports else self.site.parameter(name)

    def _times(self, name: str, x: Signal) -> Signal:
        return self.site.call("mul", self._gain(name), x)

    def _limited(self, y: Signal) -> Signal:
        site = self.site
        if not site.on("LimitOutput"):
            return y
        return site.clip(y, site.parameter("LowerSaturationLimit"), site.parameter("UpperSaturationLimit"))

    # the integral

    def _integral(self) -> Signal:
        site, init = self.site, self._initial("I0", "InitialConditionForIntegrator")
        limits = None
        if site.on("LimitIntegrator"):
            limits = tuple(site.parameter(f"{side}IntegratorSaturationLimit") for side in ("Lower", "Upper"))
        if self.is_continuous:
            x = site.integrate(init, lambda _: self._integrand(), self._reset(), limits)  # type: ignore[arg-type]
            return x if limits is None else site.clip(x, *limits)
        return self._summed(init, lambda y: y if limits is None else site.clip(y, *limits))

    def _initial(self, port: str, name: str) -> Signal:
        return self.site.input(self.ports[port]) if port in self.ports else self.site.parameter(name)

    def _reset(self) -> Signal | None:
        if "reset" not in self.ports:
            return None
        u = self.site.input(self.ports["reset"])
        return reset_signal(self.site, u, resetting(self.site), sampled=not self.is_continuous)

    def _summed(self, init: Signal, limited: Callable[[Signal], Signal]) -> Signal:
        """The integral as a sum over the hits."""
        site = self.site
        method = site.chosen("IntegratorMethod", "Forward Euler", "Backward Euler", "Trapezoidal")
        share = site.constant(0.5 if method == "Trapezoidal" else 1.0)
        reset, made = self._reset(), list[Signal]()

        def step() -> Signal:
            moved = site.call("mul", site.step(), site.discrete(self._integrand()))
            return site.call("mul", share, moved)

        def then(_: Signal) -> Signal:
            return made[0] if method == "Backward Euler" else limited(site.call("add", made[0], step()))

        x = site.remember(init, then)
        x = x if reset is None else site.select(reset, limited(init), x)
        made.append(limited(x if method == "Forward Euler" else site.call("add", x, self._at_once(step))))
        return made[0]

    def _at_once(self, step: Callable[[], Signal]) -> Signal:
        """What the integral takes of this step, which must not depend on the output of this step."""
        site = self.site
        if site.on("TrackingMode") or (site.on("LimitOutput") and site.text("AntiWindupMode") != "none"):
            raise UnsupportedError(
                f"its integral ({site.text('IntegratorMethod')}) and what is fed back need each other in one step",
                "Use Forward Euler for the integral.",
            )
        return step()

    def _integrand(self) -> Signal:
        """What is integrated: I e, what tracking adds, and what anti-windup makes of it."""
        site = self.site
        inner = self._times("I", self.error)
        if "TR" in self.ports:
            behind = site.call("sub", site.input(self.ports["TR"]), self.made[1])
            inner = site.call("add", inner, self._times("Kt", behind))
        if not site.on("LimitOutput") or site.text("AntiWindupMode") == "none":
            return inner
        if site.text("AntiWindupMode") == "back-calculation":
            cut = site.call("sub", self.made[1], self.made[0])
            return site.call("add", inner, self._times("Kb", cut))
        return self._clamped(inner)

    def _clamped(self, inner: Signal) -> Signal:
        """Nothing where the output is beyond a limit and the integral would take it further out."""
        site, zero = self.site, self.site.constant(0.0)
        beyond = site.call("sub", self.made[0], self.made[1])
        inner_up, beyond_up = site.call("gt", inner, zero), site.call("gt", beyond, zero)
        outwards = site.call("eq", inner_up, beyond_up)
        if self.is_ideal:
            outwards = site.call("eq", outwards, site.call("gt", self._gain("P"), zero))
        stops = site.call("and", site.call("ne", beyond, zero), outwards)
        return site.select(stops, zero, inner)

    # the derivative

    def _derivative(self, scaled: Signal) -> Signal:
        """The change of the input, filtered: its slope y = N (u - x), x' = y."""
        site = self.site
        if not site.on("UseFilter"):
            return self._difference(scaled)
        n, init = self._gain("N"), self._initial("D0", "InitialConditionForFilter")
        if self.is_continuous:
            x = site.integrate(init, lambda x: _slope(site, n, scaled, x), self._reset(), None)
            return _slope(site, n, scaled, x)
        method = site.chosen("FilterMethod", "Forward Euler", "Backward Euler", "Trapezoidal")
        if method != "Forward Euler":
            return self._implicit(scaled, n, 1.0 if method == "Backward Euler" else 0.5)
        made, reset = list[Signal](), self._reset()
        x = site.remember(init, lambda _: site.call("add", made[0], site.call("mul", site.step(), made[1])))
        made.append(x if reset is None else site.select(reset, init, x))
        made.append(_slope(site, n, site.discrete(scaled), made[0]))
        return made[1]

    def _implicit(self, u: Signal, n: Signal, share: float) -> Signal:
        """As the filter, with the slope of this hit within the state: y = N (u - x) / (1 + N T share)."""
        site = self.site
        self._begins_at_rest("InitialConditionForFilter", "D0")
        step = site.call("mul", site.constant(share), site.step())
        one_more = site.call("add", site.constant(1.0), site.call("mul", n, step))
        made: list[Signal] = []

        def then(x: Signal) -> Signal:
            return site.call("add", x, site.call("mul", site.step(), made[0]))

        x = site.remember(site.constant(0.0), then)
        made.append(site.call("div", _slope(site, n, site.discrete(u), x), one_more))
        return made[0]

    def _begins_at_rest(self, name: str, port: str) -> None:
        if port in self.ports or "reset" in self.ports or self.site.numbers(name).any():
            raise UnsupportedError("its derivative begins with a value, or is reset, in a way that is not supported")

    def _difference(self, scaled: Signal) -> Signal:
        site = self.site
        if self.is_continuous:
            raise UnsupportedError("it has a derivative without a filter")
        if "reset" in self.ports:
            raise UnsupportedError("its derivative without a filter is reset")
        u = site.call("div", site.discrete(scaled), site.step())
        return site.call("sub", u, site.remember(site.parameter("DifferentiatorICPrevScaledInput"), lambda _: u))


def _slope(site: BlockContext, n: Signal, u: Signal, x: Signal) -> Signal:
    return site.call("mul", n, site.call("sub", u, x))


@block("PID Controller", linked=True, P="1", I="1", D="0")
def old_pid(site: BlockContext) -> SignalOrBus:
    """The controller of Simulink's extras: P e + I integral(e) + D times the change of e over a major step."""
    e = site.input()
    u = site.discrete(e)
    change = site.call("sub", u, site.remember(u, lambda _: u))
    return _old_sum(site, e, site.call("mul", site.parameter("D"), site.call("div", change, site.major_step)))


@block("PID Controller (with Approximate Derivative)", linked=True, P="1", I="1", D="0", N="100")
def old_pid_with_filter(site: BlockContext) -> SignalOrBus:
    """As `old_pid`, with the derivative D s / (s/N + 1)."""
    e, n = site.input(), site.parameter("N")
    x = site.integrate(site.constant(0.0), lambda x: _slope(site, n, e, x), None, None)
    return _old_sum(site, e, site.call("mul", site.parameter("D"), _slope(site, n, e, x)))


def _old_sum(site: BlockContext, e: Signal, derivative: Signal) -> Signal:
    scaled = site.call("mul", site.parameter("I"), e)
    integral = site.integrate(site.constant(0.0), lambda _: scaled, None, None)
    return site.fold("add", [site.call("mul", site.parameter("P"), e), integral, derivative])

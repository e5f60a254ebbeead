"""PID controllers P e + I integral(e) + D N (e - filter), parallel or ideal, continuous or discrete.

The ideal form multiplies the whole sum by P. Supported in addition: limits of output and integral, anti-windup
(back-calculation and clamping), resets, and tracking.
"""

from collections.abc import Callable, Iterable, Iterator

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.blocks.continuous import external_reset, has_external_reset, limit_output
from kennfeld.importers.simulink.blocks.discrete import scaled_difference
from kennfeld.importers.simulink.flattening.flat_model import is_triggered
from kennfeld.importers.simulink.lowering import BlockContext, UnsupportedError, block
from kennfeld.importers.simulink.reader.model_tree import ModelBlock
from kennfeld.importers.simulink.signals import Signal, SignalOrBus, apply, clip, select

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
    "InitialConditionSetting": ("Auto", "State (most efficient)", "State", "Output"),
}


def _sample(block: ModelBlock) -> str:
    """Return the field with the sample time; a continuous controller ignores the one stored for the discrete form."""
    return "SampleTime" if block.is_set_to("TimeDomain", "Discrete-time") else ""


def _ports(block: BlockContext, errors: int) -> dict[str, int]:
    """Return the port numbers of the inputs after the errors, by name."""
    return {name: errors + at for at, name in enumerate(_names(block))}


def _names(block: BlockContext) -> Iterator[str]:
    parts = _parts(block)
    filtered = "D" in parts and block.is_on("UseFilter")
    if block.option("ControllerParametersSource", "internal", "external") == "external":
        # in the order of the ports: gains, filter coefficient, reset, initial values, tracking signal
        yield from parts
        yield from ["N"] if filtered else []
    if has_external_reset(block):
        yield "reset"
    if block.option("InitialConditionSource", "internal", "external") == "external":
        yield from ["I0"] if "I" in parts else []
        yield from ["D0"] if filtered else []
    if block.is_on("TrackingMode"):
        yield "TR"


def _parts(block: BlockContext) -> str:
    return block.option("Controller", "PID", "PI", "PD", "P", "I")


def _needs(errors: int) -> Callable[[BlockContext], Iterable[int]]:
    """Return the inputs with feedthrough: all except the tracking signal, which only affects the integral."""

    def needed(block: BlockContext) -> Iterable[int]:
        tracked = _ports(block, errors).get("TR")
        return [at for at in range(block.input_count) if at != tracked]

    return needed


@block("PID 1dof", needs=_needs(1), sample=_sample, **_DEFAULTS)  # type: ignore[arg-type]
def pid(block: BlockContext) -> SignalOrBus:
    """Lower a PID controller with one degree of freedom."""
    e = block.input()
    return _PidController(block, _ports(block, 1)).output(e, e, e)


@block("PID 2dof", needs=_needs(2), sample=_sample, b="1", c="1", **_DEFAULTS)  # type: ignore[arg-type]
def pid_with_set_point(block: BlockContext) -> SignalOrBus:
    """Lower a PID controller with two degrees of freedom: b r - y for P, r - y for I, c r - y for D."""
    if block.is_set_to("ControllerParametersSource", "external"):
        raise UnsupportedError("its gains are inputs, which is not supported")
    r, y = block.input(0), block.input(1)
    weighted = [block.parameter(name) * r - y for name in ("b", "c")]
    return _PidController(block, _ports(block, 2)).output(weighted[0], r - y, weighted[1])


@dataclass
class _PidController:
    block: BlockContext
    ports: dict[str, int]

    def __post_init__(self) -> None:
        for name, known in _PLAIN.items():
            self.block.option(name, *known)
        if not self.is_explicit() and self.block.is_set_to("InitialConditionSetting", "Output"):
            raise UnsupportedError("InitialConditionSetting 'Output' is only supported with the method Forward Euler")
        self.parts = _parts(self.block)
        domain = self.block.option("TimeDomain", "Continuous-time", "Discrete-time")
        self.is_continuous = domain == "Continuous-time"
        self.is_ideal = self.block.option("Form", "Parallel", "Ideal") == "Ideal" and "P" in self.parts
        if not self.is_continuous and is_triggered(self.block.flat):
            raise UnsupportedError("it integrates over time in a triggered subsystem, which is not supported")

    def is_explicit(self) -> bool:
        """Return True if the states are outputs, so that either has the initial value."""
        methods = ("IntegratorMethod", "FilterMethod")
        return self.block.is_set_to("TimeDomain", "Continuous-time") or all(
            self.block.is_set_to(method, "Forward Euler") for method in methods
        )

    def output(self, proportional: Signal, integral: Signal, derivative: Signal) -> Signal:
        """Compute the control signal for the errors of the P, I and D terms."""
        block, terms = self.block, list[Signal]()
        self.error, self.results = integral, list[Signal]()  # results before and after limits
        if "P" in self.parts:
            # P (e + I integral(e) + D de/dt) in the ideal form
            terms.append(proportional if self.is_ideal else self._times("P", proportional))
        if "I" in self.parts:
            terms.append(self._integral())
        if "D" in self.parts:
            terms.append(self._derivative(self._times("D", derivative)))
        total = block.reduce("add", terms)
        before = self._times("P", total) if self.is_ideal else total
        self.results += [before, limit_output(block, before)]
        return self.results[1]

    def _gain(self, name: str, field: str = "") -> Signal:
        """Return the value of an input, or of a field of the same or another name."""
        return self.block.input(self.ports[name]) if name in self.ports else self.block.parameter(field or name)

    def _times(self, name: str, x: Signal) -> Signal:
        return self._gain(name) * x

    def _integral(self) -> Signal:
        block, init = self.block, self._gain("I0", "InitialConditionForIntegrator")
        limits = None
        if block.is_on("LimitIntegrator"):
            limits = tuple(block.parameter(f"{side}IntegratorSaturationLimit") for side in ("Lower", "Upper"))
        if self.is_continuous:
            x = block.continuous_state(init, lambda _: self._integrand(), self._reset(), limits)  # type: ignore[arg-type]
            return x if limits is None else clip(x, *limits)
        return self._sum_up(init, lambda y: y if limits is None else clip(y, *limits))

    def _reset(self) -> Signal | None:
        return external_reset(self.block, not self.is_continuous, self.ports.get("reset", 0))

    def _sum_up(self, init: Signal, limited: Callable[[Signal], Signal]) -> Signal:
        """Return the integral accumulated over samples."""
        block = self.block
        method = block.option("IntegratorMethod", "Forward Euler", "Backward Euler", "Trapezoidal")
        share = block.constant(0.5 if method == "Trapezoidal" else 1.0)
        reset, signals = self._reset(), list[Signal]()

        def increment(step: Signal) -> Signal:
            return share * (step * block.hold_in_minor_steps(self._integrand()))

        def then(_: Signal) -> Signal:
            ahead = block.next_sample_step
            return signals[0] if method == "Backward Euler" else limited(signals[0] + increment(ahead()))

        # forward: y = x, x' = y + T2 g; backward: y = x + T1 g, x' = y; trapezoidal: both halves, as DiscreteIntegrator
        x = block.discrete_state(init, then)
        x = x if reset is None else select(reset, limited(init), x)
        signals.append(limited(x if method == "Forward Euler" else x + self._at_once(increment)))
        return signals[0]

    def _at_once(self, increment: Callable[[Signal], Signal]) -> Signal:
        """Return the part of the integral added in this step, which must not depend on the output of this step."""
        block = self.block
        if block.is_on("TrackingMode") or (
            block.is_on("LimitOutput") and not block.is_set_to("AntiWindupMode", "none")
        ):
            message = f"its integral ({block.field_text('IntegratorMethod')}) and its feedback form an algebraic loop"
            raise UnsupportedError(message, "Use Forward Euler for the integrator.")
        return increment(block.sample_step())

    def _integrand(self) -> Signal:
        """Return the integrand: I e plus tracking and anti-windup terms."""
        block = self.block
        inner = self._times("I", self.error)
        if "TR" in self.ports:
            inner = inner + self._times("Kt", block.input(self.ports["TR"]) - self.results[1])
        if not block.is_on("LimitOutput") or block.is_set_to("AntiWindupMode", "none"):
            return inner
        if block.is_set_to("AntiWindupMode", "back-calculation"):
            return inner + self._times("Kb", self.results[1] - self.results[0])
        return self._clamp(inner)

    def _clamp(self, inner: Signal) -> Signal:
        """Return 0 if the output is beyond a limit and the integral would move it further out."""
        # u before the limits minus u after them: > 0 above the upper limit, < 0 below the lower one
        beyond = self.results[0] - self.results[1]
        outwards = apply("eq", inner > 0.0, beyond > 0.0)
        if self.is_ideal:
            # the ideal form multiplies the integral by P, so that a negative P turns its direction
            outwards = apply("eq", outwards, self._gain("P") > 0.0)
        return select(apply("ne", beyond, 0.0) & outwards, 0.0, inner)

    def _derivative(self, scaled: Signal) -> Signal:
        """Return the filtered derivative: y = N (u - x), x' = y."""
        block = self.block
        if not block.is_on("UseFilter"):
            return self._difference(scaled)
        n, init = self._gain("N"), self._gain("D0", "InitialConditionForFilter")
        if self.is_continuous:
            x = block.continuous_state(init, lambda x: _slope(n, scaled, x), self._reset())
            return _slope(n, scaled, x)
        method = block.option("FilterMethod", "Forward Euler", "Backward Euler", "Trapezoidal")
        if method != "Forward Euler":
            return self._implicit(scaled, n, 1.0 if method == "Backward Euler" else 0.5)
        signals, reset = list[Signal](), self._reset()
        # x' = x + T2 N (u - x)
        x = block.discrete_state(init, lambda _: signals[0] + block.next_sample_step() * signals[1])
        signals.append(x if reset is None else select(reset, init, x))
        signals.append(_slope(n, block.hold_in_minor_steps(scaled), signals[0]))
        return signals[1]

    def _implicit(self, u: Signal, n: Signal, share: float) -> Signal:
        """Return the implicit form of the filter: y = N (u - x) / (1 + N T share).

        The state x already contains (1 - share) T y of the sample before; share T y of this sample is added with the
        step to the next one.
        """
        block = self.block
        if "D0" in self.ports or "reset" in self.ports or block.numeric_array("InitialConditionForFilter").any():
            raise UnsupportedError("its derivative has an initial value or a reset that is not supported")
        one_more = 1.0 + n * (share * block.sample_step())
        signals: list[Signal] = []

        def then(x: Signal) -> Signal:
            step = block.sample_step()
            return x + (step if share == 1.0 else share * (step + block.next_sample_step())) * signals[0]

        x = block.discrete_state(block.constant(0.0), then)
        signals.append(_slope(n, block.hold_in_minor_steps(u), x) / one_more)
        return signals[0]

    def _difference(self, scaled: Signal) -> Signal:
        block = self.block
        if self.is_continuous:
            raise UnsupportedError("it has an unfiltered derivative, which is not supported")
        u = block.hold_in_minor_steps(scaled)
        return scaled_difference(block, u, "DifferentiatorICPrevScaledInput", self._reset())


def _slope(n: Signal, u: Signal, x: Signal) -> Signal:
    return n * (u - x)


@block("PID Controller", linked=True, P="1", I="1", D="0")
def old_pid(block: BlockContext) -> SignalOrBus:
    """Lower the controller of Simulink Extras: P e + I integral(e) + D times the difference quotient of e."""
    e = block.input()
    u = block.hold_in_minor_steps(e)
    change = u - block.discrete_state(u, lambda _: u)
    return _old_sum(block, e, block.parameter("D") * (change / block.base_step))


@block("PID Controller (with Approximate Derivative)", linked=True, P="1", I="1", D="0", N="100")
def old_pid_with_filter(block: BlockContext) -> SignalOrBus:
    """Lower the controller of Simulink Extras with the derivative D s / (s/N + 1)."""
    e, n = block.input(), block.parameter("N")
    x = block.continuous_state(block.constant(0.0), lambda x: _slope(n, e, x))
    return _old_sum(block, e, block.parameter("D") * _slope(n, e, x))


def _old_sum(block: BlockContext, e: Signal, derivative: Signal) -> Signal:
    scaled = block.parameter("I") * e
    integral = block.continuous_state(block.constant(0.0), lambda _: scaled)
    return block.reduce("add", [block.parameter("P") * e, integral, derivative])

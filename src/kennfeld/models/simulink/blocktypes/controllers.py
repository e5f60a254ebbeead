"""PID controllers: P e + I integral(e) + D N (e - filter), in parallel or ideal form, continuous or discrete."""

from kennfeld.models.simulink.blocktypes.registry import UnsupportedError, block
from kennfeld.models.simulink.signals import Signal, Wired
from kennfeld.models.simulink.site import Site

_PLAIN = {
    "ExternalReset": ("none",),
    "InitialConditionSource": ("internal",),
    "TrackingMode": ("off",),
    "LinearizeAsGain": ("on", "off"),
    "ControllerParametersSource": ("internal",),
    "LimitIntegratorOutput": ("off",),
}


@block("PID 1dof", Controller="PID", TimeDomain="Continuous-time", Form="Parallel", P="1", I="1", D="0", N="100",
       UseFilter="on", IntegratorMethod="Forward Euler", FilterMethod="Forward Euler", SampleTime="-1",
       InitialConditionForIntegrator="0", InitialConditionForFilter="0", ExternalReset="none",
       InitialConditionSource="internal", TrackingMode="off", LinearizeAsGain="on",
       ControllerParametersSource="internal", LimitOutput="off", LimitIntegratorOutput="off",
       AntiWindupMode="none", UpperSaturationLimit="inf",
       LowerSaturationLimit="-inf")  # fmt: skip
def pid(site: Site) -> Wired:
    """A PID controller of one degree of freedom."""
    for name, known in _PLAIN.items():
        site.chosen(name, *known)
    parts = site.chosen("Controller", "PID", "PI", "PD", "P", "I")
    e = site.input()
    terms = [site.call("mul", site.parameter("P"), e)] if "P" in parts else []
    ideal = site.chosen("Form", "Parallel", "Ideal") == "Ideal" and bool(terms)
    base = terms[0] if ideal else e
    if "I" in parts:
        terms.append(_integral(site, site.call("mul", site.parameter("I"), base)))
    if "D" in parts:
        terms.append(_derivative(site, site.call("mul", site.parameter("D"), base)))
    return _limited(site, site.fold("add", terms))


def _limited(site: Site, y: Signal) -> Signal:
    if not site.on("LimitOutput"):
        return y
    site.chosen("AntiWindupMode", "none")
    return site.clip(y, site.parameter("LowerSaturationLimit"), site.parameter("UpperSaturationLimit"))


def _is_continuous(site: Site) -> bool:
    return site.chosen("TimeDomain", "Continuous-time", "Discrete-time") == "Continuous-time"


def _integral(site: Site, scaled: Signal) -> Signal:
    init = site.parameter("InitialConditionForIntegrator")
    if _is_continuous(site):
        return site.integrate(init, lambda _: scaled, None, None)
    method = site.chosen("IntegratorMethod", "Forward Euler", "Backward Euler", "Trapezoidal")
    step = site.call("mul", site.step(), site.discrete(scaled))
    if method == "Forward Euler":
        return site.remember(init, lambda x: site.call("add", x, step))
    if method == "Backward Euler":
        made: list[Signal] = []
        made.append(site.call("add", site.remember(init, lambda _: made[0]), step))
        return made[0]
    half = site.call("mul", site.constant(0.5), step)
    kept: list[Signal] = []
    before = site.remember(init, lambda _: site.call("add", kept[0], half))
    kept.append(site.call("add", before, half))
    return kept[0]


def _derivative(site: Site, scaled: Signal) -> Signal:
    """The change of the input, filtered: its slope y = N (u - x), x' = y."""
    if not site.on("UseFilter"):
        if _is_continuous(site):
            raise UnsupportedError("it has a derivative without a filter")
        before = site.remember(site.constant(0.0), lambda _: site.discrete(scaled))
        return site.call("div", site.call("sub", site.discrete(scaled), before), site.step())
    n, init = site.parameter("N"), site.parameter("InitialConditionForFilter")
    if _is_continuous(site):
        x = site.integrate(init, lambda x: site.call("mul", n, site.call("sub", scaled, x)), None, None)
        return site.call("mul", n, site.call("sub", scaled, x))
    site.chosen("FilterMethod", "Forward Euler")
    made: list[Signal] = []
    x = site.remember(init, lambda x: site.call("add", x, site.call("mul", site.step(), made[0])))
    made.append(site.call("mul", n, site.call("sub", site.discrete(scaled), x)))
    return made[0]

"""`[design]`: what to measure next, and within which limits."""

from collections.abc import Collection, Iterator, Mapping
from itertools import pairwise
from typing import Literal

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.file_keys import KeyProblem, key
from kennfeld.project.forms import NumberForm, TableOfForm
from kennfeld.project.value_forms import CoordinatesForm, PairForm

Method = Literal["auto", "sobol", "lhs", "factorial", "d-optimal", "i-optimal"]
Polynomial = Literal["linear", "interaction", "quadratic", "rbf"]
_RANGE = PairForm(
    "must be two numbers, the lower one first", "Write {key} = [lower, upper].", may_be_equal=True, shows=True
)
_CURVE = 'Write curves = [{ channel = "load", over = "speed", at = [800, 6000], limits = [60, 100] }].'
_MANOEUVRE = 'Write manoeuvres = [{ kind = "aprbs", duration = 600 }].'


@dataclass(frozen=True)
class CurveEntry:
    """One entry of `curves`."""

    channel: str = key("the channel that is limited", holds="channel", missing=_CURVE)
    over: str = key("the channel that its limit depends on", holds="channel", missing=_CURVE)
    at: tuple[float, ...] = key("values of that channel, rising", form=CoordinatesForm(), missing=_CURVE)
    limits: tuple[float, ...] = key(
        "the limit at each of them; linear between, constant beyond", form=CoordinatesForm(), missing=_CURVE
    )
    side: Literal["max", "min"] = key('`"max"`: the channel stays below the curve; `"min"`: above it', "max")

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield values that do not rise, or limits for other ones."""
        if any(second <= first for first, second in pairwise(self.at)):
            yield "at", f"the values of {self.over} must rise", "Sort them."
        if len(self.at) != len(self.limits):
            yield "limits", f"{len(self.limits)} limits for {len(self.at)} values of {self.over}", "Give one for each."


@dataclass(frozen=True)
class ManoeuvreEntry:
    """One entry of `manoeuvres`."""

    kind: Literal["steps", "ramps", "chirp", "aprbs"] = key(
        '`"steps"` and `"aprbs"` go to levels within the limits and stay there, `"ramps"` turn around at once, and '
        '`"chirp"` swings with a rising frequency',
        missing=_MANOEUVRE,
    )
    duration: float = key("how long it takes", above=0, unit="s", missing=_MANOEUVRE)
    name: str = key("name of its time table", "", default_text="its kind and number")
    channels: tuple[str, ...] = key("the channels that move", (), holds="channel", default_text="all of `ranges`")
    dwell: tuple[float, float] = key(
        "shortest and longest time at a level, in s", (2.0, 20.0), form=_RANGE, default_text="`[2, 20]`"
    )
    frequency: tuple[float, float] = key(
        "first and last frequency of a chirp, in Hz", (0.01, 0.5), form=_RANGE, default_text="`[0.01, 0.5]`"
    )
    step: float = key("time step of the table", 0.1, above=0, unit="s")


@dataclass(frozen=True)
class DesignEntry:
    """`[design]`: settings of `kennfeld design`."""

    ranges: Mapping[str, tuple[float, float]] = key(
        "`{ speed = [800, 6000] }`: lower and upper end of each channel; equal ends keep it constant",
        factory=dict,
        form=TableOfForm(_RANGE),
        by="channel",
        default_text="those of the training data",
    )
    where: tuple[str, ...] = key("conditions over channels that hold at every point", (), holds="condition")
    forbidden: tuple[str, ...] = key("conditions that hold at no point", (), holds="condition")
    curves: tuple[CurveEntry, ...] = key(
        '`[{ channel = "load", over = "speed", at = [800, 6000], limits = [60, 100] }]`: limits that depend on another '
        "channel, such as the full load",
        (),
        word="curve",
        remedy=_CURVE,
    )
    envelope: bool | None = key(
        "`true`: points lie within the convex hull of the training data, of more than four channels within that of "
        "every pair of them",
        None,
        default_text="`true` without `ranges`",
    )
    slew: Mapping[str, float] = key(
        "largest rate of each channel, in its unit per s",
        factory=dict,
        form=TableOfForm(NumberForm(above=0)),
        by="channel",
    )
    wait: float = key("time for which a bench waits at each point", 0.0, least=0, unit="s")
    hard: tuple[str, ...] = key(
        "channels that are hard to change: their levels are measured one after the other", (), holds="channel"
    )
    method: Method = key(
        'how points are chosen: `"auto"`: by the fit, or by a Sobol sequence if there are no data; `"sobol"`, `"lhs"` '
        '(Latin hypercube) and `"factorial"` fill the limits; `"d-optimal"` and `"i-optimal"` are those of `model`',
        "auto",
    )
    model: Polynomial = key("the black-box model of an optimal design", "quadratic")
    centres: int = key('centres of the model `"rbf"`', 10, least=1)
    blocks: int = key("number of blocks of about equal size, each spread over all limits", 1, least=1)
    replicates: int = key("points that are measured twice", 0)
    repeat: int = key("a point in the middle is measured again after so many points; 0 for never", 0)
    use: tuple[str, ...] = key(
        "recordings or cycles of the operation that matters",
        (),
        holds="recording",
        default_text="training and test data",
    )
    use_weight: str = key(
        "channel of these recordings that weights their samples, such as the hours at each point of a table of points",
        "",
        holds="channel",
        default_text="all count alike",
    )
    length: float = key("length of a segment", 60.0, above=0, unit="s")
    warmup: float | None = key(
        "time before each segment in which the function settles",
        None,
        least=0,
        unit="s",
        default_text="three of its largest time constants",
    )
    manoeuvres: tuple[ManoeuvreEntry, ...] = key(
        '`[{ kind = "aprbs", duration = 600 }]`: manoeuvres to plan as time tables', (), word="manoeuvre"
    )
    max_seconds: float | None = key(
        "time in s after which the choice ends with what was chosen so far; for the fit before it, see `[optimizer]`",
        None,
        above=0,
        default_text="unlimited",
    )
    seed: int = key("of random numbers", 0)

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield channels without a range that other keys need."""
        for known in (self.hard, self.slew) if self.ranges else ():
            for name in known:
                if name not in self.ranges:
                    yield "ranges", f"{name} has no range", f"Write its range, or remove {name} from the other keys."
        if "model" in present and not self.method.endswith("optimal"):
            yield "model", "model requires a method d-optimal or i-optimal", 'Write method = "d-optimal".'

"""The keys of `[[criterion]]`, `[[limit]]` and `[[equality]]`: what the fit minimises, and within which limits."""

import math
from collections.abc import Collection, Iterator, Mapping
from typing import Any, Literal

from kennfeld.base.errors import Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.criteria import ROBUST_LOSSES, RobustLoss
from kennfeld.domain.file_keys import KeyProblem, key
from kennfeld.project.value_forms import CoordinatesForm, TargetEntry, TargetForm

_TERMS_EXAMPLE = 'Write terms = [{ parameter = "...", at = [...], factor = 1 }, ...].'
_ROBUST = " or ".join(f'`"{loss}"`' for loss in ROBUST_LOSSES)
_REGION_EXAMPLE = 'Write regions = [{ where = "Speed > 3000", weight = 2.0 }].'


@dataclass(frozen=True)
class RegionEntry:
    """One entry of `regions`."""

    where: str = key("a condition over channels", holds="condition", missing=_REGION_EXAMPLE)
    weight: float = key("weight of the samples that satisfy it", least=0, missing=_REGION_EXAMPLE)


@dataclass(frozen=True)
class CriterionEntry:
    """One `[[criterion]]`."""

    location: Location
    node: str = key("the node to fit to the target", holds="node", missing='Write node = "...".')
    target: TargetEntry = key(
        '`{ channel = "Torque" }`, `{ node = "Other" }`, or a number; a bare name is a channel or, if there is none, a '
        "node. A dataset without the channel is not scored; this causes a warning unless the dataset has the channel "
        "of another criterion",
        form=TargetForm(),
        missing='Write target = { channel = "..." }.',
    )
    weight: float = key("factor on the squared errors; 0 switches off", 1.0, least=0)
    scale: float = key("errors are divided by it, in the channel's unit", 1.0, above=0)
    loss: Literal["square", RobustLoss] = key(f"{_ROBUST} reduce the influence of outliers", "square")
    delta: float = key("error at which this reduction begins, in units of `scale`", 1.0, above=0)
    weight_channel: str = key(
        "a channel with the weight of each sample, >= 0; missing values count as 0", "", holds="channel"
    )
    regions: tuple[RegionEntry, ...] = key(
        '`[{ where = "Speed > 3000", weight = 2.0 }]`: a weight for the samples that satisfy a condition over channels',
        (),
        word="region",
        remedy=_REGION_EXAMPLE,
    )

    def problems(self, present: Mapping[str, Any]) -> Iterator[KeyProblem]:
        """Yield a delta without effect; an invalid loss may have been meant as one that has a delta."""
        if self.loss == "square" == present.get("loss", "square") and "delta" in present:
            remedy = f"Write loss = {_ROBUST.replace('`', '')}."
            yield "delta", f"delta requires the loss {' or '.join(ROBUST_LOSSES)}", remedy


@dataclass(frozen=True)
class LimitEntry:
    """One `[[limit]]`."""

    location: Location
    node: str = key(
        'a node, or an expression over nodes, inputs and channels: `"abs(n_set - n)"`. It may call the tables of the '
        'project: `"MapDrag(Speed, 100) - MapDrag(Speed, 20)"`',
        holds="node",
        missing='Write node = "...", a node or an expression.',
    )
    lower: float = key("the lower bound", -math.inf, name="min", default_text="none")
    upper: float = key("the upper bound; one of the two, or both", math.inf, name="max", default_text="none")
    where: str = key(
        "a condition over inputs and channels; the limit applies to the samples that satisfy it", "", holds="condition"
    )

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield missing and reversed bounds."""
        if not {"min", "max"} & set(present):
            yield "max", "min and max are missing", "Write max = ... or min = ..."
        if self.lower > self.upper:
            yield "min", f"min = {self.lower:g} exceeds max = {self.upper:g}", "Swap them."


@dataclass(frozen=True)
class TermEntry:
    """One term of an `[[equality]]`."""

    parameter: str = key("the parameter", holds="parameter", missing='Write parameter = "...".')
    at: tuple[float, ...] | None = key(
        "the coordinates, one per axis", None, form=CoordinatesForm(), default_text="the sum of all values"
    )
    factor: float = key("factor of the value", 1.0)


@dataclass(frozen=True)
class EqualityEntry:
    """One `[[equality]]`."""

    location: Location
    terms: tuple[TermEntry, ...] = key(
        '`[{ parameter = "A", at = [0] }, { parameter = "B", at = [0], factor = -1 }]`; without `at`, a term is the '
        "sum of all values of its parameter",
        word="term",
        fault="must be a list of terms",
        remedy=_TERMS_EXAMPLE,
        shows=True,
        fills=True,
        missing=_TERMS_EXAMPLE,
    )
    value: float = key("the sum of the terms", 0.0)

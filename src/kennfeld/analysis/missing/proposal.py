"""The result of a search for missing terms."""

from collections.abc import Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np

from kennfeld.analysis.missing.refit import Addition
from kennfeld.analysis.missing.terms import Kind, MissingTerm, describe
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import finite_or_none
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.problem.problem import Problem

LEAST_CHANGE = 1e-3  # of an RMSE, that is reported


@dataclass(frozen=True)
class EqualPlace:
    """A term that explains the same as the one that is proposed."""

    node: str
    kind: Kind
    channel: str = ""
    addition: Addition | None = field(default=None, repr=False)


@dataclass(frozen=True)
class RmseChange:
    """An RMSE without a term and with it."""

    before: float
    after: float

    @property
    def explained(self) -> float:
        """The RMSE of what the term explains, sqrt(before^2 - after^2); negative if it makes the errors larger.

        >>> round(RmseChange(3.57, 3.47).explained, 2)
        0.84
        """
        squares = self.before**2 - self.after**2
        return float(np.copysign(np.sqrt(abs(squares)), squares))

    def as_json(self) -> dict[str, float | None]:
        """Return both numbers."""
        return {"before": _rounded(self.before), "after": _rounded(self.after)}

    def __str__(self) -> str:
        return f"{self.before:.4g} -> {self.after:.4g}"


@dataclass(frozen=True)
class HeldOutErrors:
    """The RMSE on a part of the data that was held out, of the function and of that with a term, fitted to the rest.

    Attributes:
        name: files of the part, or its number.
        samples: in it.
        rmse: without the term and with it.
    """

    name: str
    samples: int
    rmse: RmseChange


@dataclass(frozen=True, kw_only=True)
class TermProposal:
    """A term that a function lacks.

    Attributes:
        term: the term.
        equal_places: other places that the data cannot distinguish from its own.
        rmse: on the training data, after a fit with the term.
        held_out: on held-out parts of the training data.
        held_name: what was held out, such as `files`.
        test: on the test data; None without.
        predicted: RMSE on the training data before any fit with the term.
        probability: of such a gain if nothing is missing, times the number of candidates.
        parameter: the new parameter, fitted; None for a delay.
        better: number of held-out parts that the term makes better.
        parts: number of held-out parts.
        unit: of the RMSE.
        location: where the node is in the source of the function.
        patch: the change of the formula text and the project file, as text.
        addition: how it is added to the problem.
        offsets: of each recording by its name, for an offset.
        held_out_parts: the errors on each held-out part.
        fit: the fit with the term to all training data.
        criteria: the RMSE of each criterion on the training data, by its node, if there are several.

    >>> from kennfeld import Project
    >>> proposals = Project.read("kennfeld.toml").propose(kinds=["lag"])
    >>> [proposal.text for proposal in proposals]
    []
    """

    term: MissingTerm
    equal_places: tuple[EqualPlace, ...]
    rmse: RmseChange
    held_out: RmseChange
    held_name: str
    test: RmseChange | None
    predicted: float
    probability: float
    parameter: Parameter | None
    better: int
    parts: int
    unit: str = ""
    location: str = ""
    patch: str = ""
    addition: Addition | None = field(default=None, repr=False)
    offsets: dict[str, float] = field(default_factory=dict)
    held_out_parts: tuple[HeldOutErrors, ...] = field(default=(), repr=False)
    fit: Result | None = field(default=None, repr=False)
    criteria: tuple[tuple[str, RmseChange], ...] = ()

    def at_place(self, number: int) -> "TermProposal":
        """Return the proposal at one of the equal places, from 0, where it is not fitted; its errors are the same."""
        addition = self.equal_places[number].addition
        assert addition is not None
        return replace(self, term=addition.term, addition=addition, parameter=addition.parameter, fit=None)

    @property
    def change(self) -> str:
        """The change, in words.

        >>> from kennfeld.analysis.missing.terms import describe
        >>> describe(MissingTerm("dragTorque", "multiply", "Throttle"))
        'Scale dragTorque by a curve of Throttle'
        """
        value = None if self.parameter is None or self.term.kind != "lag" else float(self.parameter.values)
        return describe(self.term, value)

    @property
    def text(self) -> str:
        """The proposal as one sentence."""
        unit = f" {self.unit}" if self.unit and self.unit != "-" else ""
        return f"{self.change}: RMSE {self.rmse}{unit}; held-out {self.held_name} {self.held_out}."

    @property
    def remark(self) -> str:
        """The largest offsets, the errors of several criteria and the equal places, in words; "" if there are none."""
        nodes = list(dict.fromkeys(place.node for place in self.equal_places if place.node != self.term.node))
        return " ".join(text for text in (self._largest, self._changes, self._places(nodes)) if text)

    @property
    def _largest(self) -> str:
        if not self.offsets:
            return ""
        unit = f" {self.unit}" if self.unit and len(self.equal_places) == 0 else ""
        far = sorted(self.offsets.items(), key=lambda item: -abs(item[1]))[:3]
        texts = [f"{name} {value:+.3g}{unit}" for name, value in far]
        return f"Largest: {', '.join(texts)}."

    @property
    def _changes(self) -> str:
        """The errors of the criteria that the term changes, in words."""
        changed = [
            (node, own) for node, own in self.criteria if abs(own.after - own.before) > LEAST_CHANGE * own.before
        ]
        if not changed:
            return ""
        others = "; of the others as before" if len(changed) < len(self.criteria) else ""
        return f"RMSE of {', of '.join(f'{node} {own}' for node, own in changed)}{others}."

    def _places(self, nodes: Sequence[str]) -> str:
        if not nodes:
            return ""
        names = ", ".join([self.term.node, *nodes[:-1]]) + f" and {nodes[-1]}"
        return f"The data cannot tell {names} apart: choose by physics."

    def as_json(self) -> dict[str, Any]:
        """Return the entry of `kennfeld propose --json`."""
        nodes = dict.fromkeys(place.node for place in self.equal_places)
        return {
            "node": self.term.node,
            "kind": self.term.kind,
            "channel": self.term.channel,
            "text": self.text,
            "equal_places": [name for name in nodes if name != self.term.node],
            "rmse": self.rmse.as_json(),
            "held_out": self.held_out.as_json(),
            "patch": self.patch,
            "explains": _rounded(self.held_out.explained),
            "test": None if self.test is None else self.test.as_json(),
            "predicted": _rounded(self.predicted),
            "probability": float(f"{self.probability:.2e}"),
            "parts": {"better": self.better, "all": self.parts},
            "location": self.location,
            "seconds": _rounded(self.term.seconds) if self.term.kind == "lag" else None,
            "steps": self.term.steps or None,
            "criteria": [{"node": node, "rmse": own.as_json()} for node, own in self.criteria],
            "offsets": {name: _rounded(value) for name, value in self.offsets.items()},
            "breakpoints": [] if self.offsets else list(self.term.breakpoints),
            "second_channel": self.term.second,
            "second_breakpoints": list(self.term.second_breakpoints),
            "values": [] if self.parameter is None or self.offsets else _rounded_together(self.parameter.values),
        }


@dataclass(frozen=True, kw_only=True)
class TermProposals:
    """The terms that a function lacks, the best one first.

    Attributes:
        proposals: each of them alone would make the function better on data that its fit has not seen.
        smallest_effect: RMSE of the smallest effect that would have been detected.
        status: `found`, `none`, or `failed` if the function could not be judged.
        message: the status as a sentence.
        candidates: number of terms that were scored.
        share_left: share of the cost that a further fit of the present values would remove.
        share: share of the cost that the best candidate would remove, if it is significant.
        best: the best candidate, in words, if it is significant.
        rejected: significant candidates that were no better on held-out data, in words.
        excluded: channels that take no part, with the reason.
        remarks: further remarks, as sentences.
        seconds: time of the scores, and of the fits.
        unit: of the RMSE.
        problem: the function as it is, at the end of its fit; None if it could not be judged.

    >>> from kennfeld import propose
    >>> x, z = np.tile([0.0, 1.0, 2.0, 3.0], 50), np.repeat(np.arange(10.0), 20)
    >>> proposals = propose("y = a * x", {"x": x, "z": z, "m": 2 * x + z}, {"a": 0.0}, target="m", kinds=["add"])
    >>> len(proposals), proposals.status
    (1, 'found')
    """

    proposals: tuple[TermProposal, ...]
    smallest_effect: float
    status: str
    message: str
    candidates: int = 0
    share_left: float = 0.0
    share: float = 0.0
    best: str = ""
    rejected: tuple[str, ...] = ()
    excluded: dict[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    seconds: tuple[float, float] = (0.0, 0.0)
    unit: str = ""
    problem: Problem | None = field(default=None, repr=False)

    def without_fits(self) -> "TermProposals":
        """Return the same without the problem and the fits, which hold the data."""
        return replace(self, proposals=tuple(replace(each, fit=None) for each in self.proposals), problem=None)

    def __len__(self) -> int:
        return len(self.proposals)

    def __getitem__(self, at: int) -> TermProposal:
        return self.proposals[at]

    def lines(self) -> list[str]:
        """Return the result as lines of text."""
        lines = list(self.remarks)
        for number, proposal in enumerate(self.proposals, 1):
            lines.append(f"{number}  {proposal.text}")
            lines += [f"   {proposal.remark}"] if proposal.remark else []
        lines += [f"-  {text}" for text in self.rejected]
        excluded = [f"  {name}: {reason}" for name, reason in self.excluded.items()]
        return [*lines, self.message, *(["Channels that take no part:"] if excluded else []), *excluded]

    def as_json(self) -> dict[str, Any]:
        """Return what `kennfeld propose --json` prints."""
        return {
            "proposals": [proposal.as_json() for proposal in self.proposals],
            "smallest_effect": _rounded(self.smallest_effect),
            "status": self.status,
            "message": self.message,
            "candidates": self.candidates,
            "share": _rounded(self.share),
            "share_left": round(self.share_left, 9),
            "rejected": list(self.rejected),
            "excluded": self.excluded,
            "remarks": list(self.remarks),
        }

    def __str__(self) -> str:
        return "\n".join(self.lines())


def _rounded_together(values: Float) -> list[Any]:
    """Return numbers with six digits of the largest of them; those of a map as rows."""
    largest = float(np.abs(values).max(initial=0.0)) or 1.0

    def nested(part: Float) -> list[Any]:
        if part.ndim > 1:
            return [nested(row) for row in part]
        return [_rounded(round(value / largest, 6) * largest) for value in part.ravel().tolist()]

    return nested(values)


def _rounded(number: float) -> float | None:
    """Return a number with six digits, so that the order in which parts of the data are added does not show."""
    # 0 for -0, which a pinned value may be
    rounded: float | None = finite_or_none(float(f"{number:.6g}") + 0.0)
    return rounded

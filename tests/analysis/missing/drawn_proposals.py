"""Handmade proposals of every kind, as a search returns them."""

import numpy as np

from kennfeld.analysis.missing.picture import DrawnProposals, TermPicture
from kennfeld.analysis.missing.proposal import EqualPlace, HeldOutErrors, RmseChange, TermProposal, TermProposals
from kennfeld.analysis.missing.refit import Addition, no_mean
from kennfeld.analysis.missing.terms import MissingTerm
from kennfeld.domain.axis import Axis
from kennfeld.domain.constraints import Pin
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve

CURVE = MissingTerm("drag [1]", "multiply", "Öl °C", (20.0, 60.0, 1e-7 + 90.0))
MAP = MissingTerm("y", "add", "x", (0.0, 1.0, 2.0), second="z", second_breakpoints=(0.1, 0.7))
LAG, DELAY = MissingTerm("y", "lag", seconds=0.81), MissingTerm("y", "delay", steps=3)
OFFSET = MissingTerm("y", "offset", breakpoints=(0.0, 1.0, 2.0))


def addition(term, locked=(), **more):
    parameter = term.parameter(term.label() + "2")
    if locked:
        at = np.isin(np.arange(parameter.size), locked).reshape(parameter.values.shape)
        parameter = parameter.changed(locked=at)
    return Addition(term, parameter, **more)


ADDITIONS = [
    addition(CURVE, smoothness=2e-05, pin=Pin("ScaleDrag1ÖlC2", (60.0,), 1.0)),
    addition(MAP, locked=(1, 3, 5), smoothness=0.4),
    addition(LAG),
    Addition(DELAY, None),
    addition(OFFSET, pin=Pin("OffsetY2", (2.0,), 0.0), constraints=(no_mean("OffsetY2", OFFSET),)),
]


def fitted(own):
    if own.parameter is None:
        return None
    return own.parameter.with_values(np.linspace(1 / 3, 2, own.parameter.size))


def proposal(own):
    return TermProposal(
        term=own.term,
        equal_places=(EqualPlace("y", "add", "x", addition(MAP, locked=(0,))),) if own.term.second else (),
        rmse=RmseChange(3.57, 3.47),
        held_out=RmseChange(3.6, float("nan")),
        held_name="files",
        test=None if own.term.kind == "lag" else RmseChange(4.0, 3.9),
        predicted=3.48,
        probability=1e-9,
        parameter=fitted(own),
        better=2,
        parts=3,
        unit="Nm",
        criteria=(("y", RmseChange(2.0, 1.0)), ("b", RmseChange(3.0, 3.0))) if own.term.steps else (),
        location="f.kf line 3",
        patch="-y = x\n+y = x + 1",
        addition=own,
        offsets={"a.csv": -0.25, "b.csv": 0.25} if own.term.kind == "offset" else {},
        held_out_parts=(HeldOutErrors("a.csv", 40, RmseChange(1.0, 0.5)),),
    )


def every_kind():
    """Return a proposal of each kind, with pictures and fits that nobody has computed."""
    proposals = tuple(map(proposal, ADDITIONS))
    outcome = TermProposals(
        proposals=proposals,
        smallest_effect=0.3,
        status="found",
        message="Effects from 0.3 Nm on would have been seen.",
        candidates=27,
        rejected=("Add a curve of z to y: no better",),
        excluded={"m": "it is the target"},
        remarks=("a remark",),
        seconds=(0.5, 2.0),
        unit="Nm",
    )
    own = np.array([0.25, np.inf])
    gap = np.array([1.5, np.nan])
    picture = TermPicture(own, "y", "Nm", "degC", "", "", np.arange(3.0), np.array([4, 0]), gap, gap, own[:1], own[:1])
    shared = Axis([0.0, 1.0], "x", name="AxisX")
    base = [Curve("Base", shared, np.array([1 / 3, 2.0])), Curve("Other", shared, np.array([0.0, 1.0]))]
    values = tuple(ParameterSet([*base, *([] if each.parameter is None else [each.parameter])]) for each in proposals)
    return DrawnProposals(outcome, (picture,) * len(proposals), values)

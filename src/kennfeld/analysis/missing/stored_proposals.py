"""Drawn proposals as JSON and back: what a file of proposals holds beside that of `kennfeld propose --json`."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from kennfeld.analysis.missing.picture import DrawnProposals, TermPicture
from kennfeld.analysis.missing.proposal import EqualPlace, HeldOutErrors, RmseChange, TermProposal, TermProposals
from kennfeld.analysis.missing.refit import Addition, no_mean
from kennfeld.analysis.missing.terms import KINDS, MissingTerm
from kennfeld.base.arrays import Float
from kennfeld.base.markup import round_digits
from kennfeld.calfiles.format import CalibrationSource
from kennfeld.calfiles.json_file import read_json, write_json
from kennfeld.domain.constraints import Pin
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter

DIGITS = 6  # of what is drawn
_TEXTS = ("criterion", "unit", "input_unit", "second_unit", "value_unit")
_ARRAYS = tuple(field.name for field in fields(TermPicture) if field.name not in _TEXTS)
DETAILS = "details"  # the key beside those of `--json`


def proposals_as_json(drawn: DrawnProposals, values: Sequence[str]) -> dict[str, Any]:
    """Return what `kennfeld propose --json` prints, and all else that is needed to draw and apply the proposals.

    Args:
        drawn: the proposals.
        values: names of the parameters that a fit changes, beside the new one.
    """
    found = drawn.found
    details = [
        _details(proposal, picture, fitted, values)
        for proposal, picture, fitted in zip(found.proposals, drawn.pictures, drawn.values, strict=True)
    ]
    return found.as_json() | {"unit": found.unit, "seconds": list(found.seconds), DETAILS: details}


def _details(
    proposal: TermProposal, picture: TermPicture, fitted: ParameterSet, values: Sequence[str]
) -> dict[str, Any]:
    own = () if proposal.parameter is None else (proposal.parameter.name,)
    tables = ParameterSet([_on_its_own(fitted[name]) for name in (*values, *own) if name in fitted])
    return {
        "addition": None if proposal.addition is None else _addition(proposal.addition),
        "places": [_addition(place.addition) for place in proposal.equal_places if place.addition is not None],
        "held_name": proposal.held_name,
        "held_out": [[part.name, part.samples, part.rmse.before, part.rmse.after] for part in proposal.held_out_parts],
        "offsets": proposal.offsets,
        "picture": {name: getattr(picture, name) for name in _TEXTS}
        | {name: round_digits(getattr(picture, name), DIGITS) for name in _ARRAYS},
        "fit": json.loads(write_json(tables, "")) if len(tables) else {},
    }


def _on_its_own(parameter: Parameter) -> Parameter:
    """Return a parameter with axes that it shares with no other one."""
    return parameter.changed(axes=tuple(axis.changed(name="") for axis in parameter.axes))


def _addition(addition: Addition) -> dict[str, Any]:
    parameter = addition.parameter
    return {
        "term": {field.name: _plain(getattr(addition.term, field.name)) for field in fields(MissingTerm)},
        "parameter": None if parameter is None else parameter.name,
        "smoothness": addition.smoothness,
        "pin": None if addition.pin is None else [*addition.pin.at, addition.pin.value],
        "locked": [] if parameter is None else np.flatnonzero(parameter.locked).tolist(),
        "mean": bool(addition.constraints),
    }


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def proposals_from_json(content: Mapping[str, Any]) -> DrawnProposals:
    """Return the proposals that `proposals_as_json` has written.

    Raises:
        ValueError: something is not as it was written; also `KeyError`, `TypeError`, `AttributeError` and `InputError`.
    """
    rows, details = content["proposals"], content[DETAILS]
    pictures = tuple(_picture(each["picture"]) for each in details)
    values = tuple(_values(each["fit"]) for each in details)
    unit = str(content["unit"])
    proposals = tuple(_proposal(*each, unit) for each in zip(rows, details, values, strict=True))
    found = TermProposals(
        proposals=proposals,
        smallest_effect=_number(content["smallest_effect"]),
        status=str(content["status"]),
        message=str(content["message"]),
        candidates=int(content["candidates"]),
        share_left=_number(content["share_left"]),
        share=_number(content["share"]),
        rejected=tuple(map(str, content["rejected"])),
        excluded={str(name): str(reason) for name, reason in content["excluded"].items()},
        remarks=tuple(map(str, content["remarks"])),
        seconds=(float(content["seconds"][0]), float(content["seconds"][1])),
        unit=unit,
    )
    return DrawnProposals(found, pictures, values)


def _proposal(row: Mapping[str, Any], details: Mapping[str, Any], fitted: ParameterSet, unit: str) -> TermProposal:
    addition = _read_addition(details["addition"])
    places = [_read_addition(each) for each in details["places"]]
    name = "" if addition.parameter is None else addition.parameter.name
    parameter = fitted[name] if name else None
    term = addition.term
    if parameter is not None and term.kind == "lag":
        term = replace(term, seconds=float(parameter.values))
    return TermProposal(
        term=term,
        equal_places=tuple(EqualPlace(each.term.node, each.term.kind, each.term.channel, each) for each in places),
        rmse=_change(row["rmse"]),
        held_out=_change(row["held_out"]),
        held_name=str(details["held_name"]),
        test=None if row["test"] is None else _change(row["test"]),
        predicted=_number(row["predicted"]),
        probability=_number(row["probability"]),
        parameter=parameter,
        better=int(row["parts"]["better"]),
        parts=int(row["parts"]["all"]),
        unit=unit,
        location=str(row["location"]),
        patch=str(row["patch"]),
        addition=addition,
        criteria=tuple((str(each["node"]), _change(each["rmse"])) for each in row["criteria"]),
        offsets={str(name): _number(value) for name, value in details["offsets"].items()},
        held_out_parts=tuple(
            HeldOutErrors(str(name), int(samples), RmseChange(_number(before), _number(after)))
            for name, samples, before, after in details["held_out"]
        ),
    )


def _change(row: Mapping[str, Any]) -> RmseChange:
    return RmseChange(_number(row["before"]), _number(row["after"]))


def _number(value: Any) -> float:
    # null stands for numbers that are not finite
    return float("nan") if value is None else float(value)


def _array(values: Any) -> Float:
    return np.array([_number(value) for value in values], dtype=np.float64)


def _picture(content: Mapping[str, Any]) -> TermPicture:
    arrays: dict[str, Any] = {name: _array(content[name]) for name in _ARRAYS}
    deviation = np.where(np.isnan(arrays["deviation"]), np.inf, arrays["deviation"])
    counts = arrays["counts"].astype(np.int64)
    texts: dict[str, Any] = {name: str(content[name]) for name in _TEXTS}
    return TermPicture(**texts, **{**arrays, "deviation": deviation, "counts": counts})


def _values(content: Mapping[str, Any]) -> ParameterSet:
    if not content:
        return ParameterSet()
    return read_json(CalibrationSource("fit", json.dumps(content).encode())).parameters


def _read_addition(content: Mapping[str, Any]) -> Addition:
    own = content["term"]
    if own["kind"] not in KINDS:
        raise ValueError(f"unknown kind of terms {own['kind']!r}")
    numbers: dict[str, Any] = {name: tuple(map(float, own[name])) for name in ("breakpoints", "second_breakpoints")}
    texts: dict[str, Any] = {name: str(own[name]) for name in ("node", "kind", "channel", "second")}
    term = MissingTerm(**texts, **numbers, seconds=float(own["seconds"]), steps=int(own["steps"]))
    label = content["parameter"]
    if label is not None and not re.fullmatch(r"\w+", str(label)):
        raise ValueError(f"{label!r} is not the name of a parameter")
    parameter = None if label is None else term.parameter(str(label))
    if parameter is None:
        return Addition(term, None)
    if content["locked"]:
        locked = np.zeros(parameter.size, dtype=bool)
        locked[list(map(int, content["locked"]))] = True
        parameter = parameter.changed(locked=locked.reshape(parameter.values.shape))
    pin = None
    if content["pin"] is not None:
        *at, value = map(float, content["pin"])
        pin = Pin(parameter.name, tuple(at), value)
    mean = () if not content["mean"] else (no_mean(parameter.name, term),)
    return Addition(term, parameter, float(content["smoothness"]), pin, mean)

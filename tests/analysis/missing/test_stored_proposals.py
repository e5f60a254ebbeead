"""Proposals of every kind, written as JSON and read back: nothing that is drawn or applied is lost."""

import json
from dataclasses import fields

import numpy as np
import pytest

from kennfeld.analysis.missing.picture import TermPicture
from kennfeld.analysis.missing.stored_proposals import proposals_as_json, proposals_from_json
from tests.analysis.missing.drawn_proposals import every_kind


@pytest.fixture
def drawn():
    return every_kind()


def test_proposals_of_every_kind_are_read_back_as_they_were(drawn):
    content = json.loads(json.dumps(proposals_as_json(drawn, ["Base", "Other"]), allow_nan=False))
    again = proposals_from_json(content)
    for before, after in zip(drawn.found.proposals, again.found.proposals, strict=True):
        # a parameter has no unit and no bounds but those of its kind
        assert (before.change, before.text, before.remark) == (after.change, after.text, after.remark)
        assert [place.addition.term for place in before.equal_places] == [
            place.addition.term for place in after.equal_places
        ]
        for name in (
            "offsets",
            "held_out_parts",
            "better",
            "parts",
            "criteria",
            "location",
            "patch",
            "probability",
            "test",
        ):
            assert getattr(before, name) == getattr(after, name), name
        old, new = before.addition, after.addition
        assert (old.term, old.smoothness, old.pin, old.constraints) == (
            new.term,
            new.smoothness,
            new.pin,
            new.constraints,
        )
        if before.parameter is not None:
            np.testing.assert_array_equal(before.parameter.values, after.parameter.values)
            np.testing.assert_array_equal(old.parameter.locked, new.parameter.locked)
            np.testing.assert_array_equal(old.parameter.values, new.parameter.values)
            assert old.parameter.name == new.parameter.name
    np.testing.assert_array_equal(again.values[0]["Other"].values, [0.0, 1.0])
    for name in (field.name for field in fields(TermPicture)):
        np.testing.assert_array_equal(getattr(drawn.pictures[0], name), getattr(again.pictures[0], name), name)
    assert again.found.lines() == drawn.found.lines()


def test_a_list_that_was_changed_by_hand_is_refused(drawn):
    content = proposals_as_json(drawn, [])
    content["details"][0]["addition"]["parameter"] = "a\ndef f(x) = x"
    with pytest.raises(ValueError, match="not the name of a parameter"):
        proposals_from_json(content)
    content["details"][0]["addition"]["term"]["kind"] = "remove"
    with pytest.raises(ValueError, match="unknown kind of terms 'remove'"):
        proposals_from_json(content)

import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles import merge
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.domain.texts import Text
from tests.calfiles.calibration_sets import parameter_sets
from tests.draws import few_or_many

SLOW, FAST = (Axis(points, name="Speed") for points in ([1, 2], [1, 3]))


def changes_of(merged):
    return [(change.name, change.source, change.replaces) for change in merged.changes]


@few_or_many(members=parameter_sets(cubes=True), few=10, many=100)
def test_merging_a_set_with_itself_changes_nothing(members):
    merged = merge([("a", members), ("b", members)])
    assert merged.parameters == members
    assert merged.changes == ()


def test_later_ones_win_and_new_ones_follow():
    first = ParameterSet([Scalar("A", 1), Scalar("B", 2)], [Text("T", "x")])
    second = ParameterSet([Scalar("C", 3), Scalar("A", 9)], [Text("T", "y")])
    third = ParameterSet([Scalar("A", 10), Scalar("B", 2)])
    merged = merge([("1", first), ("2", second), ("3", third)])
    expected = ParameterSet([Scalar("A", 10), Scalar("B", 2), Scalar("C", 3)], [Text("T", "y")])
    assert merged.parameters == expected
    assert changes_of(merged) == [("C", "2", ""), ("A", "2", "1"), ("T", "2", "1"), ("A", "3", "2")]
    assert merged.changes[-1].differences[0].largest == 1.0


def test_a_number_may_replace_a_text():
    merged = merge([("1", ParameterSet((), [Text("K", "on")])), ("2", ParameterSet([Scalar("K", 1)]))])
    assert merged.parameters == ParameterSet([Scalar("K", 1)])
    assert merged.changes[0].differences[0].aspect == "kind"


def test_a_group_axis_moves_with_all_its_tables():
    old = ParameterSet([Curve("C", SLOW, [1, 2]), Curve("D", SLOW, [1, 2])])
    new = ParameterSet([Curve("C", FAST, [1, 2]), Curve("D", FAST, [1, 2])])
    merged = merge([("old", old), ("new", new)])
    assert merged.parameters == new
    assert changes_of(merged) == [("C", "new", "old"), ("D", "new", "old"), ("Speed", "new", "old")]


@pytest.mark.parametrize("new", [ParameterSet([Curve("C", FAST, [1, 2])]), ParameterSet((), (), [FAST])])
def test_a_table_that_stays_keeps_its_group_axis(new):
    old = ParameterSet([Curve("D", SLOW, [1, 2]), Curve("E", SLOW, [1, 2])])
    with pytest.raises(InputError) as caught:
        merge([("old.dcm", old), ("new.dcm", new)])
    assert str(caught.value) == (
        "new.dcm: group axis Speed has other breakpoints than in old.dcm, where 2 labels (D, E) are defined. "
        "Define these tables in new.dcm too, or make the breakpoints equal."
    )


def test_a_group_axis_without_a_table_is_replaced():
    merged = merge([("old", ParameterSet((), (), [SLOW])), ("new", ParameterSet((), (), [FAST]))])
    assert merged.parameters.axes == (FAST,)


def test_a_variant_is_replaced_by_its_own_and_the_others_stay():
    old = ParameterSet([Scalar("K", 1, variant="E=1")], others=[Scalar("K", 2, variant="E=2")])
    new = ParameterSet([Scalar("K", 3, variant="E=2")])
    merged = merge([("old", old), ("new", new)])
    assert (merged.parameters["K"].value, merged.parameters.variants) == (3, ("E=2", "E=1"))
    assert [one.largest for one in merged.changes[0].differences] == [2.0]

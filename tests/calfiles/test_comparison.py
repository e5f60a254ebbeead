import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import ArgumentError
from kennfeld.calfiles import Comparison, Difference, Tolerance, changed, compare, read
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Curve, Map, Scalar
from kennfeld.domain.texts import Text
from tests.calfiles.calibration_sets import parameter_sets
from tests.draws import few_or_many

SPEED = Axis([1000, 2000], unit="rpm", name="Speed")


def differences(left, right, **tolerance):
    as_set = [one if isinstance(one, ParameterSet) else ParameterSet([one]) for one in (left, right)]
    return compare(*as_set, Tolerance(**tolerance)).differences


@few_or_many(members=parameter_sets(cubes=True), few=10, many=100)
def test_a_set_equals_itself(members):
    names = {*members, *(text.name for text in members.texts), *(axis.name for axis in members.axes)}
    assert compare(members, members) == Comparison((), len(names))


@few_or_many(members=parameter_sets(cubes=True), data=st.data(), few=10, many=100)
def test_one_changed_number_is_the_only_difference(members, data):
    if not len(members):
        return
    chosen = data.draw(st.sampled_from(members.parameters))
    at = data.draw(st.integers(0, chosen.size - 1))
    values = chosen.values.ravel().copy()
    values[at] = np.nextafter(values[at], 0.0 if values[at] else 1.0)
    [difference] = compare(members, members.with_parameters(chosen.with_values(values))).differences
    assert (difference.name, difference.aspect, difference.count, difference.total) == (
        chosen.name,
        "values",
        1,
        chosen.size,
    )
    assert float(difference.left) == chosen.values[difference.index]
    assert float(difference.right) == values[at]


def test_the_largest_difference_is_reported_with_its_place():
    left = Map("M", [0, 1], SPEED, [[1, 2], [3, 4]])
    right = Map("M", [0, 1], SPEED, [[1, 2.5], [1, 4]])
    assert differences(left, right) == (Difference("M", "values", "3.0", "1.0", 2, 4, 2.0, (1, 0), "x = 1, y = 1000"),)


def test_a_missing_value_is_farther_away_than_any_number():
    [difference] = differences(Block("B", [1.0, 2.0, np.nan]), Block("B", [1e300, np.nan, np.nan]))
    assert (difference.count, difference.index, difference.largest, difference.place) == (2, (1,), np.inf, "[1]")
    assert difference.as_json["largest"] is None
    assert difference.as_json["right"] is None


def test_zero_has_no_sign():
    assert differences(Scalar("K", 0.0), Scalar("K", -0.0)) == ()


def test_differences_beyond_the_largest_number_are_reported():
    [difference] = differences(Scalar("K", 1.7e308), Scalar("K", -1.7e308))
    assert difference.largest == np.inf


@pytest.mark.parametrize(
    ("tolerance", "equal"),
    [({}, False), ({"absolute": 0.5}, True), ({"absolute": 0.49}, False), ({"relative": 0.005}, True)],
)
def test_tolerances(tolerance, equal):
    assert (differences(Scalar("K", 100.0), Scalar("K", 100.5), **tolerance) == ()) is equal


@pytest.mark.parametrize("tolerance", [-1.0, np.nan, np.inf])
def test_a_tolerance_must_be_a_number_from_0_on(tolerance):
    with pytest.raises(ArgumentError, match="must be a finite number >= 0"):
        Tolerance(tolerance)


def test_labels_of_one_side_alone_are_differences():
    left = ParameterSet([Scalar("K", 1)], [Text("T", "a")])
    right = ParameterSet([Curve("C", SPEED, [1, 2])])
    assert differences(left, right) == (
        Difference("K", "presence", "scalar", ""),
        Difference("T", "presence", "text", ""),
        Difference("C", "presence", "", "curve of 2"),
        Difference("Speed", "presence", "", "group axis of 2"),
    )


def test_a_group_axis_is_reported_once():
    moved = SPEED.changed(breakpoints=np.array([1000.0, 2500.0]))
    left, right = (ParameterSet([Curve("C", axis, [1, 2]), Curve("D", axis, [1, 2])]) for axis in (SPEED, moved))
    assert differences(left, right) == (
        Difference("Speed", "breakpoints", "2000.0", "2500.0", 1, 2, 500.0, (1,), "[1]"),
    )


def test_kinds_sizes_units_axes_and_texts():
    own = SPEED.changed(name="")
    assert differences(Scalar("K", 1), Block("K", [1])) == (Difference("K", "kind", "scalar", "block of 1"),)
    assert differences(Block("B", [1, 2]), Block("B", [1])) == (Difference("B", "size", "2", "1"),)
    assert differences(Scalar("K", 1, unit="Nm"), Scalar("K", 1)) == (Difference("K", "unit", "Nm", ""),)
    assert differences(Curve("C", own, [1, 2]), Curve("C", own.changed(unit="1/s"), [1, 2])) == (
        Difference("C", "x unit", "rpm", "1/s"),
    )
    assert differences(Curve("C", own, [1, 2]), Curve("C", [1000, 2001], [1, 2])) == (
        Difference("C", "x breakpoints", "2000.0", "2001.0", 1, 2, 1.0, (1,), "[1]"),
        Difference("C", "x unit", "rpm", ""),
    )
    assert Difference("C", "x group axis", "Speed", "none") in differences(
        Curve("C", SPEED, [1, 2]), Curve("C", own, [1, 2])
    )
    texts = [ParameterSet((), [Text("T", text)]) for text in "ab"]
    assert differences(*texts) == (Difference("T", "text", "a", "b"),)
    assert differences(texts[0], Scalar("T", 1)) == (Difference("T", "kind", "text", "scalar"),)


def test_variants_are_compared_each_with_its_own():
    left = ParameterSet([Scalar("K", 1, variant="E=1")], others=[Scalar("K", 2, variant="E=2")])
    right = ParameterSet([Scalar("K", 2, variant="E=2")], others=[Scalar("K", 1.5, variant="E=1")])
    [difference] = compare(left, right).differences
    assert (difference.name, difference.left, difference.right) == ("K (E=1)", "1.0", "1.5")


def test_a_file_without_variants_is_compared_with_what_counts_in_the_other():
    left = ParameterSet([Scalar("K", 1)])
    right = ParameterSet([Scalar("K", 1, variant="E=1")], others=[Scalar("K", 2, variant="E=2")])
    [difference] = compare(left, right).differences
    assert (difference.name, difference.aspect) == ("K (E=2)", "presence")


def test_a_difference_names_the_function_that_uses_the_label():
    left, right = (ParameterSet([Scalar("K", value, functions=["F", "G"])]) for value in (1, 2))
    assert compare(left, right).differences[0].as_json["function"] == "F"


def test_a_block_of_a_script_is_compared_with_the_table_of_its_numbers():
    block, table = Block("M", [[1, 2], [3, 4]]), Map("M", Axis([1000, 2000]), Axis([10, 20]), [[1, 2], [3, 9]])
    kind, values = differences(block, table)
    assert (kind.aspect, values.aspect) == ("kind", "values")
    assert (values.largest, values.place) == (5.0, "x = 2000, y = 20")
    assert [one.aspect for one in differences(block, table.changed(values=np.array([[1, 2], [3, 4.0]])))] == ["kind"]
    assert [one.aspect for one in differences(Block("C", [1, 2, 3]), Curve("C", Axis([1, 2]), [1, 2]))] == ["kind"]


def test_a_block_of_a_script_is_compared_with_the_group_axis_of_its_name():
    script = ParameterSet([Block("Speed", [1000.0, 2500.0])])
    changes = [one for one in differences(script, ParameterSet([Curve("C", SPEED, [1, 2])])) if one.name == "Speed"]
    assert [(one.aspect, one.largest) for one in changes] == [("kind", None), ("values", 500.0)]


@pytest.mark.parametrize(
    ("other", "aspect", "left", "right"),
    [
        (Text("T", "true", kind="boolean"), "kind", "enumeration", "boolean"),
        (Text("T", "true"), "kind", "enumeration", "text"),
        (Text("T", "true", kind="enumeration", unit="-"), "unit", "", "-"),
        (Scalar("T", 1), "kind", "enumeration", "scalar"),
    ],
)
def test_another_kind_of_text_is_a_difference(other, aspect, left, right):
    one = ParameterSet([], [Text("T", "true", kind="enumeration")])
    [difference] = differences(one, ParameterSet([], [other]) if isinstance(other, Text) else other)
    assert (difference.name, difference.aspect, difference.left, difference.right) == ("T", aspect, left, right)


def test_the_changed_labels_are_those_with_other_values_or_axes_and_form_a_new_file(tmp_path):
    axis, moved = Axis([0, 1, 2], name="AxisN"), Axis([0, 1.5, 2], name="AxisN")

    def labels(shared, k, lone):
        tables = [Curve("A", shared, [1, 2, 3]), Map("B", [0, 1], shared, [[1, 2, 3], [4, 5, 6]])]
        return ParameterSet([*tables, Scalar("K", k), Curve("L", [0, 1], [1, lone]), Scalar("Same", 1.0)])

    before = labels(axis, 1.0, 2.0)
    before.save(tmp_path / "before.dcm")
    old = read(tmp_path / "before.dcm")
    values = read(tmp_path / "before.dcm").with_parameters(Scalar("K", 3.0))
    values.save(tmp_path / "after.dcm")
    assert list(changed(read(tmp_path / "after.dcm"), old)) == ["K"]
    changed(read(tmp_path / "after.dcm"), old).save(tmp_path / "changed.dcm")
    assert list(read(tmp_path / "changed.dcm")) == ["K"]
    both = changed(labels(moved, 1.0, 2.5), before)
    assert list(both) == ["A", "B", "L"]
    assert [each.name for each in both.axes] == ["AxisN"]
    assert list(changed(before, before)) == []

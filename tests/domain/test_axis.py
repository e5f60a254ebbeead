import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.axis import Axis


def test_an_axis_holds_its_breakpoints_as_doubles():
    axis = Axis([700, 1000, 1500], input="Speed", unit="rpm", name="AxisSpeed")
    assert axis.breakpoints.dtype == np.float64
    assert len(axis) == 3
    assert (axis.input, axis.unit, axis.name) == ("Speed", "rpm", "AxisSpeed")


def test_an_axis_of_one_breakpoint():
    assert Axis(5.0).breakpoints.tolist() == [5.0]


@pytest.mark.parametrize(
    ("axis", "label"),
    [(Axis([1], name="A", input="x"), "A"), (Axis([1], input="x"), "x"), (Axis([1]), "without a name")],
)
def test_an_axis_is_called_by_its_name_or_its_input(axis, label):
    assert axis.label == label


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([], "breakpoints of axis Speed must be one-dimensional, got shape \\(0,\\)"),
        ([[1, 2], [3, 4]], "breakpoints of axis Speed must be one-dimensional, got shape \\(2, 2\\)"),
        ([1, np.nan], "breakpoints of axis Speed must be finite"),
        ([1, np.inf], "breakpoints of axis Speed must be finite"),
        ([1, 3, 3], "breakpoints of axis Speed must increase: number 3 \\(3\\) does not exceed number 2 \\(3\\)"),
        ([1, 3, 2, 0], "must increase: number 3 \\(2\\) does not exceed number 2 \\(3\\)"),
    ],
)
def test_wrong_breakpoints_are_refused(points, message):
    with pytest.raises(ArgumentError, match=message):
        Axis(points, input="Speed")


def test_axes_are_equal_by_what_they_hold():
    assert Axis([1, 2], input="x") == Axis([1.0, 2.0], input="x")
    assert hash(Axis([1, 2])) == hash(Axis([1.0, 2.0]))
    assert Axis([1, 2], input="x") != Axis([1, 2], input="y")
    assert Axis([1, 2], unit="s") != Axis([1, 2])
    assert Axis([1, 2], name="A") != Axis([1, 2])
    assert Axis([1, 2]) != Axis([1, 3])
    assert Axis([1, 2]) != [1, 2]


def test_an_axis_keeps_its_own_copy():
    source = np.array([1.0, 2.0])
    axis = Axis(source)
    source[:] = 7.0
    assert axis.breakpoints.tolist() == [1.0, 2.0]
    assert source.flags.writeable

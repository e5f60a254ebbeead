"""Numbers of any type and layout give the result of doubles, at every entry of the Python API."""

from functools import cache

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.constraints import Equality, Shape, Term
from tests.draws import mostly_slow

NUMBERS = [int, np.int8, np.int64, np.float32, np.float64, np.array]
X = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])


def read_only(values):
    copied = values.copy()
    copied.setflags(write=False)
    return copied


def series(kind):
    def make(values):
        return pytest.importorskip("pandas").Series(values).astype(kind)

    return make


COLUMNS = {
    "int": lambda values: values.astype(int),
    "list of int": lambda values: [int(value) for value in values],
    "float32": lambda values: values.astype(np.float32),
    "uint8": lambda values: values.astype(np.uint8),
    "big-endian": lambda values: values.astype(">f8"),
    "every other": lambda values: np.repeat(values, 2)[::2],
    "backwards": lambda values: values[::-1].copy()[::-1],
    "column of a matrix": lambda values: np.column_stack([values, values])[:, 1],
    "row of a Fortran matrix": lambda values: np.asfortranarray([values, values])[1],
    "read-only": read_only,
    "objects": lambda values: values.astype(object),
    "series": series("float64"),
    "Int64": series("Int64"),
    "Float32": series("Float32"),
}


@pytest.mark.parametrize("of", NUMBERS)
def test_weights_of_any_type_let_a_value_move(of):
    data = kf.Dataset.of("bench", {"x": X, "z": 3 * X}, weight=of(2))
    result = kf.calibrate("m = k * x", data, {"k": 1}, criteria=[kf.Criterion("m", "z", weight=of(1))])
    assert result.status == "converged"
    assert result.parameters["k"].value == pytest.approx(3)


def fitted(of=float):
    """A problem with every kind of number that the API takes, all of them whole."""
    data = kf.Dataset.of("bench", {"x": X, "z": 3 * X + X**2, "w": X}, weight=of(2), weight_channel="w")
    start = kf.ParameterSet([kf.Curve("C", [of(0), of(3), of(6)], [of(1)] * 3), kf.Scalar("k", of(1))])
    return kf.calibrate(
        "m = C(x) + k * x",
        data,
        start,
        criteria=[
            kf.Criterion(
                "m", "z", weight=of(3), scale=of(2), delta=of(1), loss="huber", regions=[kf.Region("x > 3", of(2))]
            )
        ],
        smoothness=of(1),
        bounds={"k": (of(0), of(9))},
        limits={"m": (of(-50), of(50))},
        pins=[kf.Pin("C", (of(0),), of(1))],
        constraints=[
            Shape("C", 0, "slope", lower=of(-20), upper=of(20)),
            Equality([Term("C", (of(6),), of(2))], of(40)),
        ],
        options=kf.Options(tolerance=1e-10),
    )


@cache
def result_of_floats():
    return fitted()


@pytest.mark.parametrize("of", mostly_slow(NUMBERS, [np.array]))
def test_settings_of_any_type_give_the_result_of_floats(of):
    expected, result = result_of_floats(), fitted(of)
    assert result.status == expected.status == "converged"
    for name, parameter in expected.parameters.items():
        np.testing.assert_allclose(result.parameters[name].values, parameter.values, rtol=1e-12)


@pytest.mark.parametrize("kind", mostly_slow(COLUMNS, ["list of int", "big-endian", "backwards", "Int64"]))
def test_columns_of_any_type_and_layout_give_the_result_of_doubles(kind):
    make = COLUMNS[kind]
    columns = {"x": X, "z": 3 * X, "w": X}
    axis, values = np.array([0.0, 3.0, 6.0]), np.ones(3)

    def run(of):
        data = {name: of(column) for name, column in columns.items()}
        start = kf.ParameterSet([kf.Curve("C", of(axis), of(values), lower=of(0 * axis), upper=of(values + 40))])
        return kf.calibrate("m = C(x)", kf.Dataset.of("bench", data, weight_channel="w"), start, "z")

    expected, result = run(np.asarray), run(make)
    assert result.status == "converged"
    assert result.cost_after == expected.cost_after
    np.testing.assert_array_equal(result.parameters["C"].values, expected.parameters["C"].values)


@pytest.mark.parametrize("kind", COLUMNS)
def test_simulations_read_columns_of_any_type_and_layout(kind):
    times = COLUMNS[kind](X)
    data = kf.Dataset.of("ramp", {"u": COLUMNS[kind](X)}, time=times)
    expected = kf.simulate("y = PT1(u, 2)", kf.Dataset.of("ramp", {"u": X}, time=X), {})
    np.testing.assert_array_equal(kf.simulate("y = PT1(u, 2)", data, {})["y"].values, expected["y"].values)


@pytest.mark.parametrize("wrong", ["1", np.array([1.0, 2.0]), np.array("1"), None, 1j])
@pytest.mark.parametrize(
    "make",
    [
        lambda value: kf.Dataset.of("bench", {"x": X}, weight=value),
        lambda value: kf.Dataset.of("bench", {"x": X}, max_gap=value),
        lambda value: kf.Dataset.of("bench", {"x": X}, warmup=value),
        lambda value: kf.Criterion("m", "z", weight=value),
        lambda value: kf.Criterion("m", "z", scale=value),
        lambda value: kf.Criterion("m", "z", delta=value),
        lambda value: kf.Region("x > 1", value),
        lambda value: kf.Settling(value),
        lambda value: Equality([Term("C")], value),
        lambda value: Term("C", factor=value),
        lambda value: kf.Options(spread=value),
    ],
)
def test_settings_other_than_numbers_are_refused(make, wrong):
    with pytest.raises(kf.KennfeldError, match=r"must be a (finite )?number"):
        make(wrong)


@pytest.mark.parametrize("wrong", ["1", np.array([1.0, 2.0]), np.array("1"), 1j])
@pytest.mark.parametrize(
    "make", [lambda value: kf.Limit("m", upper=value), lambda value: Shape("C", 0, "slope", lower=value)]
)
def test_bounds_other_than_numbers_and_none_are_refused(make, wrong):
    assert make(None).upper == np.inf
    with pytest.raises(kf.KennfeldError, match="must be a number"):
        make(wrong)


@pytest.mark.parametrize("wrong", ["1", np.array([1.0, 2.0]), 1j])
def test_a_tolerance_is_a_number_or_chosen_automatically(wrong):
    assert kf.Options(tolerance=None).tolerance is None
    with pytest.raises(kf.KennfeldError, match="must be a finite number"):
        kf.Options(tolerance=wrong)


def test_all_columns_with_text_are_reported():
    columns = {"x": X, "gear": list("abcdef"), "driver": ["A", *X[1:]]}
    with pytest.raises(kf.InputError) as error:
        kf.calibrate("m = k * x", columns, {"k": 1.0}, "x")
    assert [str(finding) for finding in error.value.findings] == [
        "dataset training: channel gear must be numbers, got 'a' at position 1. Omit it, or replace it by numbers.",
        "dataset training: channel driver must be numbers, got 'A' at position 1. Omit it, or replace it by numbers.",
    ]


def test_text_in_place_of_values_is_refused():
    for make in (
        lambda: kf.Scalar("k", "high"),
        lambda: kf.Curve("C", [0, 1], ["low", "high"]),
        lambda: kf.Curve("C", ["low", "high"], [0, 1]),
        lambda: kf.Curve("C", [0, 1], [0, 1], upper="high"),
        lambda: kf.Map("M", [0, 1], [0, 1], [[0, "a"], [1, 2]]),
    ):
        with pytest.raises(kf.KennfeldError, match="must be numbers, got"):
            make()

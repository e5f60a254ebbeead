"""Blocks that set, choose, turn, multiply and invert arrays, against numpy."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import alone, imported, run, slopes

RNG = np.random.default_rng(5)
N = 6


def wide(kind, sizes, outputs=1, **parameters):
    """A block alone whose inports have these sizes."""
    special = parameters.pop("special", None)
    drawn = alone(kind, len(sizes), outputs, special=special, **parameters)
    for block, size in zip([one for one in drawn.blocks if one.kind == "Inport"], sizes, strict=True):
        block.parameters["PortDimensions"] = str(size)
    return drawn


def columns(**arrays):
    """The columns of inports by name; arrays are Float[samples, ...], elements columns first."""
    channels = {}
    for name, array in arrays.items():
        flat = array.reshape(len(array), -1, order="F") if array.ndim > 1 else array[:, None]
        if flat.shape[1] == 1:
            channels[name] = flat[:, 0]
        else:
            channels |= {f"{name}[{at + 1}]": flat[:, at] for at in range(flat.shape[1])}
    return channels


def gathered(outputs, name="y1"):
    """The elements of an output, Float[samples, elements]."""
    if name in outputs:
        return outputs[name][:, None]
    count = sum(key.startswith(f"{name}[") for key in outputs)
    return np.stack([outputs[f"{name}[{at + 1}]"] for at in range(count)], axis=1)


Y0, U2 = RNG.normal(size=(N, 4)), RNG.normal(size=(N, 2))
ONE, M = RNG.normal(size=N), RNG.normal(size=(N, 2, 3))


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl package"]))
def test_elements_at_fixed_places_are_replaced(layout, tmp_path):
    drawn = wide("Assignment", (4, 2), IndexOptions="Index vector (dialog)", Indices="[4 2]", OutputSizes="1")
    output = gathered(run(imported(drawn, tmp_path, layout), columns(u1=Y0, u2=U2)))
    expected = Y0.copy()
    expected[:, [3, 1]] = U2
    np.testing.assert_array_equal(output, expected)


def test_a_scalar_goes_to_all_places_and_a_start_counts_on(tmp_path):
    ends = {"IndexOptions": "Index vector (dialog)", "Indices": "[0 3]", "IndexMode": "Zero-based"}
    drawn = wide("Assignment", (4, 1), **ends)
    output = gathered(run(imported(drawn, tmp_path), columns(u1=Y0, u2=ONE)))
    np.testing.assert_array_equal(output, np.stack([ONE, Y0[:, 1], Y0[:, 2], ONE], axis=1))
    drawn = wide("Assignment", (4, 2), IndexOptions="Starting index (dialog)", Indices="3")
    output = gathered(run(imported(drawn, tmp_path), columns(u1=Y0, u2=U2)))
    np.testing.assert_array_equal(output, np.concatenate([Y0[:, :2], U2], axis=1))
    drawn = wide("Assignment", (4, 1), IndexOptions="Assign all", Indices="")
    output = gathered(run(imported(drawn, tmp_path), columns(u1=Y0, u2=ONE)))
    np.testing.assert_array_equal(output, np.repeat(ONE[:, None], 4, axis=1))


@pytest.mark.parametrize("option", ["Index vector (port)", "Starting index (port)"])
def test_places_may_be_signals(option, tmp_path):
    places = np.array([0.0, 1.0, 2.0, 1.9, 0.0, 9.0])
    drawn = wide("Assignment", (4, 2, 1), IndexMode="Zero-based", IndexOptions=option, Indices="1")
    if option.startswith("Index"):
        drawn = wide("Assignment", (4, 1, 1), IndexMode="Zero-based", IndexOptions=option, Indices="1")
    replacement = U2 if option.startswith("Starting") else U2[:, :1]
    output = gathered(run(imported(drawn, tmp_path), columns(u1=Y0, u2=replacement, u3=places)))
    expected = Y0.copy()
    for k, place in enumerate(places.astype(int)):
        for at in range(replacement.shape[1]):
            if place + at < 4:
                expected[k, place + at] = replacement[k, at]
    np.testing.assert_array_equal(output, expected)


def test_a_matrix_takes_places_in_both_dimensions(tmp_path):
    options = {"IndexOptions": "Index vector (dialog),Index vector (port)", "Indices": "2,1", "OutputSizes": "1,1"}
    drawn = wide("Assignment", ("[2 3]", 1, 1), NumberOfDimensions="2", **options)
    place = np.array([1.0, 2, 3, 1, 2, 3])
    output = gathered(run(imported(drawn, tmp_path), columns(u1=M, u2=ONE, u3=place)))
    expected = M.copy()
    expected[np.arange(N), 1, place.astype(int) - 1] = ONE
    np.testing.assert_array_equal(output, expected.reshape(N, -1, order="F"))


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"IndexOptions": "Index vector (dialog)", "Indices": "9"}, "its index 9 is out of range for 4 elements"),
        ({"OutputInitialize": "Specify size for each dimension in table"}, "would be undefined"),
        ({"NumberOfDimensions": "3"}, "NumberOfDimensions must be an integer from 1 to 2, got 3"),
        ({"IndexOptions": "Index vector (dialog)", "Indices": "[1 2 3]"}, "it assigns 2 elements to 3 positions"),
    ],
)
def test_assignments_of_the_wrong_size_are_reported(parameters, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        imported(wide("Assignment", (4, 2), **parameters), tmp_path)


def test_a_selection_may_start_at_a_signal(tmp_path):
    drawn = wide("Selector", (4, 1), IndexOptions="Starting index (port)", Indices="1", OutputSizes="2")
    place = np.array([1.0, 2, 3, 1, 2, 3])
    output = gathered(run(imported(drawn, tmp_path), columns(u1=Y0, u2=place)))
    np.testing.assert_array_equal(output, [Y0[k, p - 1 : p + 1] for k, p in enumerate(place.astype(int))])


def test_rows_and_columns_change_places(tmp_path):
    swapped = M.transpose(0, 2, 1).reshape(N, -1, order="F")
    for kind, parameters in (("PermuteDimensions", {"Order": "[2,1]"}), ("Math", {"Operator": "transpose"})):
        output = gathered(run(imported(wide(kind, ("[2 3]",), **parameters), tmp_path), columns(u1=M)))
        np.testing.assert_array_equal(output, swapped)
    output = gathered(run(imported(wide("Squeeze", ("[2 3]",)), tmp_path), columns(u1=M)))
    np.testing.assert_array_equal(output, M.reshape(N, -1, order="F"))
    with pytest.raises(InputError, match=r"its Order \[3 1 2\] is not"):
        imported(wide("PermuteDimensions", ("[2 3]",), Order="[3 1 2]"), tmp_path)


def test_a_vector_becomes_a_matrix(tmp_path):
    drawn = wide("Reference", (4,), special="Convert 1-D to 2-D", M="2", N="2")
    drawn.block("Product", "P", ports=(2, 1), Multiplication="Matrix(*)")
    drawn.wires[-1].ends = [("P", "in", 1), ("P", "in", 2)]
    drawn.line("P", "y1")
    output = gathered(run(imported(drawn, tmp_path), columns(u1=Y0)))
    square = np.stack([np.array([[a, c], [b, d]]) for a, b, c, d in Y0])
    np.testing.assert_allclose(output, (square @ square).reshape(N, -1, order="F"), rtol=1e-13)


SQUARE = {n: RNG.normal(size=(N, n, n)) + 3 * np.eye(n) for n in (1, 2, 3, 4, 7)}


@pytest.mark.parametrize("size", [1, 2, 3, 4, 7])
def test_matrices_are_inverted(size, tmp_path):
    drawn = wide("Product", (f"[{size} {size}]",), Inputs="/", Multiplication="Matrix(*)")
    output = gathered(run(imported(drawn, tmp_path), columns(u1=SQUARE[size])))
    expected = np.linalg.inv(SQUARE[size])
    np.testing.assert_allclose(output, expected.reshape(N, -1, order="F"), rtol=1e-10, atol=1e-12)


def test_a_product_divides_by_a_matrix(tmp_path):
    rows = RNG.normal(size=(N, 2, 3))
    drawn = wide("Product", ("[2 3]", "[3 3]"), Inputs="*/", Multiplication="Matrix(*)")
    output = gathered(run(imported(drawn, tmp_path), columns(u1=rows, u2=SQUARE[3])))
    expected = rows @ np.linalg.inv(SQUARE[3])
    np.testing.assert_allclose(output, expected.reshape(N, -1, order="F"), rtol=1e-10, atol=1e-12)
    for size in ("[13 13]", "[2 3]"):
        with pytest.raises(InputError, match=r"it inverts a matrix of size .* up to 12 x 12 are supported"):
            imported(wide("Product", (size,), Inputs="/", Multiplication="Matrix(*)"), tmp_path)


def test_an_inverse_exchanges_rows_for_a_pivot_that_is_0(tmp_path):
    turned = np.roll(np.diag([2.0, -3.0, 5.0, 7.0]), 1, axis=0) + np.zeros((N, 4, 4))
    drawn = wide("Product", ("[4 4]",), Inputs="/", Multiplication="Matrix(*)")
    output = gathered(run(imported(drawn, tmp_path), columns(u1=turned)))
    np.testing.assert_allclose(output, np.linalg.inv(turned).reshape(N, -1, order="F"), rtol=1e-13)


def test_determinants_and_cross_products(tmp_path):
    drawn = wide("Reference", ("[3 3]",), special="Determinant of 3x3 Matrix")
    output = run(imported(drawn, tmp_path), columns(u1=SQUARE[3]))["y1"]
    np.testing.assert_allclose(output, np.linalg.det(SQUARE[3]), rtol=1e-12)
    a, b = RNG.normal(size=(2, N, 3))
    drawn = wide("Reference", (3, 3), special="Cross Product")
    output = gathered(run(imported(drawn, tmp_path), columns(u1=a, u2=b)))
    np.testing.assert_allclose(output, np.cross(a, b), rtol=1e-12)


def test_the_slope_through_an_inverse_is_that_of_finite_differences(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Constant", "C", ports=(0, 1), Value="[2 k; 1 3]", VectorParams1D="off")
    drawn.block("Product", "P", ports=(2, 1), Inputs="*/", Multiplication="Matrix(*)")
    drawn.block("Sum", "S", ports=(1, 1), Inputs="+")
    drawn.block("Constant", "R", ports=(0, 1), Value="[1 2]", VectorParams1D="off")
    drawn.block("Product", "Q", ports=(2, 1))
    drawn.outport("y")
    drawn.line("u", "Q:1")
    drawn.line("R", "Q:2")
    drawn.line("Q", "P:1")
    drawn.line("C", "P:2")
    drawn.chain("P", "S", "y")
    model = imported(drawn, tmp_path, parameters=[{"k": 0.7}])
    output = run(model, {"u": ONE})["y"]
    np.testing.assert_allclose(output, ONE * (np.array([1, 2]) @ np.linalg.inv([[2, 0.7], [1, 3]])).sum(), rtol=1e-12)
    exact, differences = slopes(model, {"u": ONE}, "k", "y")
    np.testing.assert_allclose(exact, differences, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("unit", "operator", "rule"),
    [
        ("degree", "sin", lambda u: np.sin(np.radians(u))),
        ("revolution", "cos", lambda u: np.cos(2 * np.pi * u)),
        ("degree", "atan", lambda u: np.degrees(np.arctan(u))),
        ("degree", "tanh", np.tanh),
    ],
)
def test_angles_may_be_counted_in_degrees(unit, operator, rule, tmp_path):
    drawn = alone("Trigonometry", Operator=operator, AngleUnit=unit)
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u1": ONE})["y1"], rule(ONE), rtol=1e-12)

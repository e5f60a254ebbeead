"""Number classes, arrays of three dimensions and texts in MATLAB Functions; numbers as MATLAB documents them."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from kennfeld.matlab.evaluator import evaluate
from tests.importers.simulink.simulink_code import U, V, body, function, outputs
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import imported, run

# arrays of three dimensions

DEEP = "A = reshape(1:8, 2, 2, 2);\nB = [1 2; 3 4];\n"
DEEP_VALUES = [
    ("A + B", [2, 5, 5, 8, 6, 9, 9, 12]),
    ("B - A", [0, 1, -1, 0, -4, -3, -5, -4]),
    ("A .* [1 10]", [1, 2, 30, 40, 5, 6, 70, 80]),
    ("A > B", [0, 0, 1, 0, 1, 1, 1, 1]),
    ("(A > 2) & B", [0, 0, 1, 1, 1, 1, 1, 1]),
    ("max(A, B)", [1, 3, 3, 4, 5, 6, 7, 8]),
    ("mod(A, B)", [0, 2, 1, 0, 0, 0, 1, 0]),
    ("atan2(A - B, 0)*2/pi", [0, -1, 1, 0, 1, 1, 1, 1]),
    ("bitand(A, B)", [1, 2, 2, 4, 1, 2, 2, 0]),
    ("A + reshape([10 20], 1, 1, 2)", [11, 12, 13, 14, 25, 26, 27, 28]),
    ("sum(A)", [3, 7, 11, 15]),
    ("sum(A, 3)", [6, 8, 10, 12]),
    ("max(A, [], 3)", [5, 6, 7, 8]),
    ("cumsum(A, 3)", [1, 2, 3, 4, 6, 8, 10, 12]),
    ("diff(A, 1, 3)", [4, 4, 4, 4]),
    ("sort(A, 3, 'descend')", [5, 6, 7, 8, 1, 2, 3, 4]),
    ("mean(A, 2)", [2, 3, 6, 7]),
    ("repmat(A, 1, 1)", [1, 2, 3, 4, 5, 6, 7, 8]),
    ("cat(3, B, B)", [1, 3, 2, 4, 1, 3, 2, 4]),
    ("cat(1, A(:, :, 1), B)", [1, 2, 1, 3, 3, 4, 2, 4]),
    ("[A A]", [1, 2, 3, 4, 1, 2, 3, 4, 5, 6, 7, 8, 5, 6, 7, 8]),
]


@pytest.mark.parametrize(("text", "values"), DEEP_VALUES)
def test_arrays_of_three_dimensions_are_expanded_from_the_first_one(text, values, tmp_path):
    columns = f"z = {text};\ny = double(numel(z) == {len(values)})*sum(z(:)'.*(1:numel(z))*1.5) + 0*u;"
    expected = 1.5 * sum(at * value for at, value in enumerate(values, 1))
    output = outputs(body(DEEP + columns), tmp_path)
    np.testing.assert_allclose(output, expected)
    number = evaluate(text, {"A": np.arange(1.0, 9).reshape(2, 2, 2, order="F"), "B": np.array([[1.0, 2], [3, 4]])})
    assert number.ravel(order="F").astype(float) == pytest.approx(values)


def test_a_slice_is_assigned_in_its_own_size(tmp_path):
    code = "A = zeros(2, 2, 2);\nA(:, :, 2) = [u v; 1 2];\ny = A(1, 1, 2) + 10*A(1, 2, 2) + 100*A(2, 1, 2);"
    np.testing.assert_allclose(outputs(body(code), tmp_path), U + 10 * V + 100)
    with pytest.raises(InputError, match="values of size 2 x 3 cannot be assigned to a part of size 3 x 2"):
        imported(function(body("A = zeros(3, 3);\nA(:, 1:2) = [1 2 3; u 5 6];\ny = A(1);")), tmp_path)
    with pytest.raises(InputError, match="cannot be transposed"):
        imported(function(body("A = zeros(2, 2, 2);\nB = A';\ny = B(1) + u;")), tmp_path)


# bits in the class of their numbers

BITS = [
    ("bitand(int8(x), int8(-39))", [-104, -39, 0, 64]),
    ("bitor(int8(x), int8(91))", [-33, -1, 91, 127]),
    ("bitshift(int8(x), 2)", [112, -4, 0, -112]),
    ("bitshift(int8(x), -2)", [-25, -1, 0, 25]),
    ("bitshift(uint8(x), 2)", [0, 0, 0, 144]),
    ("bitcmp(int8(x))", [99, 0, -1, -101]),
    ("bitcmp(uint8(x + 200))", [155, 56, 55, 0]),
    ("bitset(int8(x), 8)", [-100, -1, -128, -28]),
    ("bitget(int8(x), 8)", [1, 1, 0, 0]),
    ("bitand(uint8(3*x), 255)", [0, 0, 0, 255]),
    ("bitand(uint8(x/3), 255)", [0, 0, 0, 33]),
    ("bitshift(cast(x, 'int8'), 2)", [112, -4, 0, -112]),
    ("bitand(int8(x) + 100, 127)", [0, 99, 100, 127]),
]


@pytest.mark.parametrize(("text", "values"), BITS)
def test_bits_are_those_of_the_class_of_a_number(text, values, tmp_path):
    x = np.array([-100.0, -1.0, 0.0, 100.0])
    output = outputs(body(f"x = u;\nz = {text};\ny = double(z) + 0*v;"), tmp_path, u=x, v=0 * x)
    assert output.tolist() == values
    assert [float(evaluate(text, {"x": one})[0, 0]) for one in x] == values


def test_a_class_is_kept_by_indices_decisions_and_memories(tmp_path):
    code = (
        "persistent k\nif isempty(k)\n  k = uint8(100);\nend\n"
        "w = [int8(u) int8(v)];\nif u > 0\n  z = w(1);\nelse\n  z = w(2);\nend\n"
        "a = zeros(1, 2, 'uint8');\na(2) = u;\nk = bitshift(k, 1);\n"
        "y = double(bitshift(z, 1)) + 1000*double(k) + 1e6*double(bitshift(a(2), 1));"
    )
    u, v = np.array([100.0, -5.0, 3.0]), np.array([1.0, 127.0, 2.0])
    z, k, a = np.array([-56.0, -2.0, 6.0]), np.array([200.0, 144.0, 32.0]), np.array([200.0, 0.0, 6.0])
    np.testing.assert_allclose(outputs(body(code), tmp_path, u=u, v=v), z + 1000 * k + 1e6 * a)


def test_an_input_has_the_integer_type_of_its_signal_or_of_the_port(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", OutDataTypeStr="uint8")
    drawn.function("F", "function y = f(u)\ny = double(bitshift(u, 1));\nend\n", ("u",), ("y",))
    drawn.outport("y")
    drawn.chain("u", "F", "y")
    result = import_simulink(drawn.write(tmp_path))
    assert run(result.model, {"u": [200.0, 3.0]})["y"].tolist() == [144.0, 6.0]
    assert not any("bitshift" in str(one) for one in result.report.remarks)


def test_possible_effects_of_an_unknown_class_are_reported(tmp_path):
    shifted = import_simulink(function(body("y = bitshift(u, 2) + v;")).write(tmp_path)).report
    assert any("F calls a bit function: bitshift keeps the bits" in str(one) for one in shifted.notes)
    lower = import_simulink(function(body("y = bitshift(u, -2) + v;")).write(tmp_path)).report
    assert lower.notes == ()
    cast = import_simulink(function(body("y = double(int8(u)) + v;")).write(tmp_path)).report
    assert any(str(one).startswith("integer types are ignored in F") for one in cast.notes)
    with pytest.raises(InputError, match="bitcmp: its argument must be of an integer class"):
        imported(function(body("y = bitcmp(u) + v;")), tmp_path)


# values of the workspace, texts

WORKSPACE = [("numel(w)", 3.0), ("w(2)", 5.0), ("sum(w)", 12.0), ("size(w, 2)", 3.0), ("max(w)*2", 10.0),
             ("length(w') + w(end)", 6.0)]  # fmt: skip


@pytest.mark.parametrize(("text", "value"), WORKSPACE)
def test_an_array_of_the_workspace_is_taken_as_it_is(text, value, tmp_path):
    output = outputs(body(f"y = {text} + 0*u;"), tmp_path, parameters=[{"w": np.array([[4.0, 5.0, 3.0]])}])
    np.testing.assert_allclose(output, value)


TEXTS = [
    ("isstring('abc') + 10*ischar('abc')", 10.0),
    ('isstring("abc") + 10*ischar("abc") + 100*numel("abc") + 1000*isempty("")', 101.0),
    ("isequal({1, 2}, [2 1]) + 10*isequal([1 2], {1, 2}) + 100*isequal({1, 2}, {1, 2})", 100.0),
    ("isequal('a', 97) + 10*isequal('', []) + 100*isequal(\"a\", 'a') + 1000*isequal(\"a\", 97)", 111.0),
    ("sum(size(cell([1 2 3])).*[1 10 100]) + 1000*numel(cell(2, 3))", 6321.0),
    ("ismember('b', {'a', 'b'}) + 10*sum(ismember('abc', 97))", 11.0),
]


@pytest.mark.parametrize(("text", "value"), TEXTS)
def test_texts_strings_and_cells_are_distinguished(text, value, tmp_path):
    np.testing.assert_allclose(outputs(body(f"y = {text} + 0*u;"), tmp_path), value)


def test_an_extreme_passes_a_missing_value_on_with_its_place(tmp_path):
    code = "[m, i] = max([u 0 v]);\n[l, k] = min([v u]);\ny = 1000*m + 100*i + 10*k + isnan(l);\n"
    u, v = np.array([1.0, np.nan, 1.0, -2.0]), np.array([2.0, 2.0, np.nan, -3.0])
    output = outputs(body(code), tmp_path, u=u, v=v)
    np.testing.assert_array_equal(output, [2320.0, np.nan, np.nan, 210.0])
    places = outputs(body("[~, i] = max([u 0 v]);\ny = i;"), tmp_path, u=u, v=v)
    assert places.tolist() == [3.0, 1.0, 3.0, 2.0]


@pytest.mark.parametrize(("text", "shape"), [("diff(zeros(3, 0))", [2, 0]), ("diff(zeros(1, 0))", [1, 0])])
def test_differences_of_nothing_are_as_empty(text, shape, tmp_path):
    output = outputs(body(f"y = size({text}, 1) + 10*size({text}, 2) + 0*u;"), tmp_path)
    assert output[0] == shape[0] + 10 * shape[1]
    assert list(evaluate(text).shape) == shape

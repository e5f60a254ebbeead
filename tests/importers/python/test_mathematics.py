"""Functions and operators of Python on numbers at which they raise exceptions, round, or come near to an integer."""

import math

import numpy as np
import pytest

from kennfeld.importers.python.mathematics import library_name
from tests.importers.python.translated_functions import computed, translated

COMMON = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 1.5, 2.5, -2.5, 1e-10, 0.3, 7.3, -7.3, 1e-300, math.nextafter(0.5, 0)]
LARGE = [710.0, -750.0, 1e200, -1e200, math.inf, -math.inf, 2.0**52 + 1, 2.0**53 - 1, -(2.0**52) - 1]
NUMBERS = np.array([*COMMON, *LARGE, math.nan])
HEAD = "import math\nimport numpy as np\n"
ONE = [
    "log", "log10", "log2", "log1p", "exp", "exp2", "expm1", "sinh", "cosh", "sqrt", "sin", "acos", "acosh", "asinh",
    "atanh", "cbrt", "floor", "ceil", "trunc", "degrees", "radians", "isnan", "isfinite",
]  # fmt: skip


@pytest.mark.parametrize("name", ONE)
def test_functions_of_math_are_nan_where_python_raises_an_exception(name, tmp_path):
    text = f"{HEAD}def f(x):\n    return math.{name}(x)\n"
    values = translated(text, tmp_path, {"x": NUMBERS})
    np.testing.assert_allclose(values, computed(text, {"x": NUMBERS}), rtol=4e-15)


@pytest.mark.parametrize("name", ["log", "exp", "log1p", "arctanh", "rint", "round", "deg2rad", "arcsinh"])
def test_functions_of_numpy_answer_by_infinities(name, tmp_path):
    text = f"{HEAD}def f(x):\n    return np.{name}(x)\n"
    values = translated(text, tmp_path, {"x": NUMBERS})
    np.testing.assert_allclose(values, computed(text, {"x": NUMBERS}), rtol=4e-15)


@pytest.mark.parametrize(
    "expression",
    [
        "a / b", "a // b", "a % b", "a ** b", "2.0 ** a", "a ** -1", "math.pow(a, b)", "math.fmod(a, b)", "min(a, b)",
        "max(a, b)", "np.minimum(a, b)", "np.maximum(a, b)", "np.fmin(a, b)", "math.copysign(a, b)", "math.hypot(a, b)",
        "math.log(a, b)", "np.floor_divide(a, b)", "np.mod(a, b)", "np.sin(a) / b", "np.clip(a, -1, b)", "pow(a, 3)",
        "min(a, b, 1)", "int(a) + b", "math.atan2(a, b)",
    ],
)  # fmt: skip
def test_operators_and_functions_of_two_numbers_are_those_of_python(expression, tmp_path):
    tenths = np.arange(-20, 21) / 10
    small = NUMBERS[np.abs(NUMBERS) < 1e3]  # beyond 2^53, no double tells the last digit of a quotient
    a, b = (each.ravel() for each in np.meshgrid([*tenths, *small, math.inf, math.nan], [*tenths, *small, 1e-3]))
    text = f"{HEAD}def f(a, b):\n    return {expression}\n"
    keep = ~(np.abs(a) >= 2.0**52 * np.abs(b)) | (b == 0) | np.isinf(a)
    columns = {"a": a[keep], "b": b[keep]}
    np.testing.assert_allclose(translated(text, tmp_path, columns), computed(text, columns), rtol=4e-15)


def test_quotients_that_are_nearly_whole_are_not_rounded_up(tmp_path):
    a, b = np.array([1.0, 0.3, -1.0, 4.2]), np.array([0.1, 0.1, 0.1, -0.7])
    text = "def f(a, b):\n    return a // b\n"
    assert translated(text, tmp_path, {"a": a, "b": b}).tolist() == [9.0, 2.0, -10.0, -7.0]
    assert translated("def f(a, b):\n    return a % b\n", tmp_path, {"a": a, "b": b})[0] == 1.0 % 0.1


@pytest.mark.parametrize("digits", [0, 1, 2, 5, -1, -2])
@pytest.mark.parametrize("call", ["round(x, {})", "np.round(x, {})"])
def test_halves_are_rounded_as_python_and_numpy_do(call, digits, tmp_path):
    rng = np.random.default_rng(digits + 10)
    halves = rng.integers(-5000, 5000, 300) / 2 * 10.0**-digits
    x = [*halves, *np.nextafter(halves, math.inf), *rng.normal(0, 100, 100), 2.675, 1.005, 0.5, 1.5, math.inf, math.nan]
    text = f"import numpy as np\ndef f(x):\n    return {call.format(digits)}\n"
    np.testing.assert_array_equal(translated(text, tmp_path, {"x": x}), computed(text, {"x": x}))


def test_a_function_of_another_number_of_arguments_is_none_of_the_library():
    assert library_name("math", "log", 1) == "py:log"
    assert not library_name("math", "log", 2)
    assert not library_name("math", "rint", 1)
    assert not library_name("os", "abs", 1)

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


LOST = {
    "a value that is not used": "x = 1 / b\n    return a",
    "a comparison": "if math.log(b) > a:\n        return 1\n    return 2",
    "a maximum": "return max(math.sqrt(a), math.exp(800 * b), 1)",
    "a power of 0": "return int(a) ** int(b) + math.floor(a) ** 0 + (math.asin(a) * math.cos(b)) ** 0",
    "a test": "return math.isnan(math.fmod(a, b)) + math.isnan(a ** b)",
    "one side of a decision": "x = 0\n    if b > 0:\n        x = math.acosh(a)\n    return b if x == x else a % b",
    "a condition before it": "return a if b == 0 or a / b > 1 else b",
    "a pass of a loop": """
    total = 0
    while total < 3:
        if total > b:
            break
        total += 1
        y = 1 / (total - a)
    return total""",
    "a function": "def g(x):\n        y = 1 // x\n        return x\n    return b + g(a)",
    "an element that is not chosen": "return [a, 1 / b][0] + [b, 1 % a, a][2:][0]",
    "an index": "x = [1, 2][int(a)]\n    return b",
    "elements that are not used": "return len([1 / a]) + sum([b for _ in [math.atanh(b)]])",
    "a logarithm": "x = math.log(a, b)\n    return b",
}


@pytest.mark.parametrize("name", LOST)
def test_an_exception_makes_the_result_nan_though_its_value_is_lost(name, tmp_path):
    # 1e-300 leaves remainders of which no digit is known
    numbers = [*np.arange(-6, 7) / 4, *(x for x in COMMON if x != 1e-300), math.inf, -math.inf, math.nan]
    a, b = (each.ravel() for each in np.meshgrid(numbers, numbers))
    body = LOST[name] if LOST[name].startswith("\n") else f"\n    {LOST[name]}"
    text, columns = f"{HEAD}def f(a, b):{body}\n", {"a": a, "b": b}
    expected = computed(text, columns)
    assert 0 < np.isnan(expected).sum() < expected.size
    np.testing.assert_allclose(translated(text, tmp_path, columns), expected, rtol=1e-14)


@pytest.mark.parametrize("call", ["1e18 % b", "a // b", "np.mod(a, b)", "math.fmod(a, b)"])
def test_a_remainder_that_is_not_known_is_not_lost_in_a_maximum(call, tmp_path):
    text, columns = f"{HEAD}def f(a, b):\n    return max(0.5, {call})\n", {"a": [1e18, 7.0], "b": [0.3, 4e18]}
    values = translated(text, tmp_path, columns)
    assert np.isnan(values[0])
    assert values[1] == computed(text, columns)[1]


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

"""Translation of Python functions with lists, closures and tables, against Python itself."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.models.function_files import read_function_file
from tests.importers.python.translated_functions import computed, translated

HEAD = """\
import math
from dataclasses import dataclass

import numpy as np

X = [-1.0, 1.0, 2.5, 4.0]
Y = (1.0, -3.0, 2.0, 0.5)
Z = np.array([-1.0, 0.0, 3.0, 7.0])
CHANGED = [1.0, 2.0]
T = ((1, -2, 3), (4.5, 0, -6))
LARGE = 36028797018963971


@dataclass
class Calibration:
    factor: float = 1.5
    shift: float = -0.5
    changed: float = 1.0


class Limits:
    LEAST = -2
    MOST = 3.5


CAL = Calibration(shift=2)
OTHER = Calibration(0.25)
OTHER.changed = 3.0


def limited(x, least=Limits.LEAST, *, most=1.0):
    if least > most:
        raise ValueError(f"limits {least:.2f} and {most!r}")
    return max(least, min(x, most))


def place(x):
    for i, limit in enumerate(X):
        if x < limit:
            break
        if x == 2.5:
            continue
    else:
        i = len(X)
    k = 3
    while k > 0:
        k -= 1
        if k < x:
            break
    else:
        i += 10
    return i


def amplifier(k, offset):
    half = k / 2

    def amplified(k):
        return half * k + offset

    return amplified


gain = amplifier(3.0, 1.5)


def doubler(k):
    return lambda x: 2 * k * x


double = doubler(1.0)


def horner(coefficients, x):
    y = 0.0
    for c in coefficients:
        y = y * x + c
    return y


def sum_and_difference(a, b=2.0):
    return a + b, a - b


def changing(values):
    values[0] = 3.0
    return values[0]


def grow():
    CHANGED.append(1.0)


"""
CASES = {
    "a table between breakpoints": "return np.interp(a, X, Y)",
    "a table with ends": "return np.interp(a, [0, 1, 2], [b, 2, 3], left=-1, right=b) + np.interp(b, Z, X, -5, 5)",
    "polynomials": "return np.polyval([1, a, -2.5], b) + np.polyval(X, a)",
    "functions that functions return": "return gain(a) - double(gain(b))",
    "names around": """
    k = 2 * a
    def g(y):
        return k * y + h(y)
    def h(z, w=3):
        return k - z + w
    k = k + 1
    scaled = lambda x: x * k
    return g(b) + g(1) + scaled(b)""",
    "lists": """
    v = [a, b, a * b]
    v[1] += 2
    v[-1] = v[0] - 1
    total = 0
    for i, e in enumerate(v):
        total += i * e
    return total + sum(v) + max(v) + min(v[1:]) + len(v) + v[-1]""",
    "comprehensions": """
    v = [k * a for k in range(4)]
    w = [x * y for x, y in zip(v, X)]
    return sum(w) + v[int(abs(b)) % 4] + sum(x ** 2 for x in w)""",
    "exchanges": """
    a, b = b, a
    v = [a, b]
    v = [v[1], v[0]]
    c, d = sum_and_difference(a)
    e, g = sum_and_difference(b=v[0], a=b)
    return c * d + e - g + horner(X, a) + horner([a, 1, b], 2)""",
    "a list that changes while it is read": """
    v = [a, b]
    total = 0
    for x in v:
        v[1] = 7
        total = 2 * total + x
    return total""",
    "expressions that are read once": """
    total = 0
    for x in [a, b]:
        b = 7
        total = 2 * total + x
    return total""",
    "a search for the interval": """
    i = 0
    while i < len(X) - 2 and a > X[i + 1]:
        i += 1
    return Y[i] + (a - X[i]) * (Y[i + 1] - Y[i]) / (X[i + 1] - X[i])""",
    "exceptions": """
    if a > 2 and b > 0:
        raise RuntimeError
    try_again = limited(a, most=b)
    return 1.0 if a > 0 else try_again""",
    "limits by keywords": """
    return limited(a, most=CAL.factor) + 10 * limited(b, -1, most=9) + CAL.shift + OTHER.factor + Limits.MOST""",
    "else of loops": "return place(a) + 100 * place(b)",
    "tables": "return T[1][0] * a + T[int(a) % 2][-1] + len(T) + sum(T[0]) + 0 * T[0][int(b)]",
    "places and choices": """
    x = np.searchsorted(X, a) + 10 * np.searchsorted(X, 2.5, side="right")
    return x + np.select([a < b, a < 1], [1 + a, 2 * b], default=-1) + np.interp(b, X, Y, left=-9.0) + np.sign(a)""",
    "sides that decide": """
    return (a or b) + 10 * (b and a) + (b > 1 or a) + any(x > a for x in X) + all([a < x for x in X])""",
    "numbers of numpy": """
    k = np.sqrt(abs(a)) - 1
    k = k / (b * 0)
    x = (a > 1) + (b > 1)
    return k * 0 if x > 5 else x + (np.sqrt(abs(b)) > 1) * 2""",
    "large integers that are exact": "return (2 ** 60 + 2 ** 33) % 1000 + int(a) * 4611686018427387904.0",
    "an index out of range": "return X[int(4 * a)]",
}


@pytest.mark.parametrize("name", CASES)
def test_lists_closures_and_tables_are_those_of_python(name, tmp_path):
    rng = np.random.default_rng(1)
    a, b = (np.append(rng.normal(0, 2, 100), rng.integers(-4, 8, 100) / 2) for _ in range(2))
    body = CASES[name] if CASES[name].startswith("\n") else f"\n    {CASES[name]}"
    text = f"{HEAD}def f(a, b):{body}\n"
    columns = {"a": a, "b": b}
    np.testing.assert_allclose(translated(text, tmp_path, columns), computed(text, columns), rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize(
    "body",
    [
        "v = [a]\n    w = v\n    w[0] = 2.0\n    return v[0]",  # two names for one list
        "return changing([a])",
        "return sum(CHANGED) + a",
        "v = [a]\n    v.append(b)\n    return sum(v)",
        "v = a\n    v = [a, b]\n    return v[0]",
        "return np.interp(a, [2.0, 1.0], [0.0, 1.0])",
        "return np.interp(a, [0.0, 1.0, 2.0], [0.0, 1.0])",
        "k = 0\n    def g():\n        nonlocal k\n        k = k + 1\n        return k\n    return g() + a",
        "return {0: a}[0]",
        "return OTHER.changed + a",
        "return (np.sqrt(a) > 1) + (np.sqrt(b) > 1)",
        "k = a\n    if a > 1:\n        k = np.sqrt(a)\n    return b / k",
        "k = a\n    for x in X:\n        b = b / k\n        k = np.exp(x)\n    return b",
        "return np.select([a, b], [1, 2])",
        "return round(a, int(b))",
        "return math.fsum([a, 1e16, -1e16, b])",
        "return int(a) % 9007199254740993",
        "return (2 ** 53 + 1) % 10 + int(b) % LARGE",
        "return int(a) % LARGE",
    ],
)
def test_what_a_graph_cannot_express_is_called(body, tmp_path):
    (tmp_path / "f.py").write_text(f"{HEAD}def f(a, b):\n    {body}\n")
    (remark,) = read_function_file("f.py:f", tmp_path).remarks
    assert "cannot be translated" in remark.message


@pytest.mark.parametrize(
    ("body", "line"),
    [
        ("k = 3\n    return a + int(a) * k", 2),
        ("n = math.floor(a)\n    m = n + 1\n    return max(n, m) ** 2 % 7", 3),
        ("def g(n):\n        return n * n\n    return g(round(b))", 2),
        ("return int(a) * SCALE", 1),
    ],
)
def test_integers_that_may_be_rounded_are_remarked_upon_with_their_line(body, line, tmp_path):
    text = f"import math\nSCALE = 60\n\ndef f(a, b):\n    {body}\n"
    (tmp_path / "f.py").write_text(text)
    (remark,) = read_function_file("f.py:f", tmp_path).remarks
    assert "integers beyond 2^53 are rounded" in remark.message
    assert (remark.severity, remark.location.line) == ("remark", line + 4)


@pytest.mark.parametrize(
    "body",
    [
        "n = 0\n    for k in range(20):\n        n = n + k * k\n    return n * a",
        "n = 0\n    for x in [a, b]:\n        n = 2 * n + x\n    return n",
        "return int(a) * 2.0 + int(b) % 4 * 3",
        "n = int(a) % 100\n    return n ** 3 + n * n",
        "return X[min(max(int(a), 0), 2) + 1] * 2 + int(a) + 1",
    ],
)
def test_integers_that_stay_small_draw_no_remark(body, tmp_path):
    rng = np.random.default_rng(1)
    columns = {"a": rng.normal(0, 40, 50), "b": rng.normal(0, 40, 50)}
    text = f"{HEAD}def f(a, b):\n    {body}\n"
    np.testing.assert_array_equal(translated(text, tmp_path, columns), computed(text, columns))
    assert not read_function_file("f.py:f", tmp_path).remarks


def test_a_default_that_no_double_represents_is_an_error(tmp_path):
    (tmp_path / "f.py").write_text("def f(a, n=9007199254740993):\n    return a % n\n")
    with pytest.raises(InputError, match="the default of n must be a number that a double represents"):
        read_function_file("f.py:f", tmp_path)

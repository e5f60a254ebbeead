"""Statements of MATLAB Functions: decisions, loops, jumps, functions; against the same written in Python."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.models.imperative import control_flow, evaluation_context
from tests.importers.simulink.simulink_code import U, V, body, check_slopes, function, outputs, stepwise
from tests.importers.simulink.simulink_files import LAYOUTS
from tests.importers.simulink.simulink_runs import imported, run, slopes


def first_above(u, v):
    for k in range(1, 6):
        if k * u > v:
            return k
    return -1.0


def even_only(u, v):
    y = 0.0
    for k in range(1, 7):
        if k % 2 == 1 or k * u < -1:
            continue
        if y > 4:
            break
        y += k * abs(u) + v
    return y


def newton(u, v):
    x, k = 1.0, 0
    while abs(x * x - abs(u)) > 1e-10 and k < 30:
        x, k = 0.5 * (x + abs(u) / x), k + 1
    return x + k


def early(u, v):
    if u < -0.5:
        return -1.0
    y = u * v
    if y > 0.5:
        return 2 * y
    if v > 0:
        y += 3
    return y


def nested(u, v):
    total = 0.0
    for i in range(1, 4):
        for j in range(1, 4):
            if i * j * u > v + 3:
                break
            if i == j:
                continue
            total += i + 10 * j
        if total > 60:
            break
    return total


def by_case(u, v):
    k = round(u)
    if k in (1, 2):
        return 10 + v
    if k == 0:
        return v
    return -k


def counted(u, v):
    n = min(max(np.floor(4 * abs(u)), 1), 6)
    return sum(range(1, int(n) + 1)) * v


def last_pass(u, v):
    return min(max(np.floor(4 * abs(u)), 1), 6)


def last_pass_from(u, v):
    k, last = 0, int(last_pass(u, v))
    for k in range(int(max(1, np.floor(v))), last + 1):
        if k > 3:
            break
    return k


def halved(u, v):
    n = 0
    x = abs(u) * 50
    while x > 1:
        x, n = x / 2, n + 1
        if n >= 8:
            break
    return n + x


STATEMENTS = [
    ("y = -1;\nfor k = 1:5\n if k*u > v\n  y = k; break\n end\nend", first_above),
    ("y = -1;\nfor k = 1:5\n if k*u > v\n  y = k; return;\n end\nend", first_above),
    ("y = 0;\nfor k = 1:6\n if mod(k, 2) == 1 || k*u < -1, continue; end\n if y > 4\n  break\n end\n"
     " y = y + k*abs(u) + v;\nend", even_only),
    ("x = 1; k = 0;\nwhile abs(x*x - abs(u)) > 1e-10 && k < 30\n x = 0.5*(x + abs(u)/x); k = k + 1;\nend\ny = x + k;",
     newton),
    ("if u < -0.5\n y = -1;\n return\nend\ny = u*v;\nif y > 0.5\n y = 2*y; return\nend\n"
     "if v > 0, y = y + 3; end", early),
    ("y = 0;\nfor i = 1:3\n for j = 1:3\n  if i*j*u > v + 3, break, end\n  if i == j, continue, end\n"
     "  y = y + i + 10*j;\n"
     " end\n if y > 60, break, end\nend", nested),
    ("switch round(u)\n case {1, 2}\n  y = 10 + v;\n case 0\n  y = v;\n otherwise\n  y = -round(u);\nend", by_case),
    ("n = min(max(floor(4*abs(u)), 1), 6);\ny = 0;\nfor k = 1:n\n y = y + k*v;\nend", counted),
    ("n = floor(4*abs(u));\nif n > 6, n = 6; end\nif n < 1\n n = 1;\nend\ny = 0;\nfor k = n:-1:1\n"
     " y = y + k*v;\nend", counted),
    ("k = 0;\nfor k = 1:min(max(floor(4*abs(u)), 1), 6)\nend\ny = k;", last_pass),
    ("k = 0;\nfor k = max(1, floor(v)):min(max(floor(4*abs(u)), 1), 6)\n if k > 3, break, end\nend\ny = k;",
     last_pass_from),
    ("y = 0;\nn = round(u);\nfor k = n:n + 2\n y = y + k*v;\nend\ny = y + k;", lambda u, v:
     3*v*(round(u) + 1) + round(u) + 2),
    ("y = 0;\nfor k = 3:0:5\n y = 1;\nend", lambda u, v: 0.0),
    ("n = 0; x = abs(u)*50;\nwhile x > 1\n x = x/2; n = n + 1;\n if n >= 8, break; end\nend\n"
     "y = n + x;", halved),
    ("k = 0;\nwhile k < 4\n k = k + 1;\nend\ny = k*u;", lambda u, v: 4 * u),
    ("k = 0;\nwhile true\n k = k + 1;\n if k == 3, break, end\nend\ny = k*u;", lambda u, v: 3 * u),
    ("y = 0;\nfor k = [1 4 2; 3 1 1]\n y = y + k(1)*u + k(2)*v;\nend", lambda u, v: 7 * u + 5 * v),
    ("y = 0;\nfor k = 10:-3:1\n y = y*0.5 + k*u;\nend", lambda u, v: u * (10 / 8 + 7 / 4 + 4 / 2 + 1)),
    ("y = 0;\nfor k = []\n y = 1;\nend", lambda u, v: 0.0),
    ("y = 0;\nfor k = 1:3, for j = k:3, y = y + j*u^k; end, end", lambda u, v: sum(
        j * u**k for k in range(1, 4) for j in range(k, 4))),
    ("mode = 'fast';\nswitch mode\n case {'slow', 'fast'}\n  y = u;\n case 'other'\n  y = v;\nend", lambda u, v: u),
    ("if u > 0\n a = 2;\nend\nif u > 0\n y = a*v;\nelse\n y = 1;\nend", lambda u, v: 2 * v if u > 0 else 1),
    ("if ~(u > 0)\n y = 0; return\nelse\n a = 3;\nend\ny = a*u;", lambda u, v: 3 * u if u > 0 else 0),
    ("if u > 10\n error('no such value %f', u);\nelseif u > 0\n y = u;\nelse\n y = v;\nend",
     lambda u, v: u if u > 0 else v),
    ("y = u; % a note\nassert(u < 100, 'large');\nfprintf('%f\\n', y); disp(y)\ncoder.extrinsic('plot');",
     lambda u, v: u),
    ("%#codegen\ncoder.inline('never');\ny = coder.nullcopy(zeros(1, 1)); y(1) = u + v;", lambda u, v: u + v),
    ("x = 1;\nif u ~= 0 && 1/u > 2 || v < 0\n x = 2;\nend\ny = x;",
     lambda u, v: 2 if (u and 1 / u > 2) or v < 0 else 1),
    ("a = u > 0; b = v > 0;\ny = 0;\nif xor(a, b), y = 1; end\nif ~a & ~b, y = 2; end", lambda u, v:
     1 if (u > 0) != (v > 0) else 2 if u <= 0 and v <= 0 else 0),
    ("y = (true && u) + 10*(0 || v) + 100*(u && u) + 1000*(u || u) + 10000*(u && 0);", lambda u, v:
     (u != 0) * 1101 + 10 * (v != 0)),
    ("if u > 0\n z = 1;\nend\ny = exist('z', 'var') + 10*exist('u');", lambda u, v: (u > 0) + 10),
    ("x = [u v];\nif x > 0\n y = 1;\nelse\n y = 0;\nend", lambda u, v: float(u > 0 and v > 0)),
    ("y = u;\nif []\n y = 5;\nend", lambda u, v: u),
    ("f = @(a, b) a*b + u;\ny = f(v, 2) + feval(@max, u, v);", lambda u, v: 2 * v + u + max(u, v)),
]  # fmt: skip


@pytest.mark.parametrize(("code", "rule"), STATEMENTS)
def test_statements_follow_matlab(code, rule, tmp_path):
    output = outputs(body(code), tmp_path)
    np.testing.assert_allclose(output, stepwise(rule), rtol=1e-12, atol=1e-12)


def appended(u, v):
    taken = [k for k in range(1, 9) if k * u > v]
    return sum(taken) + 10 * len(taken)


def digits(u, v):
    taken = [k for k in range(1, 6) if (u * k) % 2 < 1 or v > 1]
    return float("".join(map(str, taken)) or 0)


def filled(u, v):
    values = [u]
    while sum(values) < 3 and len(values) < 6:
        values.append(abs(v))
    return len(values) + values[-1]


SIZES = [
    ("x = u;\nif v > 0\n x = [x 2];\nend\ny = sum(x) + 10*numel(x);", lambda u, v: u + 10 + 12 * (v > 0)),
    ("if u > 0\n x = [1 v];\nelse\n x = [3; v; 5];\nend\ny = x(end)*size(x, 1);",
     lambda u, v: v if u > 0 else 15),
    ("x = [];\nfor k = 1:8\n if k*u > v\n  x(end+1) = k;\n end\nend\ny = sum(x) + 10*numel(x);", appended),
    ("x = [];\nfor k = 1:5\n if mod(u*k, 2) < 1 || v > 1\n  x = [x k];\n end\nend\ny = 0;\n"
     "for k = 1:numel(x)\n y = 10*y + x(k);\nend", digits),
    ("x = u;\nwhile sum(x) < 3 && numel(x) < 6\n x = [x abs(v)];\nend\ny = numel(x) + x(end);", filled),
    ("x = [];\nif u > 0\n x = v;\nend\nif isempty(x)\n y = -1;\n return\nend\ny = x;",
     lambda u, v: v if u > 0 else -1),
    ("s.x = 1;\nif u > 0\n s.x = [1 v];\nend\ny = sum(s.x) + numel([s.x s.x]);",
     lambda u, v: 5 + v if u > 0 else 3),
    ("a = 1; b = 2;\nif u > 0\n a = [1 v];\nend\nif v > 0\n b = [2 u 1];\nend\nc = [a b];\ny = c(2)*numel(c);",
     lambda u, v: (v if u > 0 else 2) * (2 + (u > 0) + 2 * (v > 0))),
    ("x = g(u, v);\ny = sum(x)*numel(x);\nend\nfunction x = g(u, v)\nswitch round(u)\n case 0\n  x = v;\n case 1\n"
     "  x = [v 1];\n otherwise\n  x = zeros(1, 0);\nend\n", lambda u, v: {0: v, 1: 2 * (v + 1)}.get(round(u), 0)),
]  # fmt: skip


@pytest.mark.parametrize(("code", "rule"), SIZES)
def test_the_size_of_an_array_may_depend_on_decisions(code, rule, tmp_path):
    text = f"function y = f(u, v)\n{code}" if "function" in code else body(code)
    np.testing.assert_allclose(outputs(text, tmp_path), stepwise(rule), rtol=1e-12, atol=1e-12)


FUNCTIONS = [
    ("function y = f(u, v)\n[a, b] = polar(u, v);\ny = a + 10*b;\nend\nfunction [r, p] = polar(x, y)\n"
     "r = hypot(x, y);\n"
     "p = atan2(y, x);\nend\n", lambda u, v: np.hypot(u, v) + 10 * np.arctan2(v, u)),
    ("function y = f(u, v)\n[~, y] = two(u, v);\nend\nfunction [a, b] = two(u, v)\na = u; b = u - v;\nend\n",
     lambda u, v: u - v),
    ("function y = f(u, v)\ny = with(u) + with(u, v);\nend\nfunction y = with(a, b)\nif nargin < 2\n b = 7;\nend\n"
     "y = a*b;\nend\n", lambda u, v: 7 * u + u * v),
    ("function y = f(u, v)\ny = g(h(u), h(v));\n\nfunction z = g(a, b)\nz = a - b;\n\nfunction z = h(a)\nif a < 0\n"
     " z = 0;\n return\nend\nz = sqrt(a);\n", lambda u, v: (u > 0) * abs(u) ** 0.5 - (v > 0) * abs(v) ** 0.5),
    ("function y = f(u, v)\ny = 0;\nfor k = 1:3\n y = y + g(u, k);\nend\nend\nfunction z = g(a, k)\nz = 0;\n"
     "for i = 1:k\n if a > 0, break, end\n z = z + a;\nend\nend\n", lambda u, v: 6 * u if u <= 0 else 0),
    ("function y = f(u, v)\nif u > 0\n y = g(u);\nelse\n y = 1;\nend\nend\nfunction y = g(a)\nif a < 0\n"
     " error('neg');\n"
     "end\ny = a;\nend\n", lambda u, v: u if u > 0 else 1),
    ("function y = f(u, v)\ny = g(u, v);\nend\nfunction y = g(varargin)\ny = 0;\nfor k = 1:nargin\n"
     " y = y + k*varargin{k};\nend\nend\n", lambda u, v: u + 2 * v),
]  # fmt: skip


@pytest.mark.parametrize(("code", "rule"), FUNCTIONS)
def test_local_functions(code, rule, tmp_path):
    np.testing.assert_allclose(outputs(code, tmp_path), stepwise(rule), rtol=1e-12, atol=1e-14)


def test_functions_in_files_beside_the_model_and_in_folders(tmp_path):
    folder = tmp_path / "lib"
    folder.mkdir()
    (tmp_path / "twice.m").write_text(
        "function y = twice(x)\ny = helper(x);\nend\nfunction y = helper(x)\ny = 2*x;\nend\n"
    )
    (folder / "thrice.m").write_text(
        "function y = other_name(x)\ny = helper(x);\nend\nfunction y = helper(x)\ny = 3*x;\n"
    )
    code = body("y = twice(u) + thrice(v) + helper(u);") + "function y = helper(x)\ny = 100*x;\nend\n"
    output = outputs(code, tmp_path, folders=[folder])
    np.testing.assert_allclose(output, 102 * U + 3 * V)
    output = outputs(code, tmp_path, parameters=[folder / "thrice.m"])
    np.testing.assert_allclose(output, 102 * U + 3 * V)


def test_a_block_whose_function_is_called_like_the_file_that_it_calls(tmp_path):
    (tmp_path / "twice.m").write_text("function y = twice(x)\ny = 2*x;\n")
    np.testing.assert_allclose(outputs("function y = twice(u, v)\ny = twice(u);\n", tmp_path), 2 * U)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_several_results_in_every_layout(layout, tmp_path):
    code = "function [a, b] = f(u, v)\nb = 0;\nfor k = 1:3\n if u > k, b = k; end\nend\na = u + v;\nend\n"
    recorded = run(imported(function(code, outputs=("a", "b")), tmp_path, layout), {"u": 3 * U, "v": V})
    np.testing.assert_allclose(recorded["a1"], 3 * U + V)
    np.testing.assert_allclose(recorded["b2"], np.clip(np.ceil(3 * U) - 1, 0, 3))


LIVE = [
    "if u > 0\n y = K*u;\nelse\n y = K^2*v;\nend",
    "y = u;\nfor k = 1:3\n y = y*K + sin(v*K);\n if y > 2, break, end\nend",
    "x = 1;\nk = 0;\nwhile abs(x - K) > 1e-3 && k < 5\n x = x - 0.5*(x*x - K*abs(u) - 1)/x; k = k + 1;\nend\ny = x;",
    "x = [u K; v 2];\nz = x(2:end, :)*[K; u];\ny = z + max([K*u, v]);",
    "p.gain = K; p.offset = 2*K;\ny = g(p, u);\nend\nfunction y = g(p, x)\ny = p.gain*x + p.offset^2;",
]


@pytest.mark.parametrize("code", LIVE)
def test_parameters_in_code_stay_exact(code, tmp_path):
    text = f"function y = f(u, v, K)\n{code}\nend\n"
    check_slopes(text, tmp_path, "K", 1.3)


def test_parameters_that_are_vectors_and_structs(tmp_path):
    code = "function y = f(u, v, T, p)\ny = 0;\nfor k = 1:numel(T)\n y = y + T(k)*u^(k - 1);\nend\n"
    code += "y = y*p.gain + p.more.b;\n"
    values = {"T": np.array([1.0, -2.0, 0.5]), "p": {"gain": 3.0, "more": {"b": 4.0}, "unused": 1.0}}
    model = imported(function(code), tmp_path, parameters=[values])
    assert set(model.values) == {"T", "p.gain", "p.more.b"}
    np.testing.assert_allclose(run(model, {"u": U, "v": V})["y1"], 3 * (1 - 2 * U + 0.5 * U**2) + 4)
    for name in model.values:
        exact, near = slopes(model, {"u": U, "v": V}, name, "y1")
        np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-7)


def test_a_parameter_as_number_of_passes_is_fixed_with_a_remark(tmp_path):
    from kennfeld.importers.simulink.importing import import_simulink

    code = "function y = f(u, v, N)\ny = 0;\nfor k = 1:N\n y = y + N*u;\nend\n"
    path = function(code).write(tmp_path)
    result = import_simulink(path, parameters=[{"N": 3.0}])
    np.testing.assert_allclose(run(result.model, {"u": U, "v": V})["y1"], 9 * U)
    assert any("loop" in text for text in result.report.frozen)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("if u > 0\n y = 1;\nend", "does not assign y in every case"),
        ("if u > 0\n a = 1;\nend\ny = a;", "line 5: a is not assigned in every case"),
        (
            "y = 0;\nwhile y < u\n y = y + 0.1;\nend",
            "line 3: .*no fixed end within 1000 passes.*Limit the number of passes",
        ),
        ("y = 0;\nfor k = 1:u\n y = y + k;\nend", r"line 3: .*has no bound.*min\(\.\.\., N\)"),
        ("y = 0;\nfor i = 1:1000\n for k = 1:1000\n  y = y + u;\n end\nend", "unrolls to more than 3000 statements"),
        ("x = zeros(1000, 1000);\ny = u;", "line 2: .*array of 1e\\+06 elements"),
        ("x = zeros(1e200, 1e200);\ny = u;", "line 2: .*array of inf elements"),
        ("y = f(u, v);", "unknown function or variable f"),
        ("x = ones(130, 130);\ny = sum(sum(x*x));", r"line 3: .*array of 2\.197e\+06 elements"),
        ("x = (1:6000) + (1:6000)';\ny = x(1);", r"line 2: .*array of 3\.6e\+07 elements"),
        ("while true\n y = u;\nend", "unrolls to more than 3000 statements"),
        ("y = g(u);\nend\nfunction y = g(x)\ny = g(x - 1);", "g calls itself"),
        ("y = g(u);\nfunction y = g(x)\ny = x;\nend\n", "line 3, .*nested functions are not supported.*Move it behind"),
        ("y = 3i*u;", "complex numbers are not supported"),
        ("y = u + 2*j;", "complex numbers are not supported"),
        ("x = [1 2 3];\nx(2) = [];\ny = x(1)*u;", "line 3: deleting elements"),
        ("x = [1 2 3];\ny = x(4)*u;", "line 3: index 4 of x exceeds its size 1x3"),
        ("x = [1 2 3];\ny = x(0)*u;", "index 0 of x exceeds"),
        ("x = [1 2; 3 4];\nx(3, round(u)) = 7;\ny = x(1);", "line 3: index 3 of the target of an assignment exceeds"),
        ("x = [];\nx(round(u)) = 7;\ny = 1;", "line 3: index 1 of the target of an assignment exceeds"),
        ("x = [1 2];\ny = x*[1 2 3];", "cannot be multiplied"),
        ("x = [1 2] + [1 2 3];\ny = x(1);", "are not compatible"),
        (
            "if u > 0\n x = [1 2];\nelse\n x = 3;\nend\ny = x;",
            "the size of y depends on a condition \\(1x2 or 1x1\\)",
        ),
        (
            "y = sum(g(u));\nend\nfunction x = g(u)\nx = u;\nif u > 0\n x = [1 2];\nend",
            "line 2: the size of x depends on a condition \\(1x2 or 1x1\\)",
        ),
        ("try\n y = u;\ncatch\n y = v;\nend", "not supported .try"),
        ("s.a = u;\ny = s.b;", "s has no field b; it has a"),
        ("y = 'text';", "neither numeric nor a struct"),
        (
            "[a, b] = size(u)(1);\ny = a;",
            "line 2: several results are assigned from a value that is not a function call",
        ),
        ("error('always');\ny = u;", "ends in an error on every path"),
        ("y = rand + u;", "unknown function or variable rand"),
        ("x = u(1, 2, 3);\ny = x;", "exceeds its size"),
        ("y = sqrt();", "sqrt takes 1 arguments, got 0"),
        ("[a, b] = sin(u);\ny = a;", "sin returns 1 results, but 2 are assigned"),
    ],
)
def test_refused_code_is_reported_with_its_line(code, message, tmp_path, monkeypatch):
    for module in (control_flow, evaluation_context):
        monkeypatch.setattr(module, "MAX_STATEMENTS", 3000)
    with pytest.raises(InputError, match=message):
        imported(function(body(code)), tmp_path)


def test_sums_of_sums_are_looked_through_once(tmp_path):
    doubling = "x = min(max(u, 0), 1);\nb = u > 0;\nc = v > 0;\n"
    doubling += "for k = 1:60\n x = x + x;\n [b, c] = deal(b & c | b, b | c & b);\nend\ny = 0;\n"
    doubling += "if b && c, y = 1; end\nfor k = 1:min(floor(x/2^59), 2)\n y = y + k;\nend"
    output = outputs(body(doubling), tmp_path)
    count = np.minimum(np.floor(2 * np.clip(U, 0, 1)), 2)
    np.testing.assert_allclose(output, count * (count + 1) / 2 + (U > 0) * ((V > 0) | (U > 0)))

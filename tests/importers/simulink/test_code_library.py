"""Functions, arrays and indices in MATLAB Functions, against numpy."""

import math
from operator import and_, or_, xor

import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from tests.importers.simulink.simulink_code import U, body, check_slopes, function, outputs, stepwise
from tests.importers.simulink.simulink_runs import imported, slopes

ARRAYS = "x = [u; v; u - v; 2; -0.3];\nr = x';\nA = [u 2 v; 1 v 3; 0.5 -1 u + 2];\nw = [3; 1; 2; -4; 0.5];\n"


def arrays(u, v):
    x = np.array([u, v, u - v, 2, -0.3])
    matrix = np.array([[u, 2, v], [1, v, 3], [0.5, -1, u + 2]])
    return x, matrix, np.array([3, 1, 2, -4, 0.5])


def place_above(u, v, otherwise, which=0):
    """The first or last place of an element above 2, counted from 1."""
    places = np.flatnonzero(arrays(u, v)[0] > 2) + 1
    return places[which] if places.size else otherwise


def wrapped(x):
    return x if abs(x) <= math.pi else math.remainder(x, 2 * math.pi)


NUMBERS = [
    ("sum(x)", lambda x, A, w: x.sum()),
    ("sum(r) + sum(A, 2)' * [1; 2; 3]", lambda x, A, w: x.sum() + A.sum(1) @ [1, 2, 3]),
    ("sum(A) * [1; 2; 3]", lambda x, A, w: A.sum(0) @ [1, 2, 3]),
    ("sum(A(:)) + sum(A, 'all')", lambda x, A, w: 2 * A.sum()),
    ("sum(r, 'double') + sum(A, 2, 'native')'*[1; 2; 3] + any(A > 9, 'all')", lambda x, A, w: x.sum()
     + A.sum(1) @ [1, 2, 3] + (A > 9).any()),
    ("w(2.5) + w(1.4) + 10*w(round(abs(u)/10) + 1.5)", lambda x, A, w: 2 + 3 + 10 * 1),
    ("sum(size(conv(2, [1; 2; 3])).*[1 10]) + sum(size(conv([1; 2], [1 2 3])).*[1 10])", lambda x, A, w: 13 + 41),
    ("isequal(struct('a', u), struct('b', u)) + 10*isequal(struct('a', u, 'b', {{1}}), struct('b', {{1}}, 'a', u))"
     " + 100*isequal({u, 't'}, {u, 't'}) + 1000*isequal({u, 't'}, {u, 's'})", lambda x, A, w: 110),
    ("prod(x) + prod(A(1, :))", lambda x, A, w: x.prod() + A[0].prod()),
    ("dot(cumsum(x), w) + [1 2 3]*cumprod(A(:, 3))", lambda x, A, w: x.cumsum() @ w + A[:, 2].cumprod() @ [1, 2, 3]),
    ("mean(x) + 10*mean(A(2, :)) + mean(mean(A))", lambda x, A, w: x.mean() + 10 * A[1].mean() + A.mean()),
    ("var(x) + std(x, 1) + rms(x)", lambda x, A, w: x.var(ddof=1) + x.std() + np.sqrt((x**2).mean())),
    ("max(x) - 3*min(r)", lambda x, A, w: x.max() - 3 * x.min()),
    ("max(A) * [1; 2; 3] + sum(min(A, [], 2))", lambda x, A, w: A.max(0) @ [1, 2, 3] + A.min(1).sum()),
    ("sum(max(x, w)) + sum(min(x, 1))", lambda x, A, w: np.maximum(x, w).sum() + np.minimum(x, 1).sum()),
    ("any(x > 1) + 2*all(x > -2) + 4*any(A(:) > 3)", lambda x, A, w: any(x > 1) + 2 * all(x > -2) + 4 * (A > 3).any()),
    ("nnz(x > 0) + sum(x > w)", lambda x, A, w: (x > 0).sum() + (x > w).sum()),
    ("diff(x)' * [1; 2; 3; 4] + sum(diff(x, 2))", lambda x, A, w: np.diff(x) @ [1, 2, 3, 4] + np.diff(x, 2).sum()),
    ("median(x) + median(x(1:4))", lambda x, A, w: np.median(x) + np.median(x[:4])),
    ("sort(x)' * (1:5)' + sort(r, 'descend')*w", lambda x, A, w: np.sort(x) @ [1, 2, 3, 4, 5] + np.sort(x)[::-1] @ w),
    ("trapz(x) + trapz(1:2:9, r)", lambda x, A, w: 3 * np.trapezoid(x)),
    ("dot(x, w) + sum(cross(A(1, :), A(2, :)))", lambda x, A, w: x @ w + np.cross(A[0], A[1]).sum()),
    ("norm(x) + norm(x, 1) + norm(x, inf) + norm(A, 'fro') + norm(A, 1)", lambda x, A, w: np.linalg.norm(x)
     + np.abs(x).sum() + np.abs(x).max() + np.linalg.norm(A) + np.abs(A).sum(0).max()),
    ("trace(A) + det(A)", lambda x, A, w: np.trace(A) + np.linalg.det(A)),
    ("sum(A \\ [1; 2; 3])", lambda x, A, w: np.linalg.solve(A, [1, 2, 3]).sum()),
    ("([1 2 3] / A) * [1; -1; 2]", lambda x, A, w: np.linalg.solve(A.T, [1, 2, 3]) @ [1, -1, 2]),
    ("sum(sum(inv(A) .* A))", lambda x, A, w: (np.linalg.inv(A) * A).sum()),
    ("[1 2]*inv([A(1, 1) 2; 3 4])*[1; 1]", lambda x, A, w: np.array([1, 2]) @ np.linalg.inv([[A[0, 0], 2], [3, 4]])
     @ [1, 1]),
    ("sum(sum(A^3)) + sum(sum(A^0))", lambda x, A, w: np.linalg.matrix_power(A, 3).sum() + 3),
    ("sum(sum(A'*A - A.*A))", lambda x, A, w: (A.T @ A - A * A).sum()),
    ("sum(sum(kron([1 2], A)))", lambda x, A, w: 3 * A.sum()),
    ("w' * x(5:-1:1) + x(end)*x(end - 1)", lambda x, A, w: w @ x[::-1] + x[-1] * x[-2]),
    ("A(2, 3) + A(4) + sum(A(2:end, 1)) + sum(A(end, :)) + A(end)", lambda x, A, w: A[1, 2] + A[0, 1] + A[1:, 0].sum()
     + A[2].sum() + A[2, 2]),
    ("sum(x([1 3 3])) + sum(x(logical([1 0 0 1 0]))) + sum(w(w > 1))", lambda x, A, w: x[0] + 2 * x[2] + x[0] + x[3]
     + 5),
    ("numel(A) + length(r) + size(A, 1) + sum(size(r)) + ndims(A) + isempty([]) + isempty(x)", lambda x, A, w: 26),
    ("sum(reshape(1:6, 2, 3) * [1; 10; 100]) + sum(reshape(x(1:4), [], 2) * [1; 2])", lambda x, A, w:
     (1 + 2) + 10 * (3 + 4) + 100 * (5 + 6) + x[0] + x[1] + 2 * (x[2] + x[3])),
    ("sum(size(repmat([u v], [3 1 2])).*[1 10 100]) + sum(size(repmat(reshape(1:8, 2, 2, 2), 3, 1)).*[1e3 1e4 1e5])",
     lambda x, A, w: 223 + 226000),
    ("reshape(repmat([u v; 1 2], [1 1 2]), 1, 8)*(1:8)'", lambda x, A, w: np.array([x[0], 1, x[1], 2] * 2)
     @ np.arange(1, 9)),
    ("[1 10]*squeeze(reshape(1:6, 1, 2, 3))*[1; 2; 3] + sum(size(squeeze(reshape(1:3, 1, 1, 3))).*[100 1000])",
     lambda x, A, w: np.array([1, 10]) @ np.array([[1, 3, 5], [2, 4, 6]]) @ [1, 2, 3] + 1300),
    ("isreal(u > 0) + 10*isreal('a') + 100*isreal({1})", lambda x, A, w: 11),
    ("sum(repmat([u v], 2, 2) * [1; 2; 3; 4])", lambda x, A, w: 2 * (4 * x[0] + 6 * x[1])),
    ("[1 2 3]*diag(A) + sum(sum(diag([u v]))) + sum(sum(triu(A))) + sum(sum(tril(A, -1)))", lambda x, A, w:
     np.diag(A) @ [1, 2, 3] + x[0] + x[1] + A.sum()),
    ("fliplr(r)*w + circshift(x, 2)'*w + sum(flipud(A))*[1; 2; 3]", lambda x, A, w: x[::-1] @ w + np.roll(x, 2) @ w
     + A.sum(0) @ [1, 2, 3]),
    ("linspace(u, v, 4)*[1; 2; 3; 4]", lambda x, A, w: np.linspace(x[0], x[1], 4) @ [1, 2, 3, 4]),
    ("sum(horzcat(r, 1)) + sum(vertcat(x, x)) + sum(cat(1, x, w)) + sum(sum(blkdiag(A, 5)))", lambda x, A, w:
     4 * x.sum() + 1 + w.sum() + A.sum() + 5),
    ("polyval([1 -2 u], v) + sum(conv([1 u], [1 v]))", lambda x, A, w: np.polyval([1, -2, x[0]], x[1])
     + np.convolve([1, x[0]], [1, x[1]]).sum()),
    ("filter([1 0.5], [1 -0.2], x)'*w", lambda x, A, w: scipy.signal.lfilter([1, 0.5], [1, -0.2], x) @ w),
    ("fix(3*u) + rem(5*u, 2) + mod(5*v, 3) + floor(u) + ceil(v) + round(2*u) + sign(v)", lambda x, A, w:
     np.trunc(3 * x[0]) + np.fmod(5 * x[0], 2) + np.mod(5 * x[1], 3) + np.floor(x[0]) + np.ceil(x[1])
     + np.round(2 * x[0]) + np.sign(x[1])),
    ("atan2(u, v) + hypot(u, v) + sinh(u) + cosh(v) + tanh(u) + asinh(u) + atanh(v/9) + acosh(2 + u^2)",
     lambda x, A, w: np.arctan2(x[0], x[1]) + np.hypot(x[0], x[1]) + np.sinh(x[0]) + np.cosh(x[1]) + np.tanh(x[0])
     + np.arcsinh(x[0]) + np.arctanh(x[1] / 9) + np.arccosh(2 + x[0] ** 2)),
    ("log2(abs(u) + 1) + log1p(v^2) + expm1(u) + nthroot(-8, 3) + sqrt(abs(u)) + log10(2 + u^2)", lambda x, A, w:
     np.log2(abs(x[0]) + 1) + np.log1p(x[1] ** 2) + np.expm1(x[0]) - 2 + np.sqrt(abs(x[0])) + np.log10(2 + x[0] ** 2)),
    ("sind(30*u) + cosd(v) + atand(u) + deg2rad(v) + rad2deg(u)", lambda x, A, w: np.sin(np.deg2rad(30 * x[0]))
     + np.cos(np.deg2rad(x[1])) + np.rad2deg(np.arctan(x[0])) + np.deg2rad(x[1]) + np.rad2deg(x[0])),
    ("wrapToPi(3*u) + wrapTo2Pi(5*v)", lambda x, A, w: wrapped(3 * x[0]) + np.mod(5 * x[1], 2 * np.pi)),
    ("int32(7) + double(u) + single(v) + uint8(3) + cast(u, 'int16') + idivide(int32(7), int32(2))", lambda x, A, w:
     10 + 2 * x[0] + x[1] + 3),
    ("bitand(13, 6) + bitor(8, 3) + bitxor(7, 2) + bitshift(3, 2) + bitshift(9, -1) + bitget(5, 3) + bitset(1, 2)",
     lambda x, A, w: 4 + 11 + 5 + 12 + 4 + 1 + 3),
    ("bitand(round(50*u), round(50*v)) + bitor(round(50*u), round(50*v)) + bitxor(round(50*u), round(50*v))",
     lambda x, A, w: sum(op(int(np.round(50 * x[0])), int(np.round(50 * x[1]))) for op in (and_, or_, xor))),
    ("isnan(bitand(2^33 + round(u), 2^33 + round(v)))", lambda x, A, w: 1),
    ("bitand(floor(100*abs(u)), floor(100*abs(v))) + bitor(floor(9*abs(u)), 5) + bitxor(floor(9*abs(u)), 12)",
     lambda x, A, w: (int(100 * abs(x[0])) & int(100 * abs(x[1]))) + (int(9 * abs(x[0])) | 5)
     + (int(9 * abs(x[0])) ^ 12)),
    ("isnan(u) + isinf(1/0) + isfinite(v) + isnan(0/0) + isnumeric(u) + ischar('a') + isfield(struct('a', 1), 'a')",
     lambda x, A, w: 6),
    ("strcmp('a', 'a') + strcmp('a', 'b') + strcmpi('A', 'a') + isequal([1 2], [1 2]) + isa(u, 'double')",
     lambda x, A, w: 4),
    ("ismember(round(u), [0 1]) + numel(find(w > 1)) + find(w > 1, 1)", lambda x, A, w: (round(x[0]) in (0, 1)) + 3),
    ("pi + eps + double(realmax > 1) + double(intmax('uint8')) + true + inf*0.0 - inf*0.0 == 0", lambda x, A, w: 0),
    ("interp1([0 1 3], [2 4 -1], u, 'linear', 'extrap')", lambda x, A, w: extended([0, 1, 3], [2, 4, -1], x[0])),
    ("interp1([0 1 3], [2 4 -1], u, 'linear', 7)", lambda x, A, w: np.interp(x[0], [0, 1, 3], [2, 4, -1])
     if 0 <= x[0] <= 3 else 7),
    ("interp1([-5 0.5 5], [2 4 -1], u, 'nearest')", lambda x, A, w: 2 if x[0] < -2.25 else 4 if x[0] < 2.75 else -1),
    ("interp1([-5 0.5 5], [2 4 -1], u, 'previous')", lambda x, A, w: 2 if x[0] < 0.5 else 4),
    ("interp1([-5 0.5 5], [2 4 -1], u, 'next')", lambda x, A, w: 4 if x[0] <= 0.5 else -1),
    ("sum(interp1([-9 0 9], [u v 2], [v; u]))", lambda x, A, w: np.interp([x[1], x[0]], [-9, 0, 9], [x[0], x[1], 2])
     .sum()),
    ("interp2([-9 0 9], [-9 9], [1 2 3; 5 u 2], u, v)", lambda x, A, w: plane(x[0], x[1])),
    ("arrayfun(@(a) a^2, r)*w", lambda x, A, w: x**2 @ w),
    ("x(round(2*abs(v)) + 1)", lambda x, A, w: x[round(2 * abs(x[1]))] if round(2 * abs(x[1])) < 5 else np.nan),
    ("sum(A(min(round(abs(u)), 2) + 1, :))", lambda x, A, w: A[min(round(abs(x[0])), 2)].sum()),
    ("A(min(round(abs(u)), 2) + 1, min(round(abs(v)), 2) + 1)", lambda x, A, w: A[min(round(abs(x[0])), 2),
     min(round(abs(x[1])), 2)]),
    ("sum(x(min(round(abs(u)), 2) + (1:3)))", lambda x, A, w: x[min(round(abs(x[0])), 2) :][:3].sum()),
    ("any([u > 0, v > 0]) && ~all([u > 0; v > 0])", lambda x, A, w: (x[0] > 0) != (x[1] > 0)),
    ("x' * w + (-r).^2 * w + 2.^r * w + r ./ 2 * w", lambda x, A, w: x @ w + x**2 @ w + 2.0**x @ w + x / 2 @ w),
]  # fmt: skip


def extended(points, values, x):
    at = min(max(np.searchsorted(points, x, side="right") - 1, 0), len(points) - 2)
    slope = (values[at + 1] - values[at]) / (points[at + 1] - points[at])
    return values[at] + slope * (x - points[at])


def plane(u, v):
    rows = [np.interp(u, [-9, 0, 9], row) for row in ([1, 2, 3], [5, u, 2])]
    return np.interp(v, [-9, 9], rows)


@pytest.mark.parametrize(("text", "rule"), NUMBERS)
def test_functions_of_numbers(text, rule, tmp_path):
    output = outputs(body(f"{ARRAYS}y = {text};"), tmp_path)
    wanted = stepwise(lambda u, v: rule(*arrays(u, v)))
    np.testing.assert_allclose(output, wanted, rtol=1e-9, atol=1e-10)


def extremes(u, v):
    x, matrix, _ = arrays(u, v)
    return x.max() + 10 * (x.argmax() + 1) + (matrix.argmin(0) + 1) @ [1, 10, 100]


def ordered(u, v):
    x, _, w = arrays(u, v)
    order = np.argsort(x, kind="stable")
    return (order + 1) @ [1, 10, 100, 1000, 10000] + w[order][0]


def doubled(u, v):
    x, _, _ = arrays(u, v)
    return np.where(x > 0.5, 2 * x + 1, np.where(x < -0.5, -x, x)) @ [1, 2, 3, 4, 5]


def placed(u, v):
    x, _, _ = arrays(u, v)
    at = min(round(abs(u)), 3)
    x[at], x[at + 1] = 7, v
    return x @ [1, 2, 3, 4, 5]


def placed_or_not(u, v):
    x, _, _ = arrays(u, v)
    at = round(3 * u)
    if 1 <= at <= 5:
        x[at - 1] = 7
    return x @ [1, 2, 3, 4, 5]


def chosen_row(u, v):
    _, matrix, _ = arrays(u, v)
    matrix[min(round(abs(u)), 2)] = [u, 5, v]
    return (matrix @ [1, 10, 100]) @ [1, 2, 3]


STATEMENTS = [
    ("[a, i] = max(x);\n[~, j] = min(A);\ny = a + 10*i + j*[1; 10; 100];", extremes),
    ("[~, i] = sort(x);\ny = [1 10 100 1000 10000]*i + w(i(1));", ordered),
    ("x(x > 0.5) = 2*x(x > 0.5) + 1;\nx(x < -0.5) = -x(x < -0.5);\ny = (1:5)*x;", lambda u, v: doubled_twice(u, v)),
    ("m(2) = u > 0;\nm(1) = true;\nz = [5 7];\nz(m) = 0;\ny = z*[1; 10];", lambda u, v: 0 if u > 0 else 70),
    ("x(x > 0.5) = min(x(x > 0.5), 1);\ny = (1:5)*x;", lambda u, v: np.minimum(arrays(u, v)[0], 1) @ [1, 2, 3, 4, 5]),
    ("m = abs(x) > 1;\nx(m) = 0;\ny = sum(x);", lambda u, v: sum(a for a in arrays(u, v)[0] if abs(a) <= 1)),
    ("k = min(round(abs(u)), 3) + 1;\nx(k) = 7;\nx(k + 1) = v;\ny = (1:5)*x;", placed),
    ("x(round(3*u)) = 7;\ny = (1:5)*x;", placed_or_not),
    ("k = min(round(abs(u)), 3) + 1;\nx(k:k + 1) = [7 v];\ny = (1:5)*x;", placed),
    ("k = min(round(abs(u)), 2) + 1;\nA(k, :) = [u 5 v];\ny = [1 2 3]*(A*[1; 10; 100]);", chosen_row),
    ("z = [];\nfor k = 1:4\n z(end + 1) = k*u;\nend\ny = sum(z) + numel(z);", lambda u, v: 10 * u + 4),
    ("z(3) = u;\nz(2, 2) = v;\ny = sum(z(:)) + numel(z);", lambda u, v: u + v + 6),
    ("z = zeros(2, 2);\nz(:, 1) = [u; v];\nz(:, 2) = 3;\nz(end, end) = 4;\ny = [1 2]*z*[1; 10];", lambda u, v:
     u + 2 * v + 10 * (3 + 2 * 4)),
    ("z = zeros(2, 2, 2);\nz(:, :, 2) = [u 1; 2 v];\nq = z(:, :, 2)*[1; 1];\ny = q(1) + 10*q(2) + size(z, 3);",
     lambda u, v: u + 1 + 10 * (2 + v) + 2),
    ("s.a = u;\ns.b.c = [v 2];\ns.b.c(2) = 5;\ns.('d') = 3;\ny = s.a + s.b.c*[1; 10] + s.d + numel(fieldnames(s));",
     lambda u, v: u + v + 50 + 3 + 3),
    ("s = struct('k', u, 'n', [1 2 v]);\nt = s;\nt.k = 100;\ny = s.k + s.n(end) + isfield(t, 'n') + t.k;", lambda u, v:
     u + v + 1 + 100),
    ("if u > 0\n s.a = v; s.b = 1;\nelse\n s.a = 2; s.b = u;\nend\ny = s.a + s.b;", lambda u, v: v + 1 if u > 0
     else 2 + u),
    ("c = {u, 'text', [v 3]};\nc{4} = 5;\nq = c{3};\ny = c{1} + q(2)*c{4} + numel(c) + strcmp(c{2}, 'text');",
     lambda u, v: u + 15 + 5),
    ("c = {u};\nc{2} = v;\nd = {u; v};\nd{3} = 1;\ne{1} = 4;\ne{2} = 5;\n"
     "y = size(c)*[1; 10] + size(d)*[100; 1000] + size(e)*[1e4; 1e5] + c{2};", lambda u, v: 21 + 1300 + 210000 + v),
    ("[a, b] = size(A);\n[m, n] = deal(u, v);\n[lo, hi] = bounds(x);\ny = a + b + m - n + lo + 2*hi;", lambda u, v:
     6 + u - v + arrays(u, v)[0].min() + 2 * arrays(u, v)[0].max()),
    ("[X, Y] = meshgrid(1:2, [u v]);\ny = sum(sum(X.*Y));", lambda u, v: 3 * (u + v)),
    ("q = find([0 1 1]);\ny = sum(q)*u;", lambda u, v: 5 * u),
    ("k = find(x > 2, 1);\nif isempty(k)\n k = 9;\nend\ny = k;", lambda u, v: place_above(u, v, 9)),
    ("k = find(x > 2, 1, 'last');\nn = 0;\nif u > 0\n n = 5;\nend\nif ~isempty(k)\n n = n + k;\nend\ny = n + numel(k);",
     lambda u, v: 5 * (u > 0) + (place_above(u, v, -1, -1) + 1)),
    ("if isempty(find(x > 2, 1))\n y = -1;\nelse\n y = length(find(x > 2, 1));\nend", lambda u, v:
     min(place_above(u, v, -1), 1)),
    ("k = find(x > 2, 1);\nif k\n y = k;\nelse\n y = -1;\nend\ny = y + 10*any(k);", lambda u, v:
     place_above(u, v, -1) + 10 * (place_above(u, v, 0) > 0)),
    ("k = find(x > 0, 1);\nif any(x > 0)\n y = k;\nelse\n y = 0;\nend", lambda u, v: int(np.argmax(arrays(u, v)[0] > 0))
     + 1),
]  # fmt: skip


def doubled_twice(u, v):
    x = arrays(u, v)[0]
    x = np.where(x > 0.5, 2 * x + 1, x)
    return np.where(x < -0.5, -x, x) @ [1, 2, 3, 4, 5]


@pytest.mark.parametrize(("text", "rule"), STATEMENTS)
def test_statements_over_arrays(text, rule, tmp_path):
    output = outputs(body(f"{ARRAYS}{text}"), tmp_path)
    np.testing.assert_allclose(output, stepwise(rule), rtol=1e-10, atol=1e-11)


def test_values_beyond_a_curve_are_nan(tmp_path):
    output = outputs(body("y = interp1([-1 1], [2 4], u);"), tmp_path)
    np.testing.assert_allclose(output, np.where(abs(U) <= 1, 3 + U, np.nan))


@pytest.mark.parametrize(
    "text",
    [
        "y = sum(([K u; v K + 2]) \\ [1; K]);",
        "y = interp1([-5 0 5], [u K v], K*u/2);",
        "y = sort([K*u; v; 1])' * [1; 2; 3];",
        "x = [u v K];\ny = x(min(round(abs(u)), 2) + 1)*K;",
        "x = [u v K];\nx(x > 0) = K*x(x > 0);\ny = sum(x);",
        "y = norm([K*u v]) + det([K u; v 1]) + expm1(K*u) + atan2(K, u);",
    ],
)
def test_derivatives_of_functions(text, tmp_path):
    check_slopes(f"function y = f(u, v, K)\n{text}\nend\n", tmp_path, "K", 0.7)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("y = interp1([0 1 2], [u v 1], u, 'spline');", "unknown method 'spline'"),
        ("y = interp1([0 u 2], [u v 1], u);", "breakpoints of interp1 must not depend on signals"),
        ("y = interp1([0 0 2], [u v 1], u);", "not increasing"),
        ("y = [1 2; 3 4] \\ [1; 2; 3];", "only square ones"),
        ("y = inv(zeros(20));", "exceeds the maximum of 12"),
        ("y = numel(find([u v] > 0));", "depends on signals"),
        ("x = [u v];\ny = sum(x(x > 0));", "a mask on x depends on signals"),
        ("x = [u v];\nx(x > 0) = sum(x(x > 0));\ny = sum(x);", "not used element by element"),
        ("x = [u v];\nx(x > 0) = min(x(x > 0));\ny = sum(x);", "not used element by element"),
        ("x = [u v];\nf = @(z) sum(z);\nx(x > 0) = f(x(x > 0));\ny = sum(x);", "not used element by element"),
        ("y = sum([u v], 'omitnan');", "'omitnan' is not supported"),
        ("y = median([u v; 1 2]);", "median: of a matrix"),
        ("y = filter(1, [1 -0.5], [u v; 1 2]);", "filter: of a matrix"),
        ("y = nthroot(u, 0);", "a root of degree 0"),
        ("y = zeros(u);", "a size must not depend on signals"),
        ("y = bitand(-1, 5);", "negative or not integers"),
        ("y = struct('a', {{1, 2}}, 'b');", "a field has no value"),
        ("y = sum(sort(zeros(100, 1)));", "exceed the maximum of 64"),
        ("x = 1:u;\ny = x(1);", "the length of a range depends on signals"),
    ],
)
def test_unsupported_functions_are_reported(text, message, tmp_path):
    with pytest.raises(InputError, match=message):
        imported(function(body(text)), tmp_path)


def test_the_slope_of_asinh_at_zero_is_one(tmp_path):
    model = imported(function("function y = f(u, v, K)\ny = asinh(K*u) + asinh(K*v);\n"), tmp_path,
                     parameters=[{"K": 0.0}])  # fmt: skip
    exact, _ = slopes(model, {"u": U, "v": -U / 2}, "K", "y1")
    np.testing.assert_allclose(exact[:, 0], U / 2)

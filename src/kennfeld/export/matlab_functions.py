"""Local functions of exported MATLAB code, each written only if the code calls it; see `c_functions`."""

from collections.abc import Mapping

# of real numbers: MATLAB would go on with complex ones, where the C library has NaN
_REAL = {
    "sqrt": "x < 0",
    "log": "x < 0",
    "log10": "x < 0",
    "asin": "abs(x) > 1",
    "acos": "abs(x) > 1",
}
FUNCTIONS: Mapping[str, str] = {
    **{
        f"real_{name}": f"""\
function y = real_{name}(x)
if {outside}
    y = NaN;
else
    y = {name}(x);
end
end"""
        for name, outside in _REAL.items()
    },
    "real_power": """\
function y = real_power(x, n)
if x < 0 && n ~= floor(n)
    y = NaN;
else
    y = x ^ n;
end
end""",
    "choose": """\
function y = choose(condition, a, b)
if condition
    y = a;
else
    y = b;
end
end""",
    "lesser": """\
function y = lesser(a, b)
% NaN if one of them is
if b ~= b || a > b
    y = b;
else
    y = a;
end
end""",
    "greater": """\
function y = greater(a, b)
% NaN if one of them is
if b ~= b || a < b
    y = b;
else
    y = a;
end
end""",
    "remainder": """\
function y = remainder(a, b)
% with the sign of the divisor; the dividend if the divisor is 0
if b == 0
    y = a;
else
    y = a - floor(a / b) * b;
end
end""",
    "cell_of": """\
function i = cell_of(x, points)
% 1 if x is below the first breakpoint, or NaN
low = 1;
high = numel(points);
while high - low > 1
    middle = floor((low + high) / 2);
    if x >= points(middle)
        low = middle;
    else
        high = middle;
    end
end
i = low;
end""",
    "linear": """\
function f = linear(x, points, i)
f = (x - points(i)) / (points(i + 1) - points(i));
end""",
    "clip": """\
function f = clip(x, points, i)
f = (x - points(i)) / (points(i + 1) - points(i));
if f < 0
    f = 0;
end
if f > 1
    f = 1;
end
end""",
    "part": """\
function y = part(weight, value)
% a grid point of weight 0 does not count, even if it is not finite
if weight == 0
    y = 0;
else
    y = weight * value;
end
end""",
    "expand_gaussian": """\
function y = expand_gaussian(v, x, centres)
n = numel(x);
y = v(1) + sum(v(2:n + 1) .* x);
for i = 1:centres
    t = bell_distance(v, x, centres, i);
    y = y + v(n + 1 + i) * exp(-0.5 * sum(t .* t));
end
end""",
    "expand_matern52": """\
function y = expand_matern52(v, x, centres)
n = numel(x);
y = v(1) + sum(v(2:n + 1) .* x);
for i = 1:centres
    t = bell_distance(v, x, centres, i);
    five = 5 * sum(t .* t);
    s = sqrt(five);
    y = y + v(n + 1 + i) * ((1 + s + five / 3) * exp(-s));
end
end""",
    "bell_distance": """\
function t = bell_distance(v, x, centres, i)
% in widths; centres and widths are stored input by input
n = numel(x);
at = 1 + n + centres + (0:n - 1) * centres + i;
t = (x - v(at)) ./ v(at + n * centres);
t(~(t > -1000)) = -1000;
t(t > 1000) = 1000;
end""",
    **{
        f"layer_{name}": f"""\
function y = layer_{name}(v, x, alpha)
% a row of weights for each input, then the biases
z = v(end, :);
for j = 1:numel(x)
    z = z + v(j, :) * x(j);
end
y = z;
{body}
end"""
        for name, body in {
            "identity": "",
            "relu": "y(z < 0) = 0;",
            "leaky_relu": "y(z < 0) = alpha * z(z < 0);",
            "elu": "y(z < 0) = alpha * expm1(z(z < 0));",
            "tanh": "y = tanh(z);",
            "sigmoid": "y = 1 ./ (1 + exp(-abs(z)));\ny(z < 0) = exp(z(z < 0)) ./ (1 + exp(z(z < 0)));",
        }.items()
    },
}
NEEDS = {
    "expand_gaussian": ("bell_distance",),
    "expand_matern52": ("bell_distance",),
}
OF_REAL_NUMBERS = tuple(_REAL)


class MatlabFunctions:
    """The local functions that the code of a function calls."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def __call__(self, name: str) -> str:
        """Return the name of a function, which becomes a part of the code."""
        if name not in self._texts:
            for needed in NEEDS.get(name, ()):
                self(needed)
            self._texts[name] = FUNCTIONS[name]
        return name

    @property
    def text(self) -> str:
        """The definitions."""
        return "".join(f"\n{text.replace(chr(10) * 2, chr(10))}\n" for text in self._texts.values())

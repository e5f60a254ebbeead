"""The functions of the exported C code that do not depend on its nodes: search, interpolation, layers.

Each is written only if the code calls it, so that no compiler warns of one without use. Names begin with that of the
exported function, so that several of them can be linked together. The order of operations is that of
`native.table_lookup` and `native.elementwise`.

In the templates, `T` is the type of numbers, `N_` begins a name of the code, and `$` a number or a function of the C
library in the precision of the code.
"""

import re
from collections.abc import Callable, Mapping

from kennfeld.domain.rbf import MAX_DISTANCE
from kennfeld.export.c_arithmetic import CArithmetic

_PLAIN: Mapping[str, str] = {
    "min": """\
/* the lesser of two numbers, NaN if one of them is */
static T N_min(T a, T b)
{
    const T first = !(a > b) ? a : b;

    return (b != b) ? b : first;
}""",
    "max": """\
/* the greater of two numbers, NaN if one of them is */
static T N_max(T a, T b)
{
    const T first = !(a < b) ? a : b;

    return (b != b) ? b : first;
}""",
    "mod": """\
/* remainder with the sign of the divisor, the dividend if the divisor is 0 */
static T N_mod(T a, T b)
{
    const T whole = $floor(a / b);
    const T product = whole * b;

    return (b == $0) ? a : (a - product);
}""",
    "round": """\
/* nearest whole number, halves away from 0 */
static T N_round(T x)
{
    const T whole = $trunc(x);

    return ($fabs(x - whole) >= $half) ? (whole + $copysign($1, x)) : whole;
}""",
    "sign": """\
/* 1, -1, or the number itself if it is 0 or NaN */
static T N_sign(T x)
{
    const T above = (x > $0) ? $1 : x;

    return (x < $0) ? (-$1) : above;
}""",
    "find": """\
/* cell of an axis of n >= 2 breakpoints that holds x: 0 if x is below the first one, or NaN */
static int32_t N_find(T x, const T *points, int32_t n)
{
    int32_t low = 0;
    int32_t cells = n - 1;

    while (cells > 1) {
        const int32_t half = cells / 2;

        low = (x >= points[low + half]) ? (low + half) : low;
        cells = cells - half;
    }
    return low;
}""",
    "find_even": """\
/* the same of an axis whose breakpoints are about evenly spaced, `density` of them per unit: its cell or a neighbour
   follows from x */
static int32_t N_find_even(T x, const T *points, int32_t n, T density)
{
    const int32_t last = n - 2;
    const T guess = (x - points[0]) * density;
    int32_t cell = 0;

    if (guess >= (T)last) {
        cell = last;
    } else if (guess > $0) {
        cell = (int32_t)guess;
    } else {
        /* below the first breakpoint, or NaN */
    }
    while ((cell > 0) && (x < points[cell])) {
        cell--;
    }
    while ((cell < last) && (x >= points[cell + 1])) {
        cell++;
    }
    return cell;
}""",
    "linear": """\
/* share of cell i that lies below x; < 0 or > 1 beyond the ends of the axis */
static T N_linear(T x, const T *points, int32_t i)
{
    const T past = x - points[i];
    const T width = points[i + 1] - points[i];

    return past / width;
}""",
    "clip": """\
/* share of cell i that lies below x, from 0 to 1; NaN if x is */
static T N_clip(T x, const T *points, int32_t i)
{
    const T share = N_linear(x, points, i);
    const T low = (share < $0) ? $0 : share;

    return (low > $1) ? $1 : low;
}""",
    "outer_slope": """\
/* slope of the share of cell i */
static T N_outer_slope(const T *points, int32_t i)
{
    return $1 / (points[i + 1] - points[i]);
}""",
    "inner_slope": """\
/* slope of the share of cell i, 0 beyond the ends of the axis */
static T N_inner_slope(T x, const T *points, int32_t i, int32_t n)
{
    const T slope = $1 / (points[i + 1] - points[i]);

    return ((x >= points[0]) && (x <= points[n - 1])) ? slope : $0;
}""",
    "value": """\
/* value of a stored number: factor, shift and divisor of its conversion */
static T N_value(T number, const T *scale)
{
    return ((scale[0] * number) + scale[1]) / scale[2];
}""",
    "part": """\
/* part of a grid point in a value; one of weight 0 does not count, even if it is not finite */
static T N_part(T weight, T value)
{
    return (weight == $0) ? $0 : (weight * value);
}""",
}
_NEEDS: Mapping[str, tuple[str, ...]] = {"clip": ("linear",)}

_BELLS = {
    "gaussian": ("const T bell = $exp((-$half) * square);",),
    "matern52": (
        "const T five = square * $five;",
        "const T s = $sqrt(five);",
        "const T bell = (($1 + s) + (five * $third)) * $exp(-s);",
    ),
}
_EXPANSION = """\
/* plane and bells: offset, slopes, weights of the bells, their centres and their widths, input by input */
static T N_expand_{kernel}(const T *values, const T *x, int32_t inputs, int32_t centres)
{{
    const T *weights = &values[1 + inputs];
    const T *middles = &weights[centres];
    const T *widths = &middles[centres * inputs];
    T plane = values[0];
    T bells = $0;
    int32_t i;
    int32_t d;

    for (d = 0; d < inputs; d++) {{
        plane = plane + (values[1 + d] * x[d]);
    }}
    for (i = 0; i < centres; i++) {{
        T square = $0;

        for (d = 0; d < inputs; d++) {{
            const T apart = (x[d] - middles[(d * centres) + i]) / widths[(d * centres) + i];
            const T above = (apart > (-$far)) ? apart : (-$far);
            const T t = (above < $far) ? above : $far;

            square = square + (t * t);
        }}
        {bell}
        bells = bells + (weights[i] * bell);
    }}
    return plane + bells;
}}"""

# slope of the bell times -1 / r^2
_DECLINES = {"gaussian": "bell", "matern52": "(($five * $third) * ($1 + s)) * $exp(-s)"}
_EXPANSION_TANGENT = """\
/* change of plane and bells for a change dv of their values and dx of the inputs */
static T N_expand_{kernel}_tangent(const T *v, const T *x, const T *dv, const T *dx, int32_t inputs, int32_t centres)
{{
    const int32_t weights = 1 + inputs;
    const int32_t middles = weights + centres;
    const int32_t widths = middles + (centres * inputs);
    T sum = dv[0];
    int32_t i;
    int32_t d;

    for (d = 0; d < inputs; d++) {{
        sum = sum + ((dv[1 + d] * x[d]) + (v[1 + d] * dx[d]));
    }}
    for (i = 0; i < centres; i++) {{
        T square = $0;
        T change = $0;

        for (d = 0; d < inputs; d++) {{
            const int32_t at = (d * centres) + i;
            const T apart = (x[d] - v[middles + at]) / v[widths + at];
            const T above = (apart > (-$far)) ? apart : (-$far);
            const T t = (above < $far) ? above : $far;

            square = square + (t * t);
            change = change + (t * (((dx[d] - dv[middles + at]) - (t * dv[widths + at])) / v[widths + at]));
        }}
        {bell}
        sum = sum + ((dv[weights + i] * bell) - ((v[weights + i] * ({decline})) * change));
    }}
    return sum;
}}"""

_ACTIVATIONS = {
    "identity": "z",
    "relu": "(z < $0) ? $0 : z",
    "leaky_relu": "(z < $0) ? (alpha * z) : z",
    "elu": "(z < $0) ? (alpha * $expm1(z)) : z",
    "tanh": "$tanh(z)",
    # by e^-|z|, which cannot overflow
    "sigmoid": "((z < $0) ? $exp(z) : $1) / ($1 + $exp(-$fabs(z)))",
}
_SLOPES = {
    "identity": "$1",
    "relu": "(z < $0) ? $0 : $1",
    "leaky_relu": "(z < $0) ? alpha : $1",
    "elu": "(z < $0) ? (alpha * $exp(z)) : $1",
    "tanh": "$1 - ($tanh(z) * $tanh(z))",
    "sigmoid": "$exp(-$fabs(z)) / (($1 + $exp(-$fabs(z))) * ($1 + $exp(-$fabs(z))))",
}
WITH_ALPHA = ("leaky_relu", "elu")
_LAYER = """\
/* dense layer: a row of weights for each input, then the biases */
static void N_layer_{activation}(const T *values, int32_t inputs, int32_t outputs, {alpha}const T *x, T *y)
{{
    int32_t i;
    int32_t j;

    for (i = 0; i < outputs; i++) {{
        T z = values[(inputs * outputs) + i];

        for (j = 0; j < inputs; j++) {{
            z = z + (values[(j * outputs) + i] * x[j]);
        }}
        y[i] = {value};
    }}
}}"""

_LAYER_TANGENT = """\
/* change of the outputs of a dense layer for a change dv of its values and dx of its inputs */
static void N_layer_{activation}_tangent(
    const T *v, int32_t inputs, int32_t outputs, {alpha}const T *x, const T *dv, const T *dx, T *dy)
{{
    int32_t i;
    int32_t j;

    for (i = 0; i < outputs; i++) {{
        {before}T change = dv[(inputs * outputs) + i];

        for (j = 0; j < inputs; j++) {{
            const int32_t at = (j * outputs) + i;

            {sum}change = change + ((dv[at] * x[j]) + (v[at] * dx[j]));
        }}
        dy[i] = change * ({slope});
    }}
}}"""


class CFunctions:
    """The functions that the code of one exported function calls, in an order in which they can be defined."""

    def __init__(self, name: str, arithmetic: CArithmetic) -> None:
        self._name, self._arithmetic = name, arithmetic
        self._texts: dict[str, str] = {}

    def __call__(self, kind: str) -> str:
        """Return the name of a function, which becomes a part of the code."""
        return self._add(kind, lambda: _PLAIN[kind], _NEEDS.get(kind, ()))

    def lookup(self, sides: str, slope: int | None = None, stored: str = "") -> str:
        """Return the name of the interpolation in a table, or of its slope along an axis.

        Args:
            sides: for each axis "c" if a coordinate has a cell there, or "s" if the axis has a single breakpoint.
            slope: the axis.
            stored: the type of the numbers of the table, which are converted; empty for values.
        """
        ending = lookup_ending(slope, stored)
        needs = ("part", "value") if stored else ("part",)
        return self._add(f"lookup_{sides}{ending}", lambda: _lookup(sides, slope, stored), needs)

    def expansion(self, kernel: str) -> str:
        """Return the name of the function of an expansion in radial basis functions."""
        bell = "\n        ".join(_BELLS[kernel])
        return self._add(f"expand_{kernel}", lambda: _EXPANSION.format(kernel=kernel, bell=bell))

    def layer(self, activation: str) -> str:
        """Return the name of the function of a dense layer."""
        alpha = "T alpha, " if activation in WITH_ALPHA else ""
        parts = {"activation": activation, "alpha": alpha, "value": _ACTIVATIONS[activation]}
        return self._add(f"layer_{activation}", lambda: _LAYER.format(**parts))

    def expansion_tangent(self, kernel: str) -> str:
        """Return the name of the function of the change of an expansion."""
        parts = {"kernel": kernel, "bell": "\n        ".join(_BELLS[kernel]), "decline": _DECLINES[kernel]}
        return self._add(f"expand_{kernel}_tangent", lambda: _EXPANSION_TANGENT.format(**parts))

    def layer_tangent(self, activation: str) -> str:
        """Return the name of the function of the change of a dense layer."""
        parts = {"activation": activation, "slope": _SLOPES[activation], "before": "", "sum": ""}
        parts["alpha"] = "T alpha, " if activation in WITH_ALPHA else ""
        if activation != "identity":
            parts |= {"before": "T z = v[(inputs * outputs) + i];\n        "}
            parts |= {"sum": "z = z + (v[at] * x[j]);\n            "}
        return self._add(f"layer_{activation}_tangent", lambda: _LAYER_TANGENT.format(**parts))

    @property
    def text(self) -> str:
        """The definitions."""
        return "".join(f"{text}\n\n" for text in self._texts.values())

    def _add(self, kind: str, write: Callable[[], str], needs: tuple[str, ...] = ()) -> str:
        if kind not in self._texts:
            for needed in needs:
                self(needed)
            self._texts[kind] = re.sub(r"\bT\b|\bN_|\$\w+", self._word, write())
        return f"{self._name}_{kind}"

    def _word(self, match: re.Match[str]) -> str:
        """Return a word of a template in the precision and with the names of the code."""
        numbers = {"0": 0.0, "1": 1.0, "half": 0.5, "five": 5.0, "third": 1.0 / 3.0, "far": MAX_DISTANCE}
        word = match[0].lstrip("$")
        if match[0] == "T":
            return self._arithmetic.precision
        if match[0] == "N_":
            return f"{self._name}_"
        return self._arithmetic.literal(numbers[word]) if word in numbers else self._arithmetic.library(word)


def lookup_ending(slope: int | None, stored: str) -> str:
    """Return the ending of the name of an interpolation.

    >>> lookup_ending(None, "uint8_t"), lookup_ending(1, "")
    ('_uint8', '_slope1')
    """
    return ("" if slope is None else f"_slope{slope}") + (f"_{stored.removesuffix('_t')}" if stored else "")


def _lookup(sides: str, slope: int | None = None, stored: str = "") -> str:
    """Write the interpolation between the grid points around a coordinate: the sum of weight times value.

    Weights are products along the axes, the first one first; grid points are added in the order of their values. Along
    the axis `slope`, weights are replaced by their slopes.
    """
    weights: list[str] = []
    corners = [("", "")]  # weight and offset
    for axis, side in enumerate(sides):
        weights += _weights(side, axis, slope)
        factors = (f"g{axis}", f"f{axis}") if side == "c" else (f"g{axis}",)
        if axis:
            pairs = [(weight, factor) for weight, _ in corners for factor in factors]
            weights += [f"const T {weight}{factor} = {weight} * {factor};" for weight, factor in pairs]
        corners = [
            (f"{weight}{factor}", _plus(offset, _stride(sides, axis)) if step else offset)
            for weight, offset in corners
            for step, factor in enumerate(factors)
        ]
    kind_of, number = stored or "T", "N_value((T)at[{}], scale)" if stored else "at[{}]"
    first, *others = [f"N_part({weight}, {number.format(offset or '0')})" for weight, offset in corners]
    lines = [*weights, f"const {kind_of} *at = &values[{_offset(sides)}];", f"T sum = {first};", ""]
    lines += [*(f"sum = sum + {part};" for part in others), "return sum;"]
    body = [f"    {line}" if line else "" for line in lines]
    kind = {1: "curve", 2: "map"}.get(len(sides), f"table of {len(sides)} axes")
    what = "value" if slope is None else f"slope along axis {slope + 1}"
    ending, parameters = lookup_ending(slope, stored), _lookup_parameters(sides, slope, kind_of)
    parameters += ["const T *scale"] if stored else []
    head = f"static T N_lookup_{sides}{ending}({', '.join(parameters)})"
    return "\n".join([f"/* {what} of a {kind} */", head, "{", *body, "}"])


def _weights(side: str, axis: int, slope: int | None) -> list[str]:
    """Return the definitions of the weights along one axis: g of the first grid point, f of the second."""
    if axis == slope:
        # of the weights 1 - f and f, or of a single one
        return [f"const T g{axis} = -$1;", f"const T f{axis} = $1;"] if side == "c" else [f"const T g{axis} = $0;"]
    # of a single one, 1, or NaN if the coordinate is not finite
    return [f"const T g{axis} = $1 - f{axis};" if side == "c" else f"const T g{axis} = $1 + (f{axis} * $0);"]


def _lookup_parameters(sides: str, slope: int | None, kind: str) -> list[str]:
    parameters = [f"const {kind} *values"]
    for axis, side in enumerate(sides):
        if side == "c":
            parameters.append(f"int32_t i{axis}")
        if axis != slope:
            parameters.append(f"T f{axis}")
        if counts_points(sides, axis):
            parameters.append(f"int32_t n{axis}")
    return parameters


def counts_points(sides: str, axis: int) -> bool:
    """Return True if an interpolation takes the number of breakpoints of an axis, the stride of an earlier one."""
    return sides[axis] == "c" and "c" in sides[:axis]


def _stride(sides: str, axis: int) -> str:
    """Return the distance of neighbours along an axis, in values."""
    return " * ".join(f"n{later}" for later in range(axis + 1, len(sides)) if sides[later] == "c") or "1"


def _offset(sides: str) -> str:
    strides = {axis: _stride(sides, axis) for axis, side in enumerate(sides) if side == "c"}
    terms = [f"i{axis}" if stride == "1" else f"(i{axis} * {stride})" for axis, stride in strides.items()]
    return " + ".join(terms) or "0"


def _plus(offset: str, stride: str) -> str:
    term = f"({stride})" if "*" in stride else stride
    return f"{offset} + {term}" if offset else term

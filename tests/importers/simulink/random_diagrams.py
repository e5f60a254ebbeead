"""Random block diagrams with the same arithmetic in NumPy beside them, in the types that generated code has.

A signal is a number of type float32 or float64, as its ports say; a parameter is a Python float, which NumPy rounds to
the type of the signal that it meets, as generated code stores it.
"""

import math

import numpy as np

from tests.importers.simulink.simulink_files import Model

f32, f64 = np.float32, np.float64
COLUMNS = ("u", "v", "w")
STATES = 2  # unit delays that close loops


def _fmod(a, b):
    return type(a)(math.fmod(a, b)) if np.isfinite(a) and np.isfinite(b) and b else type(a)(math.nan)


def _is_multiple(a, b):
    """Return True where generated code takes a / b as whole although `fmod` leaves a rest."""
    quotient = abs(a / b)
    return b != np.floor(b) and abs(quotient - np.floor(quotient + type(a)(0.5))) <= np.finfo(type(a)).eps * quotient


def _rest(a, b, of_sign):
    if b == 0:
        return a
    rest = _fmod(a, b)
    if _is_multiple(a, b):
        return type(a)(0)
    return rest + b if of_sign and rest and (a < 0) != (b < 0) else rest


def _halves_away(x):
    return np.copysign(np.floor(np.abs(x) + type(x)(0.5)), x) if abs(x) < 2**22 else x


def _root(x):
    return -np.sqrt(-x) if x < 0 else np.sqrt(x)


def _limit(x, low, high):
    low, high = type(x)(low), type(x)(high)
    return high if x > high else low if x < low else x


class Diagram:
    """A model drawn by chance: `model`, and `outputs(columns)`, which runs the same in NumPy."""

    def __init__(self, seed, *, single, blocks=14):
        self.random = np.random.default_rng(seed)
        self.model = Model(step="0.1", solver="FixedStepDiscrete")
        self.real = f32 if single else f64
        self.steps = []  # (name, inputs, rule of the inputs and the memory of the block)
        self.signals = list(COLUMNS)
        self.types = dict(zip(COLUMNS, (self.real, f64, self.real), strict=True))
        self.starts = {f"Z{at}": self.number() for at in range(STATES)}
        for name, kind in self.types.items():
            self.model.inport(name, OutDataTypeStr="single" if kind is f32 else "double")
        for name, start in self.starts.items():
            self.model.block("UnitDelay", name, SampleTime="0.1", InitialCondition=f"{start}", **self.typed())
            self.signals.append(name)
            self.types[name] = self.real
        for at in range(blocks):
            self.block(f"B{at}")
        self.loops = {name: self.of_type() for name in self.starts}
        for state, source in self.loops.items():
            self.model.line(source, state)
        for name in [name for name, *_ in self.steps]:
            self.model.outport(f"y{name}")
            self.model.line(name, f"y{name}")

    def typed(self):
        return {"OutDataTypeStr": "single" if self.real is f32 else "double"}

    def one_of(self, choices):
        return choices[self.random.integers(len(choices))]

    def number(self, low=-3.0, high=3.0):
        return round(float(self.random.uniform(low, high)), int(self.random.integers(1, 4)))

    def of_type(self):
        """A signal limited to a range, and of the type of the loops, so that they neither grow nor change type."""
        source, name = self.one_of(self.signals[-9:]), f"L{len(self.steps)}"
        self.model.block("Saturate", f"{name}S", UpperLimit="50", LowerLimit="-50")
        self.model.block("DataTypeConversion", name, **self.typed())
        self.model.chain(source, f"{name}S", name)
        self.steps.append((name, (source,), lambda values, memory: self.real(_limit(values[0], -50, 50))))
        return name

    def block(self, name):
        # remainders of doubles are those of generated code up to rounding only, and may be off by the divisor then
        drawings = [
            each for each in dir(self) if each.startswith("draw_") and (self.real is f32 or each != "draw_rest")
        ]
        drawing = self.one_of(drawings)
        kind, count, parameters, rule = getattr(self, drawing)()
        choices = [each for each in self.signals if drawing != "draw_rest" or self.types[each] is self.real]
        sources = tuple(self.one_of(choices[-9:] if self.random.random() < 0.6 else choices) for _ in range(count))
        own = [self.types[source] for source in (sources[::2] if kind == "Switch" else sources)]
        self.types[name] = f32 if parameters.get("OutDataTypeStr") == "single" else f64 if f64 in own else f32
        self.model.block(kind, name, ports=(count, 1), **parameters)
        for at, source in enumerate(sources, 1):
            self.model.line(source, f"{name}:{at}")
        self.steps.append((name, sources, rule))
        self.signals.append(name)

    def draw_sum(self):
        signs = "".join(self.one_of("+-") for _ in range(self.random.integers(2, 5)))

        def rule(values, memory):
            total = values[0] if signs[0] == "+" else -values[0]
            for sign, value in zip(signs[1:], values[1:], strict=True):
                total = total + value if sign == "+" else total - value
            return total

        # all operands have the type of the result
        return "Sum", len(signs), {"Inputs": signs}, lambda v, m: rule(list(map(_common(v), v)), m)

    def draw_product(self):
        signs = self.one_of(("**", "*/", "***", "/*", "**/"))

        def rule(values, memory):
            values = list(map(_common(values), values))
            if signs == "/*":
                return values[1] / values[0]
            total = values[0]
            for sign, value in zip(signs[1:], values[1:], strict=True):
                total = total * value if sign == "*" else total / value
            return total

        return "Product", len(signs), {"Inputs": signs}, rule

    def draw_gain(self):
        k = self.number()
        return "Gain", 1, {"Gain": f"{k}"}, lambda v, m: k * v[0]

    def draw_bias(self):
        k = self.number()
        return "Bias", 1, {"Bias": f"{k}"}, lambda v, m: v[0] + k

    def draw_size(self):
        kind, rule = self.one_of((("Abs", np.abs), ("UnaryMinus", np.negative), ("Signum", np.sign)))
        return kind, 1, {}, lambda v, m: rule(v[0])

    def draw_extreme(self):
        name = self.one_of(("min", "max"))
        rule = np.minimum if name == "min" else np.maximum
        return "MinMax", 2, {"Inputs": "2", "Function": name}, lambda v, m: rule(*map(_common(v), v))

    def draw_limits(self):
        low, high = sorted((self.number(), self.number()))
        fields = {"LowerLimit": f"{low}", "UpperLimit": f"{high}"}
        return "Saturate", 1, fields, lambda v, m: _limit(v[0], low, high)

    def draw_dead_zone(self):
        low, high = sorted((self.number(), self.number()))

        def rule(values, memory):
            x = values[0]
            return x - high if x > type(x)(high) else x - low if x < type(x)(low) else type(x)(0)

        return "DeadZone", 1, {"LowerValue": f"{low}", "UpperValue": f"{high}"}, rule

    def draw_quantizer(self):
        q = self.number(0.2, 1.0)
        return "Quantizer", 1, {"QuantizationInterval": f"{q}"}, lambda v, m: _halves_away(v[0] / q) * q

    def draw_root(self):
        return "Sqrt", 1, {"Operator": "signedSqrt"}, lambda v, m: _root(v[0])

    def draw_square(self):
        return "Math", 1, {"Operator": "square"}, lambda v, m: v[0] * v[0]

    def draw_rest(self):
        name = self.one_of(("mod", "rem"))
        rule = lambda v, m: _rest(*map(_common(v), v), name == "mod")  # noqa: E731
        return "Math", 2, {"Operator": name}, rule

    def draw_rounding(self):
        name = self.one_of(("floor", "ceil", "round", "fix"))
        rule = {"floor": np.floor, "ceil": np.ceil, "round": _halves_away, "fix": np.trunc}[name]
        return "Rounding", 1, {"Operator": name}, lambda v, m: rule(v[0])

    def draw_switch(self):
        level, sign = self.number(), self.one_of((">=", ">", "~="))
        criteria = f"u2 {sign} {'0' if sign == '~=' else 'Threshold'}"
        test = {">=": lambda x: x >= type(x)(level), ">": lambda x: x > type(x)(level), "~=": lambda x: x != 0}[sign]

        def rule(values, memory):
            kind = _common((values[0], values[2]))
            return kind(values[0]) if test(values[1]) else kind(values[2])

        return "Switch", 3, {"Criteria": criteria, "Threshold": f"{level}"}, rule

    def draw_polynomial(self):
        terms = [self.number() for _ in range(3)]
        rule = lambda v, m: (terms[0] * v[0] + terms[1]) * v[0] + terms[2]  # noqa: E731
        return "Polyval", 1, {"Coefs": f"{terms}"}, rule

    def draw_expression(self):
        a, b = self.number(), self.number()
        return (
            "Fcn",
            1,
            {"Expr": f"({a} * u + {b}) * u - u / {a + 4}"},
            (lambda v, m: (a * v[0] + b) * v[0] - v[0] / (a + 4)),
        )

    def draw_delay(self):
        start = self.number()

        def rule(values, memory):
            seen = memory.get("x", type(values[0])(start))
            memory["x"] = values[0]
            return seen

        return "UnitDelay", 1, {"SampleTime": "0.1", "InitialCondition": f"{start}"}, rule

    def draw_integrator(self):
        gain, start = self.number(), self.number()

        def rule(values, memory):
            seen = memory.get("x", type(values[0])(start))
            memory["x"] = seen + gain * 0.1 * values[0]
            return seen

        fields = {"SampleTime": "0.1", "gainval": f"{gain}", "InitialCondition": f"{start}"}
        return "DiscreteIntegrator", 1, fields, rule

    def draw_filter(self):
        b0, b1, a1 = self.number(), self.number(), self.number(-0.9, 0.9)

        def rule(values, memory):
            seen = memory.get("x", type(values[0])(0))
            new = values[0] - a1 * seen
            memory["x"] = new
            return b0 * new + b1 * seen

        kind = self.one_of(("DiscreteFilter", "DiscreteTransferFcn"))
        fields = {"Numerator": f"[{b0} {b1}]", "Denominator": f"[1 {a1}]", "SampleTime": "0.1"}
        return kind, 1, fields, rule

    def draw_relay(self):
        off, on = sorted((self.number(), self.number()))
        low, high = self.number(), self.number()

        def rule(values, memory):
            x = values[0]
            is_on = True if x >= type(x)(on) else False if x <= type(x)(off) else memory.get("x", False)
            memory["x"] = is_on
            return type(x)(high if is_on else low)

        fields = {"OnSwitchValue": f"{on}", "OffSwitchValue": f"{off}", "OnOutputValue": f"{high}"}
        return "Relay", 1, {**fields, "OffOutputValue": f"{low}", "SampleTime": "0.1"}, rule

    def draw_rate_limit(self):
        up, down, start = self.number(0.5, 9.0), self.number(-9.0, -0.5), self.number()

        def rule(values, memory):
            x = values[0]
            seen = memory.get("x", type(x)(start))
            change = x - seen
            high, low = type(x)(up * 0.1), type(x)(down * 0.1)
            memory["x"] = seen + high if change > high else seen + low if change < low else x
            return memory["x"]

        fields = {"RisingSlewLimit": f"{up}", "FallingSlewLimit": f"{down}", "InitialCondition": f"{start}"}
        return "RateLimiter", 1, {**fields, "SampleTimeMode": "inherited", "SampleTime": "0.1"}, rule

    def draw_backlash(self):
        width, start = self.number(0.2, 3.0), self.number()

        def rule(values, memory):
            x = values[0]
            seen, half = memory.get("x", type(x)(start)), type(x)(width / 2)
            memory["x"] = x + half if x < seen - half else seen if x <= seen + half else x - half
            return memory["x"]

        return "Backlash", 1, {"BacklashWidth": f"{width}", "InitialOutput": f"{start}", "SampleTime": "0.1"}, rule

    def draw_conversion(self):
        kind = self.one_of(("double", "single")) if self.real is f32 else "double"
        own = f32 if kind == "single" else f64
        return "DataTypeConversion", 1, {"OutDataTypeStr": kind}, lambda v, m: own(v[0])

    def outputs(self, columns):
        """The values of all blocks over the samples, by name."""
        loops = {name: self.real(start) for name, start in self.starts.items()}
        memories = {name: {} for name, *_ in self.steps}
        rows = []
        with np.errstate(all="ignore"):
            for sample in zip(*(columns[name] for name in COLUMNS), strict=True):
                seen = {name: self.types[name](value) for name, value in zip(COLUMNS, sample, strict=True)} | loops
                for name, sources, rule in self.steps:
                    seen[name] = rule([seen[source] for source in sources], memories[name])
                loops = {state: seen[source] for state, source in self.loops.items()}
                rows.append([seen[name] for name, *_ in self.steps])
        return {
            name: np.array(row, dtype=float)
            for (name, *_), row in zip(self.steps, zip(*rows, strict=True), strict=True)
        }


def _common(values):
    """The type of a result of several operands."""
    return f64 if any(isinstance(value, f64) for value in values) else f32

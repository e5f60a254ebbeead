"""Random functions in C of floats, doubles and integers, with loops, branches, arrays, calls and static variables."""

import numpy as np

ARGUMENTS = {"u": "float", "v": "double", "n": "int"}
REALS, WHOLES = ("float", "double"), ("int", "uint8_t", "int16_t", "uint32_t")
FUNCTIONS = {
    "float": ("fabsf", "sqrtf", "floorf", "ceilf", "roundf", "truncf", "square", "fminf", "fmaxf", "fmodf", "blend"),
    "double": ("fabs", "sqrt", "floor", "ceil", "round", "trunc", "fmin", "fmax", "fmod"),
}
HEAD = """#include <math.h>
#include <stdint.h>
static const float gains[4] = {0.1f, -1.7f, 2.9, 0.333};
static float square(float x) { return x * x; }
static float blend(float x, double y) { if (x > y) return x - 0.1f * y; return x + 0.3f; }
"""


class Program:
    """The text of a function `double step(float u, double v, int n)`, drawn by chance."""

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.names = dict(ARGUMENTS)
        lines = []
        for at in range(3):
            kind = self.one_of((*REALS, "float", *WHOLES))
            start = f"{self.random.integers(0, 9)}" if kind in WHOLES else f"{self.random.normal():.3f}f"
            lines.append(f"static {kind} s{at} = {start};")
            self.names[f"s{at}"] = kind
        lines.append("float a[4] = {u, 0.7f, -1.1, n};")
        for _ in range(self.random.integers(5, 10)):
            lines += self.statement(2)
        shown = " + ".join(["(double)result", *(f"0.5 * s{at}" for at in range(3)), "a[n & 3]"])
        lines += [f"float result = {self.real(2)};", f"return {shown};"]
        self.text = HEAD + "double step(float u, double v, int n) {\n" + "".join(f"    {x}\n" for x in lines) + "}\n"

    def one_of(self, choices):
        return choices[self.random.integers(len(choices))]

    def statement(self, depth):
        choice = self.random.integers(0, 10 if depth else 6)
        if choice < 3:
            name = f"x{len(self.names)}"
            kind = self.one_of((*REALS, "float", *WHOLES))
            line = f"{kind} {name} = {self.number(kind)};"
            self.names[name] = kind
            return [line]
        if choice < 6:
            return [self.change()]
        outer = dict(self.names)
        if choice < 8:
            lines = [f"if ({self.condition()}) {{", *self.block(depth), "} else {"]
            self.names = dict(outer)
            lines += [*self.block(depth), "}"]
        else:
            counter = f"i{len(self.names)}"
            lines = [f"for (int {counter} = 0; {counter} < {self.random.integers(1, 4)}; {counter}++) {{"]
            lines += [f"a[{counter}] = a[{counter}] * 0.5f + {self.real(1)};", *self.block(depth), "}"]
        self.names = outer
        return lines

    def block(self, depth):
        return [line for _ in range(self.random.integers(1, 3)) for line in self.statement(depth - 1)]

    def change(self):
        """An assignment to a variable; real ones are limited, as a conversion of a large number is not defined."""
        names = [name for name in self.names if name not in ARGUMENTS]
        name = self.one_of(names)
        if self.names[name] in WHOLES:
            return f"{name} {self.one_of(('=', '+=', '^=', '-='))} {self.number(self.names[name])};"
        return f"{name} = {self.real(2)};"

    def number(self, kind):
        return self.whole(2) if kind in WHOLES else self.real(2)

    def named(self, kinds):
        return [name for name, kind in self.names.items() if kind in kinds]

    def condition(self):
        left, right = self.real(1), self.real(1)
        sign = self.one_of(("<", ">", "<=", ">=", "!="))
        more = f" {self.one_of(('&&', '||'))} {self.whole(1)} > {self.random.integers(-3, 9)}"
        return f"{left} {sign} {right}{more if self.random.random() < 0.4 else ''}"

    def whole(self, depth):
        choice = self.random.integers(0, 7 if depth else 2)
        names = self.named(WHOLES)
        if choice == 0 or not names:
            return f"{self.random.integers(0, 200)}"
        if choice == 1:
            return self.one_of(names)
        if choice == 2:
            return f"({self.one_of(('int', 'int16_t', 'uint8_t'))}){self.limited(depth - 1)}"
        if choice == 3:
            return f"({self.whole(depth - 1)} {self.one_of(('>>', '<<'))} {self.random.integers(0, 3)})"
        if choice == 4:
            return f"({self.whole(depth - 1)} {self.one_of(('/', '%'))} {self.random.integers(1, 9)})"
        return f"({self.whole(depth - 1)} {self.one_of(('+', '-', '*', '&', '|'))} {self.whole(depth - 1)})"

    def limited(self, depth):
        return f"fminf(fmaxf({self.real(depth)}, 0.0f), 100.0f)"

    def real(self, depth):
        choice = self.random.integers(0, 10 if depth else 3)
        if choice == 0:
            return f"{self.random.normal(0, 2):.3f}{self.one_of(('f', 'f', ''))}"
        if choice < 3:
            return self.one_of([*self.named(REALS), "gains[n & 3]", "a[2]", "u", "n"])
        if choice < 6:
            kind = self.one_of(REALS)
            name = self.one_of(FUNCTIONS[kind])
            count = 2 if name in ("fminf", "fmaxf", "fmodf", "blend", "fmin", "fmax", "fmod") else 1
            return f"{name}({', '.join(self.real(depth - 1) for _ in range(count))})"
        if choice == 6:
            return f"({self.condition_of(depth)} ? {self.real(depth - 1)} : {self.real(depth - 1)})"
        if choice == 7:
            return f"({self.one_of(REALS)})({self.real(depth - 1)})"
        return f"({self.real(depth - 1)} {self.one_of('+-*/')} {self.real(depth - 1)})"

    def condition_of(self, depth):
        return f"{self.real(depth - 1)} {self.one_of(('<', '>='))} {self.real(depth - 1)}"

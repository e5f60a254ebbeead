"""Random ESDL classes with the same class in Python beside them, as Hypothesis strategies."""

from dataclasses import dataclass
from functools import cache

from hypothesis import strategies as st

HEAD = """type Small is integer -20 .. 20;
type Curve is table real -> real;
type Map is table real, real -> real;
type Mode is enum { Off, Slow, Fast };

class Memory {
	real kept = 0.5;
	Small count = 0;
	public real step(real in x, boolean in on) {
		if (on) {
			count = count + 3;
			kept = x;
			return kept * 2.0;
		}
		kept = kept + 0.25;
		return kept;
	}
	public Small counted() { return count; }
}

class Own {
	characteristic real K = 1.5;
	characteristic real half <- "x / 2.0", x = K;
	characteristic Curve C[4] = { { -2.0, 0.0, 1.0, 4.0 }, { 1.0, -1.0, 3.0, 2.0 } };
	characteristic Map M[2][3] = { { 0.0, 2.0 }, { -1.0, 0.0, 3.0 }, { { 1.0, 2.0, 0.0 }, { 3.0, -1.0, 1.0 } } };
	characteristic integer N = 3;
	real a = 0.5;
	real b = -1.0;
	Small i = 2;
	Small j = -3;
	boolean p = false;
	boolean q = true;
	Mode mode = Mode.Slow;
	real v[3] = { 1.0, 2.0, 3.0 };
	Memory first;
	Memory second;
"""
ORACLE = """
import math
import numpy as np

def whole(x): return x + 0.0
def clip(x): return whole(max(min(x, 20), -20))
def cut(x): return float(math.trunc(x))
def div(x, y): return x if y == 0 else x / y
class Quotient(float):
    # cut off towards 0 unless it is converted to a real at once
    def __new__(cls, x, y):
        own = super().__new__(cls, cut(div(x, y)))
        own.exact = div(x, y)
        return own
def real(x): return x.exact if isinstance(x, Quotient) else x
def remainder(x, y): return 0.0 if y == 0 else x - cut(x / y) * y
def at(k): return int(max(min(k, 2), 0))
def C(x): return float(np.interp(x, [-2.0, 0.0, 1.0, 4.0], [1.0, -1.0, 3.0, 2.0]))
def M(x, y):
    z = np.array([[1.0, 2.0, 0.0], [3.0, -1.0, 1.0]])
    low, high = (float(np.interp(y, [-1.0, 0.0, 3.0], row)) for row in z)
    return float(np.interp(x, [0.0, 2.0], [low, high]))

class Memory:
    def __init__(self): self.kept, self.count = 0.5, 0.0
    def step(self, x, on):
        if on:
            self.count = clip(self.count + 3)
            self.kept = x
            return self.kept * 2.0
        self.kept = self.kept + 0.25
        return self.kept
    def counted(self): return self.count

class Own:
    def __init__(s):
        s.K, s.N, s.half = 1.5, 3.0, 0.75
        s.a, s.b, s.i, s.j, s.p, s.q, s.mode = 0.5, -1.0, 2.0, -3.0, False, True, 1
        s.v = [1.0, 2.0, 3.0]
        s.first, s.second = Memory(), Memory()
"""
NAMES = ("a", "b", "i", "j", "p", "q", "mode", "v")


@dataclass(frozen=True)
class Pair:
    """The same text in ESDL and in Python."""

    esdl: str
    python: str


def pair(esdl, python=None):
    return Pair(esdl, esdl if python is None else python)


def element(name):
    return Pair(name, f"s.{name}")


_QUARTERS = st.integers(-12, 12).map(lambda n: pair(f"({n / 4})" if n < 0 else f"{n / 4}"))
_WHOLE = st.integers(-5, 5).map(lambda n: pair(f"({n})" if n < 0 else f"{n}", f"({n}.0)"))


def join(form, python, *parts):
    return st.tuples(*parts).map(
        lambda items: Pair(form.format(*(x.esdl for x in items)), python.format(*(x.python for x in items)))
    )


@cache
def reals(depth):
    leaves = st.one_of(
        _QUARTERS,
        st.sampled_from([element(name) for name in ("a", "b", "K", "half")]),
        st.sampled_from([pair("x"), pair("y"), Pair("first.kept", "s.first.kept")]),
    )
    if depth == 0:
        return leaves
    inner, whole, truth = reals(depth - 1), integers(depth - 1), truths(depth - 1)
    return st.one_of(
        leaves,
        *(join(f"({{}} {op} {{}})", f"({{}} {op} {{}})", inner, inner) for op in "+-*"),
        join("({} / {})", "div({}, {})", inner, inner),
        *(join(f"{name}({{}}, {{}})", f"{name}({{}}, {{}})", inner, inner) for name in ("min", "max")),
        join("abs({})", "abs({})", inner),
        join("(-{})", "(-{})", inner),
        join("(if {} then {} else {})", "({1} if {0} else {2})", truth, inner, inner),
        whole.map(lambda item: Pair(f"real({item.esdl})", f"real({item.python})")),
        join("C.getAt({})", "C({})", inner),
        join("M.getAt({}, {})", "M({}, {})", inner, inner),
        join("v[{}]", "s.v[at({})]", whole),
        join("first.step({}, {})", "s.first.step({}, {})", inner, truth),
        join("second.step({}, {})", "s.second.step({}, {})", inner, truth),
    )


@cache
def integers(depth):
    leaves = st.one_of(_WHOLE, st.sampled_from([element(name) for name in ("i", "j", "N")]))
    if depth == 0:
        return leaves
    inner, truth = integers(depth - 1), truths(depth - 1)
    return st.one_of(
        leaves,
        *(join(f"({{}} {op} {{}})", f"({{}} {op} {{}})", inner, inner) for op in "+-*"),
        join("({} / {})", "Quotient({}, {})", inner, inner),
        join("({} % {})", "remainder({}, {})", inner, inner),
        join("(if {} then {} else {})", "whole({1} if {0} else {2})", truth, inner, inner),
        st.just(Pair("second.counted()", "s.second.counted()")),
    )


@cache
def truths(depth):
    leaves = st.sampled_from([element("p"), element("q"), pair("on"), Pair("true", "True")])
    if depth == 0:
        return leaves
    inner, real, whole = truths(depth - 1), reals(depth - 1), integers(depth - 1)
    return st.one_of(
        leaves,
        *(join(f"({{}} {op} {{}})", f"({{}} {op} {{}})", real, real) for op in ("<", "<=", ">", ">=")),
        *(join(f"({{}} {op} {{}})", f"({{}} {op} {{}})", whole, whole) for op in ("==", "!=", "<")),
        join("({} && {})", "({} and {})", inner, inner),
        join("({} || {})", "({} or {})", inner, inner),
        join("(!{})", "(not {})", inner),
        join("({} between {} and {})", "({1} <= {0} <= {2})", real, _QUARTERS, _QUARTERS),
        st.just(Pair("(mode == Mode.Fast)", "(s.mode == 2)")),
    )


@cache
def statements(depth):
    plain = st.one_of(
        *(join(f"{name} = {{}};", f"s.{name} = {{}}", reals(2)) for name in "ab"),
        *(join(f"{name} = {{}};", f"s.{name} = clip({{}})", integers(2)) for name in "ij"),
        *(join(f"{name} = {{}};", f"s.{name} = {{}}", truths(2)) for name in "pq"),
        join("a += {};", "s.a = s.a + {}", reals(1)),
        join("v[{}] = {};", "k = at({}); s.v[k] = {}", integers(1), reals(1)),
        st.sampled_from([Pair(f"mode = Mode.{n};", f"s.mode = {k}") for k, n in enumerate(("Off", "Slow", "Fast"))]),
    )
    plain = plain.map(lambda item: Pair(f"\t\t{item.esdl}\n", f"{item.python}\n"))
    if depth == 0:
        return plain
    block = blocks(depth - 1)
    return st.one_of(
        plain,
        st.tuples(truths(1), block, block).map(
            lambda t: Pair(
                f"\t\tif ({t[0].esdl}) {{\n{t[1].esdl}\t\t}} else {{\n{t[2].esdl}\t\t}}\n",
                f"if {t[0].python}:\n{indent(t[1].python)}else:\n{indent(t[2].python)}",
            )
        ),
        st.tuples(st.integers(0, 3), reals(1)).map(
            lambda t: Pair(
                f"\t\tfor (n in 0 .. {t[0]}) {{ b = b * 0.5 + {t[1].esdl}; v[n] = real(n) - b; }}\n",
                f"for n in range({t[0] + 1}):\n    s.b = s.b * 0.5 + {t[1].python}\n    s.v[at(n)] = n - s.b\n",
            )
        ),
        st.tuples(integers(1), block, block, block).map(
            lambda t: Pair(
                f"\t\tswitch ({t[0].esdl}) {{ case 0, 1 : {{\n{t[1].esdl}\t\t}} case 2 : {{\n{t[2].esdl}\t\t}} "
                f"default : {{\n{t[3].esdl}\t\t}} }}\n",
                f"subject = {t[0].python}\nif subject in (0, 1):\n{indent(t[1].python)}"
                f"elif subject == 2:\n{indent(t[2].python)}else:\n{indent(t[3].python)}",
            )
        ),
        st.tuples(truths(1), reals(1)).map(
            lambda t: Pair(
                f"\t\tif ({t[0].esdl}) {{ return {t[1].esdl}; }}\n", f"if {t[0].python}: return {t[1].python}\n"
            )
        ),
    )  # fmt: skip


@cache
def blocks(depth):
    return st.lists(statements(depth), min_size=1, max_size=3).map(
        lambda items: Pair("".join(x.esdl for x in items), "".join(x.python for x in items))
    )


def indent(text):
    return "".join(f"    {line}\n" for line in text.splitlines())


@st.composite
def programs(draw):
    """A class with a method `calc(x, y, on)`, and a function that runs the same method of a Python class."""
    body = draw(st.lists(statements(2), min_size=1, max_size=5))
    result = draw(reals(1))
    esdl = "".join(item.esdl for item in body)
    text = (
        f"{HEAD}\tpublic real calc(real in x, real in y, boolean in on) {{\n{esdl}\t\treturn {result.esdl};\n\t}}\n}}\n"
    )
    method = "def calc(s, x, y, on):\n" + indent("".join(item.python for item in body) + f"return {result.python}\n")
    return text, ORACLE + indent(method)


@dataclass(frozen=True)
class SeveralMethods:
    """A class with several public methods, the same class in Python, and those of its methods that a step calls."""

    text: str
    python: str
    called: tuple[str, ...]


@st.composite
def classes_of_methods(draw):
    """A class whose methods call each other, reset it, or only read it, in any order."""
    names = draw(st.permutations(["calc", "update", "report", "track"]))[: draw(st.integers(2, 4))]
    readers = draw(st.sets(st.sampled_from(["value", "isHigh"])))
    starters = draw(st.sets(st.sampled_from(["reset", "LIB_Init", "initAll"])))
    inner, written = set(), {}
    for at, name in enumerate(names):
        body = draw(st.lists(statements(1), min_size=1, max_size=2))
        # of the methods behind it alone, so that none calls itself
        callees = draw(st.sets(st.sampled_from(names[at + 1 :]), max_size=2)) if at + 1 < len(names) else ()
        inner |= {*callees}
        form = draw(st.sampled_from(["{}(x, y, on)", "this.{}(x, y, on)"]))
        calls = [Pair(f"\t\ta = a + {form.format(own)};\n", f"s.a = s.a + s.{own}(x, y, on)\n") for own in callees]
        if readers and draw(st.booleans()):
            own = draw(st.sampled_from(sorted(readers)))
            calls.append(Pair(f"\t\tb = {own}(x, y, on);\n", f"s.b = s.{own}(x, y, on)\n"))
        written[name] = (*calls, *body), draw(reals(1))
    for name in sorted(readers):
        written[name] = (), pair("(a * 2.0)", "(s.a * 2.0)")
    for name in sorted(starters):
        # what it calls is not called by a step
        callee = draw(st.sampled_from([*names, *sorted(readers)]))
        written[name] = (Pair(f"\t\ta = 7.0 + {callee}(x, y, on);\n", "s.a = 7.0\n"),), pair("1.0")
    order = draw(st.permutations(list(written)))
    text, python = HEAD, ORACLE
    for name in order:
        body, result = written[name]
        esdl = "".join(item.esdl for item in body)
        head = "@no_side_effect public" if name in readers else "public"
        text += f"\t{head} real {name}(real in x, real in y, boolean in on) {{\n{esdl}\t\treturn {result.esdl};\n\t}}\n"
        lines = "".join(item.python for item in body) + f"return {result.python}\n"
        python += indent(f"def {name}(s, x, y, on):\n{indent(lines)}")
    called = tuple(name for name in order if name not in inner | starters)
    return SeveralMethods(text + "}\n", python, called)


def run_oracle(code, columns, methods=("calc",)):
    """The values of all elements after each step, and the results of the methods that it calls, by name."""
    names = {}
    exec(code, names)
    own = names["Own"]()
    rows = []
    for x, y, on in zip(columns["x"], columns["y"], columns["on"], strict=True):
        results = [getattr(own, method)(x, y, bool(on)) for method in methods]
        rows.append(
            [*results, own.a, own.b, own.i, own.j, own.p, own.q, own.mode, *own.v, own.first.kept, own.second.count]
        )
    order = (*methods, "a", "b", "i", "j", "p", "q", "mode", "v[0]", "v[1]", "v[2]", "first.kept", "second.count")
    return dict(zip(order, zip(*rows, strict=True), strict=True))

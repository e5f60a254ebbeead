"""LLVM IR of the elementwise operations, to agree with `graph.operations` bit for bit where IEEE 754 allows."""

from collections.abc import Callable

from kennfeld.native.ir import Function, literal

__all__ = ["CONDITIONS", "VALUES", "power"]

ONE, HALF, ZERO = literal(1.0), literal(0.5), literal(0.0)


def _binary(instruction: str) -> Callable[..., str]:
    return lambda f, a, b: f.new(f"{instruction} contract double {a}, {b}")


def _call(name: str) -> Callable[..., str]:
    def emit(f: Function, *args: str) -> str:
        return f.new(f"call double @{name}({', '.join('double ' + a for a in args)})")

    return emit


def _extreme(comparison: str) -> Callable[..., str]:
    """The first argument where it wins, ties or is NaN, else the second; NaN if either is."""

    def emit(f: Function, a: str, b: str) -> str:
        first = f.select(f.new(f"fcmp {comparison} double {a}, {b}"), a, b)
        return f.select(f.new(f"fcmp uno double {b}, {b}"), b, first)

    return emit


def _mod(f: Function, a: str, b: str) -> str:
    whole = f.new(f"call double @llvm.floor.f64(double {f.new(f'fdiv double {a}, {b}')})")
    rest = f.new(f"fsub double {a}, {f.new(f'fmul double {whole}, {b}')}")
    return f.select(f.new(f"fcmp oeq double {b}, {ZERO}"), a, rest)


def _guard(f: Function, a: str, b: str) -> str:
    return f.select(f.new(f"fcmp oeq double {a}, {ZERO}"), ZERO, f.fmul(a, b))


def _round(f: Function, x: str) -> str:
    whole = f.new(f"call double @llvm.trunc.f64(double {x})")
    rest = f.new(f"call double @llvm.fabs.f64(double {f.new(f'fsub double {x}, {whole}')})")
    away = f.new(f"fadd double {whole}, {f.new(f'call double @llvm.copysign.f64(double {ONE}, double {x})')}")
    return f.select(f.new(f"fcmp oge double {rest}, {HALF}"), away, whole)


def _sign(f: Function, x: str) -> str:
    unit = f.new(f"call double @llvm.copysign.f64(double {ONE}, double {x})")
    return f.select(f.new(f"fcmp one double {x}, {ZERO}"), unit, x)


def power(f: Function, base: str, exponent: int) -> str:
    """A whole power by repeated squaring."""
    if exponent < 0:
        return f.new(f"fdiv double {ONE}, {power(f, base, -exponent)}")
    result, square = "", base
    while exponent:
        if exponent & 1:
            result = f.fmul(result, square) if result else square
        exponent >>= 1
        square = f.fmul(square, square) if exponent else square
    return result or ONE


_C_LIBRARY = (
    "exp", "log", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "pow",
)  # fmt: skip

VALUES: dict[str, Callable[..., str]] = {
    "add": _binary("fadd"),
    "sub": _binary("fsub"),
    "mul": _binary("fmul"),
    "div": _binary("fdiv"),
    "guard": _guard,
    "mod": _mod,
    "min": _extreme("ule"),
    "max": _extreme("uge"),
    "neg": lambda f, x: f.new(f"fneg double {x}"),
    "round": _round,
    "sign": _sign,
    "abs": _call("llvm.fabs.f64"),
    **{name: _call(f"llvm.{name}.f64") for name in ("sqrt", "floor", "ceil")},
    **{name: _call(f"kf_{name}") for name in _C_LIBRARY},
}

# Comparisons give an i1; all are false for NaN except `ne`.
CONDITIONS: dict[str, str] = {"lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge", "eq": "oeq", "ne": "une"}

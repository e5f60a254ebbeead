"""LLVM IR of the elementwise operations; agrees with `graph.operations` bit for bit if IEEE 754 defines the result.

Sums are therefore not fused with products, whatever the processor offers: a simulation is the same on all of them, and
the same as that of exported C code. Elementary functions are those of the C library.
"""

from collections.abc import Callable

from kennfeld.base.machine_code.external import c_pointer
from kennfeld.base.machine_code.ir import HALF, ONE, ZERO, FunctionWriter, literal

ELEMENTARY = frozenset(
    {
        *("exp", "log", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
        *("sinh", "cosh", "tanh", "pow", "erf", "erfc"),
    }
)

# Comparisons give an i1; all are false for NaN except `ne`.
CONDITIONS: dict[str, str] = {"lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge", "eq": "oeq", "ne": "une"}


def _binary(instruction: str) -> Callable[..., str]:
    return lambda f, a, b: f.new(f"{instruction} double {a}, {b}")


def _intrinsic(name: str) -> Callable[..., str]:
    return lambda f, x: f.new(f"call double @llvm.{name}.f64(double {x})")


def _elementary(name: str) -> Callable[..., str]:
    def emit(f: FunctionWriter, *arguments: str) -> str:
        operands = ", ".join(f"double {argument}" for argument in arguments)
        return f.new(f"call double {c_pointer(f, name)}({operands}) nounwind memory(none)")

    return emit


def _extreme(comparison: str) -> Callable[..., str]:
    """Return the first argument if it wins, ties or is NaN, else the second; NaN if either is NaN."""

    def emit(f: FunctionWriter, a: str, b: str) -> str:
        # unordered comparisons (`ule`, `uge`) are true for NaN, so that a NaN in a wins; one in b is selected below
        first = f.select(f.new(f"fcmp {comparison} double {a}, {b}"), a, b)
        return f.select(f.new(f"fcmp uno double {b}, {b}"), b, first)

    return emit


def _mod(f: FunctionWriter, a: str, b: str) -> str:
    """Return the remainder with the sign of the divisor; the dividend if the divisor is zero."""
    whole = f.new(f"call double @llvm.floor.f64(double {f.new(f'fdiv double {a}, {b}')})")
    rest = f.new(f"fsub double {a}, {f.new(f'fmul double {whole}, {b}')}")
    return f.select(f.new(f"fcmp oeq double {b}, {ZERO}"), a, rest)


def guarded_product(f: FunctionWriter, a: str, b: str) -> str:
    """Return a product that is 0 if its first factor is 0: a branch not taken, or a grid point of weight 0."""
    return f.select(f.new(f"fcmp oeq double {a}, {ZERO}"), ZERO, f.fmul(a, b))


def _abs(f: FunctionWriter, x: str) -> str:
    # LLVM needs ten times as long for its own fabs in long code, and makes one of this in short code
    bits = f.new(f"and i64 {f.new(f'bitcast double {x} to i64')}, {2**63 - 1}")
    return f.new(f"bitcast i64 {bits} to double")


def _round(f: FunctionWriter, x: str) -> str:
    """Round to the nearest integer; halves away from zero."""
    # not trunc(x + 0.5): the largest double below 0.5 would become 1
    whole = f.new(f"call double @llvm.trunc.f64(double {x})")
    rest = f.new(f"call double @llvm.fabs.f64(double {f.new(f'fsub double {x}, {whole}')})")
    away = f.new(f"fadd double {whole}, {f.new(f'call double @llvm.copysign.f64(double {ONE}, double {x})')}")
    return f.select(f.new(f"fcmp oge double {rest}, {HALF}"), away, whole)


def _sign(f: FunctionWriter, x: str) -> str:
    # ordered comparisons are false for 0, -0 and NaN, which stay as they are
    above = f.select(f.new(f"fcmp ogt double {x}, {ZERO}"), ONE, x)
    return f.select(f.new(f"fcmp olt double {x}, {ZERO}"), literal(-1.0), above)


def _single(f: FunctionWriter, x: str) -> str:
    return f.new(f"fpext float {f.new(f'fptrunc double {x} to float')} to double")


def power(f: FunctionWriter, base: str, exponent: int) -> str:
    """Compute an integer power by repeated squaring."""
    if exponent < 0:
        return f.new(f"fdiv double {ONE}, {power(f, base, -exponent)}")
    result, square = "", base
    while exponent:
        if exponent & 1:
            result = f.fmul(result, square) if result else square
        exponent >>= 1
        square = f.fmul(square, square) if exponent else square
    return result or ONE


VALUES: dict[str, Callable[..., str]] = {
    "add": _binary("fadd"),
    "sub": _binary("fsub"),
    "mul": _binary("fmul"),
    "div": _binary("fdiv"),
    "guard": guarded_product,
    "mod": _mod,
    "min": _extreme("ule"),
    "max": _extreme("uge"),
    "neg": lambda f, x: f.new(f"fneg double {x}"),
    "round": _round,
    "sign": _sign,
    "abs": _abs,
    "single": _single,
    **{name: _intrinsic(name) for name in ("sqrt", "floor", "ceil")},
    **{name: _elementary(name) for name in sorted(ELEMENTARY)},
}

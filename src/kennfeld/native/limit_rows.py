"""Bounds and sparse rows in compiled code: those that a step violates, and the rows of a dual program.

A limit is lower <= a'p <= upper. A bound on a value is a limit whose a has a single 1; the bounds come first. Rounding
counts as no violation: FEASIBLE times the size of the terms that are summed, and of the room up to the limit.
"""

from functools import cache

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.ir import LANES, ZERO, FunctionWriter, literal
from kennfeld.native.addresses import INT64, address

FEASIBLE = 1e-12  # violation of a limit relative to its scale that counts as rounding
UPPER, LOWER = 1, 2  # bits: the sides of a limit that are taken into the program

INFINITE = literal(float("inf"))
LIMITS = (
    *(("ptr", "lower"), ("ptr", "upper"), ("ptr", "columns"), ("ptr", "coefficients")),
    *(("i64", "values"), ("i64", "limits"), ("i64", "width")),
)
STEP = (("ptr", "at"), ("ptr", "step"))
CHOSEN = (("ptr", "numbers"), ("ptr", "signs"), ("ptr", "excess"), ("ptr", "places"), ("ptr", "entries"))


class ChosenLimits:
    """Limits, and those of them in a dual program: the equalities, then what steps violate.

    The memory is used again for each step. Of each chosen limit there is its number, the sign of its side, its row of A
    with that sign, and its violation by the free step.

    Args:
        lower, upper: the sides of all limits, Float[values + rows]; bounds come first.
        columns, coefficients: of the rows, (rows, width); those that touch fewer values are filled up with zeros.
    """

    def __init__(self, lower: Float, upper: Float, columns: Int, coefficients: Float) -> None:
        self.total, self._values = lower.size, lower.size - len(columns)
        self._sides = [np.require(side, np.float64, ["C", "A"]) for side in (lower, upper)]
        self._rows = np.require(columns, np.int64, ["C", "A"]), np.require(coefficients, np.float64, ["C", "A"])
        rows = (address(self._rows[0], kind=INT64), address(self._rows[1], columns.size))
        pointers = (*(address(side, self.total) for side in self._sides), *rows)
        self._limits = (*pointers, self._values, self.total, columns.shape[1])
        self._equal = np.where(lower == upper, UPPER | LOWER, 0)
        # a value between equal bounds is not movable and has no column here
        self._equal[: self._values] = 0
        self.equalities, self.count = int(np.count_nonzero(self._equal)), 0
        self._marks, self._taken, self._counts = (
            np.zeros(size, dtype=np.int64) for size in (self.total, self.total, 1)
        )
        self._marked = (address(self._taken, kind=INT64), address(self._marks, kind=INT64))
        self._counted = address(self._counts, kind=INT64)
        self._lists = _Lists(self.equalities + LANES, max(columns.shape[1], 1))

    def restart(self, at: Float, free_step: Float) -> None:
        """Choose none, for a step from the values `at`, given the step without limits; Float[values] each."""
        self._point = at, free_step
        self._at, self._free_step = address(at, self._values), address(free_step, self._values)
        self._step, self._stepped = free_step, self._free_step
        self._taken[:] = self._equal
        self.count = 0

    def violated(self, step: Float) -> int:
        """Mark limits not chosen that a step, Float[values], violates by more than rounding; return their number."""
        _functions()["violated"](*self._limits, *self._place(step), *self._marked, self._counted)
        return int(self._counts[0])

    def mark(self, signs: Int) -> int:
        """Mark the limits with `signs` != 0, Int[limits]; return their number."""
        self._marks[:] = signs
        return int(np.count_nonzero(signs))

    def choose(self, marked: int) -> tuple[Int, Float]:
        """Add the marked limits with a finite side, `marked` at most; with the first ones, the equalities.

        Returns:
            Columns and coefficients of the new rows of A, (new, width).
        """
        first, equalities = self.count, 0 if self.count else self.equalities
        if first + equalities + marked > self._lists.room:
            self._lists = self._lists.enlarged(first, 2 * (first + equalities + marked))
        lists = self._lists
        self._counts[0] = first
        point = (self._at, self._free_step, *self._marked)
        _functions()["choose"](*self._limits, *point, *lists.pointers, equalities, lists.width, self._counted)
        self.count = int(self._counts[0])
        return lists.columns[first : self.count], lists.coefficients[first : self.count]

    @property
    def excess(self) -> Float:
        """Violation of each chosen limit by the free step, Float[chosen]."""
        return self._lists.excess[: self.count]

    def active(self, pressing: Bool) -> Int:
        """Return for each limit the sign of its side, Int[limits], if it is a chosen one that presses, else 0."""
        signs = np.zeros(self.total, dtype=np.int64)
        signs[self._lists.numbers[: self.count][pressing]] = self._lists.signs[: self.count][pressing]
        return signs

    def product(self, multipliers: Float, step: Float) -> float:
        """Compute m'A d for multipliers m of the chosen limits, Float[chosen], and a step d, Float[values]."""
        columns, coefficients = self._lists.columns[: self.count], self._lists.coefficients[: self.count]
        return float(multipliers @ np.einsum("ij,ij->i", coefficients, step[columns]))

    def violation(self, step: Float, holding: Int) -> tuple[Float, bool]:
        """Return by how much a step violates the chosen limits that hold, and True if none does by more than rounding.

        Args:
            step: Float[values].
            holding: 1 for limits that hold, else 0; set to 1 for those that are violated, Int[chosen].
        """
        lists = self._lists
        chosen = (*lists.pointers[:2], self.count, address(holding, self.count, INT64), lists.violated)
        _functions()["exceed"](*self._limits, *self._place(step), *chosen, self._counted)
        return lists.violation[: self.count], not self._counts[0]

    def _place(self, step: Float) -> tuple[int, int]:
        """The arguments `STEP` of generated code."""
        # one step is judged several times, and its address taken once
        if step is not self._step:
            self._step, self._stepped = step, address(step, self._values)
        return self._at, self._stepped


class _Lists:
    """Memory for the chosen limits."""

    def __init__(self, room: int, width: int) -> None:
        self.room, self.width = room, width
        self.numbers, self.signs = np.zeros((2, room), dtype=np.int64)
        self.excess, self.violation = np.zeros((2, room))
        self.columns, self.coefficients = np.zeros((room, width), dtype=np.int64), np.zeros((room, width))
        numbers, entries = (self.numbers, self.signs, self.columns), (self.excess, self.coefficients, self.violation)
        number, sign, column = (address(array, kind=INT64) for array in numbers)
        excess, coefficient, self.violated = (address(array) for array in entries)
        self.pointers = (number, sign, excess, column, coefficient)  # the arguments `CHOSEN` of generated code

    def enlarged(self, count: int, room: int) -> "_Lists":
        """Return a copy of the first `count` limits with room for more."""
        other = _Lists(room, self.width)
        for name in ("numbers", "signs", "excess", "columns", "coefficients"):
            getattr(other, name)[:count] = getattr(self, name)[:count]
        return other


@cache
def _functions() -> dict[str, NativeFunction]:
    return compile_functions(_violated(), _choose(), _exceed())


def _product(f: FunctionWriter, vector: str, number: str) -> tuple[str, str]:
    """Return the product of a limit with a vector, and the sum of the sizes of its terms."""
    total, size = f.variable("double", ZERO), f.variable("double", ZERO)
    bound = f.new(f"icmp slt i64 {number}, %values")
    with f.when(bound):
        total.set(f.load(vector, number))
    with f.unless(bound):
        row = f.mul(f.new(f"sub i64 {number}, %values"), "%width")
        with f.loop(0, "%width") as k:
            entry = f.add(row, k)
            term = f.fmul(f.load("%coefficients", entry), f.load(vector, f.load("%columns", entry, "i64")))
            total.set(f.fadd(total.get(), term))
            size.set(f.fadd(size.get(), _abs(f, term)))
    # a bound has one term
    return total.get(), f.select(bound, _abs(f, total.get()), size.get())


def _violation(f: FunctionWriter, number: str, sign: str) -> tuple[str, str]:
    """Return by how much a step violates the upper (sign 1) or lower (-1) side of a limit, and its rounding error."""
    (here, size), (change, length) = _product(f, "%at", number), _product(f, "%step", number)
    upper = f.new(f"icmp sgt i64 {sign}, 0")
    # beyond = a'd - (side - a'p), and its negative for a lower side
    room = f.new(f"fsub double {_side(f, number, upper)}, {here}")
    beyond = f.new(f"fsub double {change}, {room}")
    scale = f.fadd(f.fadd(_finite_size(f, room), size), f.fadd(length, literal(1e-300)))
    return f.select(upper, beyond, f.new(f"fneg double {beyond}")), f.fmul(literal(FEASIBLE), scale)


def _side(f: FunctionWriter, number: str, upper: str) -> str:
    return f.select(upper, f.load("%upper", number), f.load("%lower", number))


def _abs(f: FunctionWriter, x: str) -> str:
    return f.new(f"call double @llvm.fabs.f64(double {x})")


def _finite_size(f: FunctionWriter, x: str) -> str:
    size = _abs(f, x)
    return f.select(f.new(f"fcmp olt double {size}, {INFINITE}"), size, ZERO)


def _violated() -> FunctionWriter:
    """Write `violated(limits, step, taken, marks, counts)`: mark violated sides that are not taken, and count them."""
    f = FunctionWriter("violated", [*LIMITS, *STEP, ("ptr", "taken"), ("ptr", "marks"), ("ptr", "counts")])
    total = f.variable("i64", "0")
    with f.loop(0, "%limits") as i:
        mark, taken = f.variable("i64", "0"), f.load("%taken", i, "i64")
        for sign, side in ((-1, LOWER), (1, UPPER)):
            beyond, rounding = _violation(f, i, str(sign))
            wrong = f.new(f"fcmp ogt double {beyond}, {rounding}")
            # one side of a limit may be in the program while a step violates the other one
            other = f.new(f"icmp eq i64 {f.new(f'and i64 {taken}, {side}')}, 0")
            with f.when(f.new(f"and i1 {wrong}, {other}")):
                mark.set(str(sign))
        f.store(mark.get(), "%marks", i, "i64")
        marked = f.new(f"icmp ne i64 {mark.get()}, 0")
        total.set(f.add(total.get(), f.new(f"zext i1 {marked} to i64")))
    f.store(total.get(), "%counts", kind="i64")
    return f


def _choose() -> FunctionWriter:
    """Write `choose(limits, step, taken, marks, lists, equalities, stride, counts)`: append them and marked limits."""
    marks, more = (("ptr", "taken"), ("ptr", "marks")), (("i64", "equalities"), ("i64", "stride"), ("ptr", "counts"))
    f = FunctionWriter("choose", [*LIMITS, *STEP, *marks, *CHOSEN, *more])
    with f.when(f.new("icmp ne i64 %equalities, 0")), f.loop("%values", "%limits") as i:
        both = f.new(f"icmp eq i64 {f.load('%taken', i, 'i64')}, {UPPER | LOWER}")
        with f.when(both):
            _append(f, i, "1")
    with f.loop(0, "%limits") as i:
        mark = f.load("%marks", i, "i64")
        with f.when(f.new(f"icmp ne i64 {mark}, 0")):
            upper = f.new(f"icmp sgt i64 {mark}, 0")
            bit = f.new(f"select i1 {upper}, i64 {UPPER}, i64 {LOWER}")
            taken = f.load("%taken", i, "i64")
            new = f.new(f"icmp eq i64 {f.new(f'and i64 {taken}, {bit}')}, 0")
            # a guess, unlike a violation, may name an infinite side
            finite = f.new(f"fcmp olt double {_abs(f, _side(f, i, upper))}, {INFINITE}")
            with f.when(f.new(f"and i1 {new}, {finite}")):
                f.store(f.new(f"or i64 {taken}, {bit}"), "%taken", i, "i64")
                _append(f, i, f.new(f"select i1 {upper}, i64 1, i64 -1"))
    return f


def _append(f: FunctionWriter, i: str, sign: str) -> None:
    """Write the end of the lists: number, sign, excess and row of a limit."""
    place = f.load("%counts", kind="i64")
    f.store(f.add(place, 1), "%counts", kind="i64")
    f.store(i, "%numbers", place, "i64")
    f.store(sign, "%signs", place, "i64")
    # by the free step, which `%step` is here
    f.store(_violation(f, i, sign)[0], "%excess", place)
    factor = f.new(f"sitofp i64 {sign} to double")
    target = f.mul(place, "%stride")
    bound = f.new(f"icmp slt i64 {i}, %values")
    with f.when(bound):
        # a bound is a row with one entry, filled up to the width of the rows
        with f.loop(1, "%stride") as k:
            f.store(ZERO, "%entries", f.add(target, k))
        f.store(i, "%places", target, "i64")
        f.store(factor, "%entries", target)
    with f.unless(bound):
        row = f.mul(f.new(f"sub i64 {i}, %values"), "%width")
        with f.loop(0, "%width") as k:
            source, entry = f.add(row, k), f.add(target, k)
            f.store(f.load("%columns", source, "i64"), "%places", entry, "i64")
            f.store(f.fmul(factor, f.load("%coefficients", source)), "%entries", entry)


def _exceed() -> FunctionWriter:
    """Write `exceed(limits, step, numbers, signs, count, holding, violation, counts)`: see `ChosenLimits.violation`."""
    lists = (("ptr", "numbers"), ("ptr", "signs"), ("i64", "count"))
    f = FunctionWriter("exceed", [*LIMITS, *STEP, *lists, ("ptr", "holding"), ("ptr", "violation"), ("ptr", "counts")])
    total = f.variable("i64", "0")
    with f.loop(0, "%count") as j:
        beyond, rounding = _violation(f, f.load("%numbers", j, "i64"), f.load("%signs", j, "i64"))
        with f.when(f.new(f"fcmp ogt double {beyond}, {rounding}")):
            f.store("1", "%holding", j, "i64")
        holds = f.new(f"icmp ne i64 {f.load('%holding', j, 'i64')}, 0")
        rest = f.select(holds, beyond, ZERO)
        f.store(rest, "%violation", j)
        # unordered: a step that is not finite is wrong
        wrong = f.new(f"fcmp ugt double {_abs(f, rest)}, {rounding}")
        total.set(f.add(total.get(), f.new(f"zext i1 {wrong} to i64")))
    f.store(total.get(), "%counts", kind="i64")
    return f

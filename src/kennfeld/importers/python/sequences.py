"""Translation of lists and tuples of Python, whose lengths must be known, and of functions that take them."""

import ast
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import reduce
from itertools import pairwise
from typing import Final

from kennfeld.importers.python.expressions import NumberTranslation, fold
from kennfeld.importers.python.reading import number_of
from kennfeld.importers.python.scope import (
    NumberKind,
    UntranslatableError,
    element_name,
    merged_kind,
    untranslated,
)
from kennfeld.program import tree as m

_MAX_ELEMENTS: Final = 2000
_ARRAYS: Final = (("numpy", "array"), ("numpy", "asarray"), ("builtins", "list"), ("builtins", "tuple"))
# not math.fsum, which is exact however much its terms cancel
_SUMS: Final = (("builtins", "sum"), ("numpy", "sum"))
_EXTREMES: Final = {
    ("builtins", "min"): "py:min", ("builtins", "max"): "py:max", ("numpy", "min"): "py:minimum",
    ("numpy", "max"): "py:maximum", ("numpy", "amin"): "py:minimum", ("numpy", "amax"): "py:maximum",
}  # fmt: skip
_ENDS: Final = {"left", "right"}
_NAMES: Final = ("list", "tuple", "any", "all", "sum", "len", "range", "zip", "enumerate", "reversed")


class SequenceTranslation(NumberTranslation):
    """Translates lists: one expression for each element."""

    def elements(self, tree: ast.expr) -> list[m.Expression] | None:
        """Return the elements of a list; None if an expression is none, or its length is not known."""
        items = self._elements(tree)
        if items is not None and len(items) > _MAX_ELEMENTS:
            raise UntranslatableError(f"a list of {len(items)} elements, more than {_MAX_ELEMENTS}", tree.lineno)
        return items

    def _elements(self, tree: ast.expr) -> list[m.Expression] | None:
        match tree:
            case ast.List(elts=items) | ast.Tuple(elts=items):
                return None if any(isinstance(item, ast.Starred) for item in items) else [*map(self.value, items)]
            case ast.Name(id=name) if name in self.scope.lists:
                return [m.Name(element_name(name, at)) for at in range(self.scope.lists[name])]
            case ast.Name(id=name) if name in self.source.lists and not self.scope.is_local(name):
                return [m.Number(number) for number in self.source.lists[name]]
            case ast.Subscript(value=ast.Name(id=name), slice=place) if rows := self._table(name):
                at = self._integer(place)
                return rows[at] if at is not None and -len(rows) <= at < len(rows) else None
            case ast.Subscript(value=of, slice=ast.Slice() as part):
                return self._part(self.elements(of), part)
            case ast.ListComp(elt=item, generators=[each]) | ast.GeneratorExp(elt=item, generators=[each]):
                return self._comprehension(item, each)
            case ast.BinOp(left=left, op=ast.Add(), right=right) if isinstance(left, ast.List | ast.Name):
                a, b = self.elements(left), self.elements(right)
                return None if a is None or b is None else a + b
            case ast.Call(func=function, args=[argument], keywords=[]) if self._library_name(function) in _ARRAYS:
                return self.elements(argument)
        return None

    def _table(self, name: str) -> list[list[m.Expression]]:
        """Return the rows of a list of lists outside of functions; none for other names."""
        rows: list[list[m.Expression]] = []
        while not self.scope.is_local(name) and (label := f"{name}[{len(rows)}]") in self.source.lists:
            rows.append([m.Number(number) for number in self.source.lists[label]])
        return rows

    def element_kind(self, tree: ast.expr) -> NumberKind:
        """See `NumberTranslation`."""
        match tree:
            case ast.List(elts=items) | ast.Tuple(elts=items):
                return merged_kind(map(self.kind, items)) if items else "integer"
            case ast.Name(id=name) if name in self.scope.lists:
                names = [element_name(name, at) for at in range(self.scope.lists[name])]
                return merged_kind(self.scope.kinds.get(each, "float") for each in names)
            case ast.Name(id=name):
                return "numpy" if name in self.source.arrays and not self.scope.is_local(name) else "float"
            case ast.Subscript(value=of):
                return self.element_kind(of)
            case ast.BinOp(left=left, right=right):
                return merged_kind([self.element_kind(left), self.element_kind(right)])
            case ast.ListComp(elt=item, generators=[each]) | ast.GeneratorExp(elt=item, generators=[each]):
                before = dict(self.scope.kinds)
                self.scope.kinds |= self.kinds_of_targets(each.target, each.iter)
                kind, self.scope.kinds = self.kind(item), before
                return kind
            case ast.Call(func=function, args=[argument, *_]):
                if self._library_name(function)[0] == "numpy":
                    return "numpy"
                return "integer" if self._library_name(function)[1] == "range" else self.element_kind(argument)
        return "float"

    def kinds_of_targets(self, target: ast.expr, rows: ast.expr) -> dict[str, NumberKind]:
        """Return which kinds of numbers the names of a loop hold."""
        names = [
            item.id
            for item in (target.elts if isinstance(target, ast.Tuple) else [target])
            if isinstance(item, ast.Name)
        ]
        kinds: list[NumberKind] = [self.element_kind(rows)]
        if isinstance(rows, ast.Call):
            name = self._library_name(rows.func)[1]
            if name == "zip":
                kinds = [self.element_kind(argument) for argument in rows.args]
            elif name == "enumerate":
                kinds = ["integer", *kinds]
        return dict(zip(names, kinds, strict=False))

    def _part(self, items: list[m.Expression] | None, part: ast.Slice) -> list[m.Expression] | None:
        ends = [None if end is None else number_of(end, {}) for end in (part.lower, part.upper, part.step)]
        known = all((end is None) == (number is None) for end, number in zip(_ends(part), ends, strict=True))
        if items is None or not known or ends[2] == 0:
            return None
        # Python computes all elements before it cuts: those that may fail are computed with the first that is kept
        chosen = range(len(items))[slice(*(None if number is None else int(number) for number in ends))]
        skipped = [item for at, item in enumerate(items) if at not in chosen]
        if not chosen and any(map(_may_fail, skipped)):
            return None
        return [_after(skipped if at == 0 else (), items[place]) for at, place in enumerate(chosen)]

    def _comprehension(self, item: ast.expr, each: ast.comprehension) -> list[m.Expression] | None:
        rows = None if each.ifs or each.is_async else self.rows(each.iter)
        if rows is None:
            return None
        result = []
        for row in rows:
            with self._bound(each.target, row):
                self.scope.kinds |= self.kinds_of_targets(each.target, each.iter)
                result.append(_after(row, self.value(item)))
        return result

    @contextmanager
    def _bound(self, target: ast.expr, row: Sequence[m.Expression]) -> Iterator[None]:
        """Let the names of a target stand for expressions."""
        before, kinds = self.scope.fixed, dict(self.scope.kinds)
        self.scope.fixed = before | dict(zip(target_names(target, len(row)), row, strict=True))
        try:
            yield
        finally:
            self.scope.fixed, self.scope.kinds = before, kinds

    def rows(self, tree: ast.expr) -> list[tuple[m.Expression, ...]] | None:
        """Return the rows over which a loop runs: of single elements, or of pairs for `zip` and `enumerate`."""
        if isinstance(tree, ast.Call) and not tree.keywords:
            parts = [self.elements(argument) for argument in tree.args]
            lists = [part for part in parts if part is not None]
            match self._library_name(tree.func)[1], lists:
                case "range", _ if ends := self._constant_ends(tree.args):
                    return [(m.Number(float(at)),) for at in range(*ends)]
                case "zip", [_, *_] if len(lists) == len(parts):
                    rows = list(zip(*lists, strict=False))
                    # Python has computed what `zip` leaves out, and has stopped if that failed
                    is_cut = any(_may_fail(item) for items in lists for item in items[len(rows) :])
                    return None if is_cut else rows
                case "enumerate", [items] if len(parts) == 1:
                    return [(m.Number(float(at)), item) for at, item in enumerate(items)]
                case "reversed", [items]:
                    return [(item,) for item in reversed(items)]
        column = self.elements(tree)
        return None if column is None else [(item,) for item in column]

    def _constant_ends(self, arguments: Sequence[ast.expr]) -> list[int]:
        """Return the arguments of a `range` of a known length; empty if it is not known."""
        numbers = [self._integer(argument) for argument in arguments]
        known = [number for number in numbers if number is not None]
        is_range = len(known) == len(numbers) and 0 < len(known) < 4 and known[2:] != [0]
        return known if is_range and len(range(*known)) <= _MAX_ELEMENTS else []

    def _integer(self, tree: ast.expr) -> int | None:
        if isinstance(tree, ast.Call) and self._library_name(tree.func)[1] == "len" and len(tree.args) == 1:
            items = self.elements(tree.args[0])
            return None if items is None or any(map(_may_fail, items)) else len(items)
        match tree:
            case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
                a, b = self._integer(left), self._integer(right)
                if a is None or b is None:
                    return None
                return a + b if isinstance(op, ast.Add) else a - b
        is_hidden = isinstance(tree, ast.Name) and self.scope.is_local(tree.id)
        number = None if is_hidden else number_of(tree, self.source.constants)
        return None if number is None or number != int(number) else int(number)

    def _library_name(self, tree: ast.expr) -> tuple[str, str]:
        """Return a function of a library, those of Python that take lists among them."""
        if isinstance(tree, ast.Name) and tree.id in _NAMES and tree.id not in self.source.modules:
            is_own = self.scope.is_local(tree.id) or tree.id in self.source.functions
            return ("", "") if is_own else ("builtins", tree.id)
        return self.qualified(tree)

    def element(self, tree: ast.Subscript) -> m.Expression:
        """See `NumberTranslation`; an index out of range, where Python raises an exception, gives NaN."""
        items = self.elements(tree.value)
        if items is None and isinstance(tree.value, ast.Subscript) and isinstance(tree.value.value, ast.Name):
            rows = self._table(tree.value.value.id)
            if rows and not isinstance(tree.slice, ast.Slice | ast.Tuple):
                column = self.value(tree.slice)
                within = [m.Call(m.Name("py:element"), (column, *row)) for row in rows]
                if len({len(row) for row in rows}) == 1:  # of rows of unequal lengths, an index may be wrong in some
                    return m.Call(m.Name("py:element"), (self.value(tree.value.slice), *within))
        if items is None or isinstance(tree.slice, ast.Slice | ast.Tuple):
            raise untranslated(tree)
        at = self._integer(tree.slice)
        if at is None:
            return m.Call(m.Name("py:element"), (self.value(tree.slice), *items))
        if not -len(items) <= at < len(items):
            raise UntranslatableError(f"the index {at} is out of range", tree.lineno)
        return _after([item for item in items if item is not items[at]], items[at])

    def sequence_call(self, tree: ast.Call) -> m.Expression | None:
        """Translate a call of a function that takes lists; None for others."""
        module, name = self._library_name(tree.func)
        match module, name:
            case "numpy", "interp":
                return self._interpolation(tree)
            case "numpy", "searchsorted":
                return self._place_within(tree)
            case "numpy", "select":
                return self._selection(tree)
        if tree.keywords or not tree.args or not module:
            return None
        items = self.elements(tree.args[0])
        if (module, name) == ("numpy", "polyval") and items and len(tree.args) == 2:
            x = self.value(tree.args[1])
            # Horner's scheme: ((c0 x + c1) x + c2) x ...
            return reduce(lambda total, c: m.Binary("+", m.Binary(".*", total, x), c), items)
        if (module, name) == ("builtins", "len") and isinstance(tree.args[0], ast.Name):
            rows = self._table(tree.args[0].id)
            items = [m.Number(0.0)] * len(rows) if rows else items
        if items is None or len(tree.args) > 1:
            return None
        if (module, name) == ("builtins", "len"):
            return _after(items, m.Number(float(len(items))))
        if name in ("any", "all") and module == "builtins":
            sign = "||" if name == "any" else "&&"
            truths = [m.Binary("~=", item, m.Number(0.0)) for item in items]
            return reduce(lambda a, b: m.Binary(sign, a, b), truths) if truths else m.Number(float(name == "all"))
        if (module, name) in _SUMS:
            return reduce(lambda a, b: m.Binary("+", a, b), items) if items else m.Number(0.0)
        if (module, name) in _EXTREMES and items:
            return fold(_EXTREMES[module, name], items)
        return None

    def _interpolation(self, tree: ast.Call) -> m.Expression:
        """Translate `numpy.interp` over increasing numbers."""
        ends = {keyword.arg: keyword.value for keyword in tree.keywords}
        arguments = [*tree.args]
        ends |= dict(zip(("left", "right"), tree.args[3:], strict=False))
        if not 3 <= len(arguments) <= 5 or len(ends) != len(arguments) - 3 + len(tree.keywords) or ends.keys() - _ENDS:
            raise untranslated(tree)
        breakpoints, values = self.elements(arguments[1]), self.elements(arguments[2])
        points = [item.value for item in breakpoints or () if isinstance(item, m.Number)]
        # numpy.interp does not check this; its results mean nothing then
        is_rising = all(a < b for a, b in pairwise(points))
        if not breakpoints or not values or not len(breakpoints) == len(values) == len(points) or not is_rising:
            raise untranslated(tree)
        left = self.value(ends["left"]) if "left" in ends else values[0]
        right = self.value(ends["right"]) if "right" in ends else values[-1]
        count = m.Number(float(len(points)))
        return m.Call(m.Name("py:interp"), (self.value(arguments[0]), left, right, count, *breakpoints, *values))

    def _place_within(self, tree: ast.Call) -> m.Expression:
        """Translate `numpy.searchsorted`: the number of elements below x, or up to x; NaN is above all."""
        sides = {keyword.arg: keyword.value for keyword in tree.keywords}
        side = getattr(sides.get("side"), "value", "left")
        items = self.elements(tree.args[0]) if len(tree.args) == 2 and sides.keys() <= {"side"} else None
        points = [item.value for item in items or () if isinstance(item, m.Number)]
        if not items or len(points) != len(items) or sorted(points) != points or side not in ("left", "right"):
            raise untranslated(tree)
        x, sign = self.value(tree.args[1]), "<=" if side == "left" else "<"
        beyond: list[m.Expression] = [m.Unary("~", m.Binary(sign, x, item)) for item in items]
        return reduce(lambda a, b: m.Binary("+", a, b), beyond)

    def _selection(self, tree: ast.Call) -> m.Expression:
        """Translate `numpy.select` of conditions; all values are computed, as their exceptions count."""
        if len(tree.args) not in (2, 3) or any(each.arg != "default" for each in tree.keywords):
            raise untranslated(tree)
        match tree.args[:2]:
            case [ast.List(elts=conditions), ast.List() as choices] if all(
                isinstance(c, ast.Compare) for c in conditions
            ):
                values = self.elements(choices)
            case _:
                values = None
        if not values or len(values) != len(conditions):
            raise untranslated(tree)
        defaults = [*tree.args[2:], *(each.value for each in tree.keywords)]
        default = self.value(defaults[0]) if defaults else m.Number(0.0)
        tests = [self.value(condition) for condition in conditions]
        result = default
        for test, value in zip(tests[::-1], values[::-1], strict=True):
            result = m.Conditional(test, value, result)
        return _after([default, *values, *tests], result)


def _may_fail(tree: m.Expression) -> bool:
    """Return True if an expression may be one at which Python raises an exception."""
    return not isinstance(tree, m.Number | m.Name)


def _after(skipped: Sequence[m.Expression], tree: m.Expression) -> m.Expression:
    """Return an expression that evaluates others first, as they may fail, though their values are not used."""
    others = tuple(filter(_may_fail, skipped))
    return m.Call(m.Name("py:first"), (tree, *others)) if others else tree


def _ends(part: ast.Slice) -> tuple[ast.expr | None, ...]:
    return part.lower, part.upper, part.step


def target_names(target: ast.expr, count: int) -> list[str]:
    """Return the names that a loop assigns, which must be as many as the values of a row.

    Raises:
        UntranslatableError: there are others.
    """
    items = target.elts if isinstance(target, ast.Tuple) else [target]
    names = [item.id for item in items if isinstance(item, ast.Name)]
    if len(names) != len(items) or len(names) != count:
        raise untranslated(target)
    return names

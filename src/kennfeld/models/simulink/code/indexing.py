"""Elements of arrays, read; a place that depends on signals is a choice between all places."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.code.errors import CodeError
from kennfeld.models.simulink.code.limits import away_from_zero
from kennfeld.models.simulink.code.values import (
    Cells,
    Held,
    String,
    Struct,
    Truths,
    array_of,
    constants,
    of_class,
)
from kennfeld.models.simulink.expressions.arrays import each
from kennfeld.models.simulink.expressions.signals import Nodes

if TYPE_CHECKING:
    from kennfeld.models.simulink.code.calls import Calls

__all__ = ["MASK_MEND", "Place", "check_within", "element", "folded", "indexed", "is_one", "place_of", "size_said"]

MASK_MEND = "Write it as a loop over all elements with if."
Place = tuple[Nodes | None, list[int]]  # nodes of places that depend on signals; else fixed places, from 0


def element(array: Nodes, at: Sequence[int]) -> int:
    """One element of an array by places from 0; raises `CodeError` where there is none."""
    try:
        if min(at) < 0:
            raise IndexError
        found = array.ravel(order="F")[at[0]] if len(at) == 1 else array[tuple(at)]
    except IndexError:
        places = ",".join(str(one + 1) for one in at)
        raise CodeError(f"the element ({places}) is outside of an array of {size_said(array)}") from None
    return int(found)


def indexed(calls: "Calls", held: Held, trees: Sequence[m.Expression], what: str) -> Held:
    """`held(trees)`."""
    if isinstance(held, Cells):
        whole = np.arange(len(held.cells), dtype=np.int64).reshape(held.shape, order="F")
        chosen = _elements(calls, whole, calls.arguments(whole, trees), what, fixed=True)
        return Cells(tuple(held.cells[int(at)] for at in chosen.ravel(order="F")), chosen.shape)
    if isinstance(held, String) and all(is_one(calls, tree) for tree in trees):
        return held
    if isinstance(held, str):
        text = np.array([[ord(one) for one in held]], dtype=np.int64)
        chosen = _elements(calls, text, calls.arguments(text, trees), what, fixed=True)
        return "".join(chr(int(one)) for one in chosen.ravel(order="F"))
    if isinstance(held, Struct) and all(is_one(calls, tree) for tree in trees):
        return held
    array = array_of(held, what)
    if not trees:
        return array
    places = calls.arguments(array, trees)
    if _is_mask(calls, array, places):
        return array
    made = _elements(calls, array, places, what)
    return of_class(array, made)


def _is_mask(calls: "Calls", array: Nodes, places: list[Held]) -> bool:
    """Whether elements are chosen by the mask of the statement, so that all of them may stand for those."""
    mask = calls.mask
    if mask is None or len(places) != 1 or array.shape != mask.shape:
        return False
    return isinstance(places[0], Truths) and np.array_equal(places[0], mask)


def is_one(calls: "Calls", tree: m.Expression) -> bool:
    """Whether an index of one thing means that thing."""
    return isinstance(tree, m.Colon | m.End) or calls.number(tree) == 1


def _elements(calls: "Calls", array: Nodes, places: list[Held], what: str, fixed: bool = False) -> Nodes:
    whole = np.asarray(array)
    if len(places) == 1:
        return _linear(calls, whole, places[0], what, fixed)
    whole = folded(whole, len(places))
    for axis, held in enumerate(places):
        chosen, at = place_of(calls, held, whole.shape[axis], what)
        check_within(at, whole.shape[axis], whole, what)
        if chosen is None:
            whole = np.take(whole, at, axis=axis)
        elif fixed:
            raise CodeError(f"the place in {what} depends on signals")
        else:
            parts = np.moveaxis(whole, axis, 0)
            calls.desk.room(float(parts.size) * chosen.size)
            picked = [_picked(calls, parts, int(node)) for node in chosen.ravel(order="F")]
            whole = np.moveaxis(np.stack(picked), 0, axis)
    while whole.ndim > 2 and whole.shape[-1] == 1:
        whole = whole[..., 0]
    return whole


def folded(array: Nodes, count: int) -> Nodes:
    """The array with as many dimensions as it is indexed by."""
    shape = (*array.shape, *(1,) * (count - array.ndim))
    return array.reshape((*shape[: count - 1], int(np.prod(shape[count - 1 :]))), order="F")


def _linear(calls: "Calls", array: Nodes, held: Held, what: str, fixed: bool) -> Nodes:
    """Elements by one place each, counted along the columns."""
    flat = array.ravel(order="F")
    if isinstance(held, str):
        return flat.reshape(-1, 1)
    chosen, at = place_of(calls, held, flat.size, what)
    check_within(at, flat.size, array, what)
    shape = _shape(array, array_of(held), len(at))
    if chosen is None:
        return flat[at].reshape(shape, order="F")
    if fixed:
        raise CodeError(f"the place in {what} depends on signals")
    calls.desk.room(float(flat.size) * chosen.size)
    made = np.array([_picked(calls, flat, int(node)) for node in chosen.ravel(order="F")], dtype=np.int64)
    return made.reshape(shape, order="F")


def _shape(array: Nodes, place: Nodes, count: int) -> tuple[int, ...]:
    """The shape of elements by one place each: that of the places, of vectors along the array's own direction."""
    if isinstance(place, Truths) and place.shape != array.shape and 1 not in place.shape:
        return (count, 1)
    if isinstance(place, Truths) or (1 in place.shape and 1 in array.shape and array.ndim == 2):
        if array.shape[0] == 1 and array.size != 1:
            return (1, count)
        if array.shape[1] == 1 and array.size != 1:
            return (count, 1)
    if isinstance(place, Truths):
        return (1, count) if place.shape[0] == 1 else (count, 1)
    return place.shape


def place_of(calls: "Calls", held: Held, size: int, what: str) -> Place:
    """Places from 0, or their nodes where they depend on signals."""
    if isinstance(held, str):
        if held == ":":
            return None, list(range(size))
        raise CodeError(f"the place in {what} is a text")
    nodes = array_of(held, f"the place in {what}")
    numbers = calls.desk.numbers(nodes, f"a place in {what}")
    if isinstance(nodes, Truths):
        if numbers is None:
            raise CodeError(f"a mask on {what} that depends on signals", MASK_MEND)
        return None, [int(at) for at in np.flatnonzero(numbers.ravel(order="F"))]
    if numbers is None:
        return nodes, [0] * nodes.size
    flat = numbers.ravel(order="F")
    if not np.all(np.isfinite(flat)):
        raise CodeError(f"the place {flat[~np.isfinite(flat)][0]:g} in {what} is no whole number")
    return None, [int(away_from_zero(at)) - 1 for at in flat]


def check_within(at: list[int], size: int, array: Nodes, what: str) -> None:
    """Refuse places, from 0, that are not within a size."""
    wrong = next((one for one in at if not 0 <= one < size), None)
    if wrong is not None and size + len(at) > 0:
        raise CodeError(f"the element {wrong + 1} of {what} is outside of its size {size_said(array)}")


def _picked(calls: "Calls", parts: Nodes, node: int) -> Nodes:
    """The part at a place that depends on signals; not a number beyond the ends, where MATLAB stops."""
    loom = calls.loom
    at = np.full(parts.shape[1:], loom.call("round", node), dtype=np.int64)
    made = np.full(parts.shape[1:], loom.const(float("nan")), dtype=np.int64)
    for number in range(parts.shape[0], 0, -1):
        made = each(loom, "select", each(loom, "eq", at, constants(loom, number).reshape(())), parts[number - 1], made)
    return made


def size_said(array: Nodes) -> str:
    """The size of an array, for a message."""
    return "x".join(map(str, array.shape))

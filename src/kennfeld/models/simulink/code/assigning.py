"""Assignments to parts of variables; a place that depends on signals is a choice at each place."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.code.errors import CodeError
from kennfeld.models.simulink.code.indexing import (
    MASK_MEND,
    Place,
    check_within,
    element,
    folded,
    indexed,
    is_one,
    place_of,
    size_said,
)
from kennfeld.models.simulink.code.values import (
    EMPTY,
    Cells,
    Held,
    Struct,
    Truths,
    array_of,
    constants,
    field_of,
    integers,
    said,
    truths,
    word_of,
)
from kennfeld.models.simulink.expressions.arrays import each
from kennfeld.models.simulink.expressions.signals import Nodes

if TYPE_CHECKING:
    from kennfeld.models.simulink.code.calls import Calls

__all__ = ["assigned"]

Change = Callable[[Held | None], Held]


def assigned(calls: "Calls", old: Held | None, target: m.Expression, value: Held) -> Held:
    """A variable, None where it is new, after an assignment to a part of it."""
    match target:
        case m.Name():
            return value
        case m.Field(of, name):
            return _inside(calls, old, of, lambda held: _with_field(held, name, value))
        case m.DynamicField(of, tree):
            key = calls.value(tree)
            if not isinstance(key, str):
                raise CodeError("the name of a field is no text")
            return _inside(calls, old, of, lambda held: _with_field(held, key, value))
        case m.Call(of, arguments):
            return _inside(calls, old, of, lambda held: _with_elements(calls, held, arguments, value))
        case m.CellIndex(of, arguments):
            return _inside(calls, old, of, lambda held: _with_cell(calls, held, arguments, value))
    raise CodeError("it assigns to what is no variable")


def _inside(calls: "Calls", old: Held | None, of: m.Expression, change: Change) -> Held:
    """Change a part of a variable, and the parts around it with it."""
    if isinstance(of, m.Name):
        return change(old)
    return assigned(calls, old, of, change(_part(calls, old, of)))


def _part(calls: "Calls", old: Held | None, tree: m.Expression) -> Held | None:
    """The part of a variable that an assignment changes; None where it is new."""
    match tree:
        case m.Name():
            return old
        case m.Field(of, name):
            around = _part(calls, old, of)
            return field_of(around, name) if isinstance(around, Struct) and name in around.fields else None
        case m.Call(of, arguments):
            around = _part(calls, old, of)
            return None if around is None else indexed(calls, around, arguments, "it")
    raise CodeError("it assigns to a part of a cell")


def _with_field(held: Held | None, name: str, value: Held) -> Struct:
    if held is None or (isinstance(held, np.ndarray) and held.size == 0):
        return Struct({name: value})
    if not isinstance(held, Struct):
        raise CodeError(f"it assigns the field {name} of {said(held)}")
    return Struct({**held.fields, name: value})


def _with_cell(calls: "Calls", held: Held | None, trees: Sequence[m.Expression], value: Held) -> Cells:
    cells = held if isinstance(held, Cells) else Cells((), (0, 0))
    whole = np.arange(len(cells.cells), dtype=np.int64).reshape(cells.shape, order="F")
    places = [calls.desk.numbers(array_of(one), "the place of a cell") for one in calls.arguments(whole, trees)]
    at = [int(one.item()) - 1 for one in places if one is not None and one.size == 1]
    if len(at) != len(trees):
        raise CodeError("the place of a cell is not one fixed number")
    is_row = len(cells.shape) == 2 and min(cells.shape) < 2
    if at == [len(cells.cells)] and is_row:  # one more, behind the last
        rows, columns = cells.shape
        shape = (rows + 1, 1) if columns == 1 and rows > 1 else (1, len(cells.cells) + 1)
        return Cells((*cells.cells, value), shape)
    made = list(cells.cells)
    made[element(whole, at)] = value
    return Cells(tuple(made), cells.shape)


def _with_elements(calls: "Calls", held: Held | None, trees: Sequence[m.Expression], value: Held) -> Held:
    if isinstance(held, Struct) or isinstance(value, Struct):
        if all(is_one(calls, tree) for tree in trees):
            return value
        raise CodeError("arrays of structs are not supported")
    old = EMPTY if held is None else array_of(held, "what it assigns to")
    new = array_of(value, "what it assigns")
    if isinstance(held, Truths) and not isinstance(new, Truths):
        new = truths(each(calls.loom, "ne", new, constants(calls.loom, 0.0)))
    places = calls.arguments(old, trees)
    if new.size == 0:
        raise CodeError("elements are deleted, which is not supported")
    made = _written(calls, np.asarray(old), places, np.asarray(new))
    logical = isinstance(new, Truths) and (held is None or (isinstance(held, Truths) and held.size > 0))
    return truths(made) if logical else integers(made, word_of(new if old.size == 0 else old))


def _written(calls: "Calls", old: Nodes, places: list[Held], new: Nodes) -> Nodes:
    if len(places) == 1 and isinstance(places[0], Truths) and places[0].shape == old.shape:
        mask = places[0]
        if calls.desk.numbers(mask, "a mask") is None:
            return _masked(calls, old, mask, new)
    sizes = [old.size] if len(places) == 1 else list(folded(old, len(places)).shape)
    made = [place_of(calls, one, size, "it") for one, size in zip(places, sizes, strict=True)]
    if len(places) > 1 and old.size == 0:
        made = [_whole(one, at, new, axis) for axis, (one, at) in enumerate(zip(places, made, strict=True))]
    if all(chosen is None for chosen, _ in made):
        return _fixed(calls, old, [at for _, at in made], new)
    for (_, at), size in zip(made, sizes, strict=True):
        check_within(at, size, old, "what it assigns to")
    return _one_by_one(calls, old, made, new)


def _one_by_one(calls: "Calls", old: Nodes, places: list[Place], new: Nodes) -> Nodes:
    """Elements at places of which some depend on signals, each after the one before it."""
    sizes = [chosen.size if chosen is not None else len(at) for chosen, at in places]
    _check_count(new, int(np.prod(sizes)))
    calls.desk.room(float(old.size) * float(np.prod(sizes)))
    values = np.broadcast_to(new.reshape(()), sizes) if new.size == 1 else new.reshape(sizes, order="F")
    for which in np.ndindex(*sizes):
        places_of_one = [_single(place, at) for place, at in zip(places, which, strict=True)]
        old = _chosen(calls, old, places_of_one, int(values[which]))
    return old


def _check_count(new: Nodes, count: int) -> None:
    if new.size not in (1, count):
        raise CodeError(f"{new.size} elements are assigned to {count} places")


def _single(place: Place, at: int) -> Place:
    chosen, fixed = place
    return (None, [fixed[at]]) if chosen is None else (chosen.ravel(order="F")[at : at + 1], [0])


def _whole(place: Held, found: Place, new: Nodes, axis: int) -> Place:
    """Where `:` stands in an assignment to a variable that is new, the value says how long it is."""
    if not isinstance(place, str):
        return found
    return None, list(range(new.shape[axis] if new.ndim > axis and new.size > 1 else 1))


def _masked(calls: "Calls", old: Nodes, mask: Nodes, new: Nodes) -> Nodes:
    if new.size != 1:
        raise CodeError("a mask that depends on signals chooses where several elements are assigned", MASK_MEND)
    return each(calls.loom, "select", np.asarray(mask), np.broadcast_to(new.reshape(()), old.shape), old)


def _fixed(calls: "Calls", old: Nodes, places: list[list[int]], new: Nodes) -> Nodes:
    """Elements at fixed places; the array grows to hold them."""
    if any(one < 0 for at in places for one in at):
        raise CodeError("it assigns to an element before the first one")
    made = _grown(calls, old, places)
    _check_count(new, int(np.prod([len(at) for at in places])))
    if len(places) == 1:
        flat = made.ravel(order="F")
        flat[places[0]] = new.ravel(order="F")
        return flat.reshape(made.shape, order="F")
    if new.size > 1 and [n for n in new.shape if n > 1] != [len(at) for at in places if len(at) > 1]:
        wanted = "x".join(str(len(at)) for at in places)
        raise CodeError(f"an array of {size_said(new)} is assigned to places of {wanted}")
    sides = folded(made, len(places)).copy()
    block = new.reshape(()) if new.size == 1 else new.reshape([len(at) for at in places], order="F")
    sides[np.ix_(*places)] = block
    return sides.reshape(made.shape, order="F")


def _grown(calls: "Calls", old: Nodes, places: list[list[int]]) -> Nodes:
    """A copy that is large enough, new elements 0."""
    ends = [max(at, default=-1) + 1 for at in places]
    shape = _longer(old, ends[0]) if len(places) == 1 else _larger(old, ends)
    if shape is None:
        return old.copy()
    calls.desk.room(float(np.prod(shape)))
    made = np.full(shape, calls.loom.const(0.0), dtype=np.int64)
    if old.size:
        kept = old.reshape((*old.shape, *(1,) * (len(shape) - old.ndim)))
        made[tuple(slice(size) for size in kept.shape)] = kept
    return made


def _longer(old: Nodes, end: int) -> tuple[int, ...] | None:
    """The shape of a vector that has so many elements; None where it has them."""
    if end <= old.size:
        return None
    if old.size > 1 and 1 not in old.shape:
        raise CodeError(f"the element {end} is outside of an array of {size_said(old)}")
    return (end, 1) if old.ndim == 2 and old.shape[1] == 1 and old.size > 1 else (1, end)


def _larger(old: Nodes, ends: list[int]) -> tuple[int, ...] | None:
    """The shape of an array that goes so far along each dimension; None where it does."""
    base = (*old.shape, *(1,) * (len(ends) - old.ndim))
    if len(ends) < old.ndim or all(end <= size for end, size in zip(ends, base, strict=True)):
        return None
    return tuple(max(pair) for pair in zip(ends, base, strict=True))


def _chosen(calls: "Calls", old: Nodes, places: list[Place], new: int) -> Nodes:
    """One element at a place that depends on signals: each is the new one where the place is its own.

    Where the place is none of the array, as MATLAB stops there, nothing changes.
    """
    loom = calls.loom
    shape, whole = old.shape, old.ravel(order="F") if len(places) == 1 else folded(old, len(places))
    calls.desk.room(whole.size)
    made = whole.copy()
    for at in np.ndindex(*whole.shape):
        here = loom.const(1.0)
        for axis, (chosen, fixed) in enumerate(places):
            node = loom.const(float(fixed[0] + 1)) if chosen is None else loom.call("round", int(chosen.item()))
            same = loom.call("eq", node, loom.const(float(at[axis] + 1)))
            here = loom.call("and", here, same) if loom.value(here) != 1.0 else same
        made[at] = loom.call("select", here, new, int(whole[at]))
    return made.reshape(shape, order="F")

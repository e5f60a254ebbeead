"""Functions of structs and of functions that a variable holds."""

import numpy as np

from kennfeld.models.simulink.code.functions.registry import Given, function
from kennfeld.models.simulink.code.values import (
    Cells,
    Handle,
    Held,
    Struct,
    array_of,
    constants,
    field_of,
    leaves,
    truths,
)

_MOST = 200


@function("struct", least=0, most=_MOST)
def struct(given: Given) -> Held:
    """A struct of names and values."""
    if len(given) % 2:
        raise given.refuse("a field has no value")
    fields: dict[str, Held] = {}
    for at in range(0, len(given), 2):
        value = given.held[at + 1]
        if isinstance(value, Cells):
            if value.shape != (1, 1):
                raise given.refuse("arrays of structs are not supported")
            value = value.cells[0]
        fields[given.text(at)] = value
    return Struct(fields)


@function("isfield", least=2, most=2)
def has_field(given: Given) -> Held:
    """Whether a struct has a field."""
    held, names = given.held[0], given.held[1]
    if not isinstance(held, Struct):
        return truths(constants(given.calls.loom, 0.0))
    if isinstance(names, Cells):
        found = np.array([one in held.fields if isinstance(one, str) else False for one in names.cells], dtype=bool)
        return constants(given.calls.loom, found.reshape(names.shape, order="F"))
    return truths(constants(given.calls.loom, float(isinstance(names, str) and names in held.fields)))


@function("fieldnames")
def names(given: Given) -> Held:
    """The names of the fields of a struct."""
    held = given.held[0]
    if not isinstance(held, Struct):
        raise given.refuse("its argument is no struct")
    return Cells(tuple(held.fields), (len(held.fields), 1))


@function("getfield", least=2, most=2)
def field(given: Given) -> Held:
    """A field by its name."""
    return field_of(given.held[0], given.text(1))


@function("setfield", least=3, most=3)
def with_field(given: Given) -> Held:
    """A struct with a field changed."""
    held = given.held[0]
    if not isinstance(held, Struct):
        raise given.refuse("its argument is no struct")
    return Struct({**held.fields, given.text(1): given.held[2]})


@function("struct2cell", "cell2mat")
def arranged(given: Given) -> Held:
    """The fields of a struct as cells; a row or column of cells as an array."""
    held = given.held[0]
    if given.name == "struct2cell" and isinstance(held, Struct):
        return Cells(tuple(field_of(held, name) for name in held.fields), (len(held.fields), 1))
    if isinstance(held, Cells) and 1 in held.shape:
        return np.concatenate(list(leaves(held)), axis=0 if held.shape[1] == 1 else 1)
    raise given.refuse("its argument is not supported")


@function("deal", least=1, most=_MOST)
def deal(given: Given) -> tuple[Held, ...]:
    """Each argument as a result, or one for all of them."""
    return tuple(given.held) if len(given) > 1 else (given.held[0],) * max(given.wanted, 1)


@function("feval", least=1, most=_MOST)
def call(given: Given) -> Held | tuple[Held, ...]:
    """A function called by its name, or by what holds it."""
    of, rest = given.held[0], list(given.held[1:])
    if isinstance(of, Handle):
        return given.calls.applied(of, rest, given.wanted)
    return given.calls.named(given.text(0), rest, given.wanted)


@function("arrayfun", least=2, most=6)
def over_elements(given: Given) -> Held:
    """A function of each element, which gives one number."""
    of = given.held[0]
    if not isinstance(of, Handle) or any(isinstance(one, str) for one in given.held):
        raise given.refuse("only a function and arrays are supported")
    arrays = [given.array(at) for at in range(1, len(given))]
    made: list[int] = []
    for places in zip(*(array.ravel(order="F") for array in arrays), strict=True):
        given.calls.desk.step()
        results = given.calls.applied(of, [node.reshape(1, 1) for node in places], 1)
        made.append(int(array_of(results[0]).item()))
    return np.array(made, dtype=np.int64).reshape(arrays[0].shape, order="F")

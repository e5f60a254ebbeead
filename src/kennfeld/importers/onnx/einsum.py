"""Sums of products over named dimensions."""

from collections.abc import Sequence

import numpy as np

from kennfeld.importers.onnx.network import Array, Operator
from kennfeld.importers.onnx.reductions import reduce_along
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.tensors import Tensor, UnsupportedOperatorError, rearrange, shape_of


@operator("Einsum")
def einsum(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    """Multiply the tensors with all of their dimensions aligned, and add along those that the result lacks."""
    tensors = [argument for argument in arguments if argument is not None]
    equation = op.get("equation", "").replace(" ", "")
    terms, arrow, result = equation.partition("->")
    names = [_expanded(term, shape_of(tensor)) for term, tensor in zip(terms.split(","), tensors, strict=True)]
    letters = [letter for name in names for letter in name]
    if arrow:
        # dimensions of an ellipsis are broadcast: the term with most of them has those of the result
        widest = max((name for name in names), key=lambda name: sum(letter.isdigit() for letter in name))
        kept = list(result.replace("...", "".join(letter for letter in widest if letter.isdigit())))
    else:
        # without an arrow, letters that occur once remain in alphabetical order, after the digits of an ellipsis
        kept = sorted({letter for letter in letters if letters.count(letter) == 1 or letter.isdigit()})
    if not set(kept) <= set(letters):
        raise UnsupportedOperatorError(f"its equation {equation} is invalid")
    order = [*kept, *sorted(set(letters) - set(kept))]
    aligned = [
        rearrange(lambda array, name=name: _aligned(array, name, order), tensor)  # type: ignore[misc]
        for name, tensor in zip(names, tensors, strict=True)
    ]
    axes = list(range(len(kept), len(order)))
    total = reduce_along(c, "Sum", c.apply.fold("mul", aligned), axes) if axes else c.apply.fold("mul", aligned)
    return rearrange(lambda array: array.reshape(array.shape[: len(kept)]), total)


def _expanded(term: str, shape: Sequence[int]) -> str:
    """Return a letter for each dimension; those of an ellipsis are digits, which end at the same one."""
    extra = len(shape) - len(term.replace("...", ""))
    # aligned at the last dimension, as broadcasting does
    digits = "0123456789"[10 - extra :] if extra else ""
    return term.replace("...", digits)


def _aligned(array: Array, name: str, order: Sequence[str]) -> Array:
    """Return an array with a dimension for each letter in `order`; a repeated letter is the diagonal."""
    letters = list(name)
    for letter in set(letters):
        while letters.count(letter) > 1:
            first, second = (place for place, each in enumerate(letters) if each == letter)
            # numpy appends the diagonal as the last dimension
            array = np.moveaxis(np.diagonal(array, axis1=first, axis2=second), -1, first)
            del letters[second]
    present = [letter for letter in order if letter in letters]
    array = array.transpose([letters.index(letter) for letter in present])
    # missing letters are dimensions of 1, along which the product is broadcast
    return array.reshape([array.shape[present.index(letter)] if letter in present else 1 for letter in order])

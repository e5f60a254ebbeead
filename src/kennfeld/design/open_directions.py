"""Undetermined directions as linear functions of the values, and how far a design settles them."""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import InputError, Location
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.design.predicted_estimate import expand_matrix
from kennfeld.optimize.trust.direction_text import Direction

SETTLED = 0.9  # of the deviation before, above which something counts as not settled
RIDGE = 1e-2  # of the curvature that the spread stands for: a deviation of ten spreads is undetermined
FAINT = 1e-9  # of the curvature, for values without data of their own


def open_directions(fitted: FittedFunction) -> list[Direction]:
    """Return the directions of the trust that the data do not determine, in its order."""
    return [direction for direction in fitted.trust.directions if not direction.determined]


def pick_direction(fitted: FittedFunction, number: int) -> Direction:
    """Return a direction of the trust by its number from 1; the undetermined ones come first.

    Raises:
        InputError: there are fewer.
    """
    directions = list(fitted.trust.directions)
    if not 1 <= number <= len(directions):
        message = f"there is no direction {number} among the {len(directions)} of this fit"
        remedy = "\n".join(f"{i}: {each.sentence}" for i, each in enumerate(directions, 1))
        raise InputError.of(Location("--direction"), message, remedy or "The data determine all values.")
    return directions[number - 1]


def amount_of(fitted: FittedFunction, direction: Direction) -> Float:
    """Return the amount of a direction as a linear function of the free values, v'D / v'D v, Float[free].

    D is the curvature of the data along each value, as for the deviation that the trust states.
    """
    change = np.zeros(fitted.values.size)
    for name, part in direction.parts.items():
        first, size = fitted.blocks[name]
        change[first : first + size] = part.ravel()
    diagonal = np.maximum(fitted.estimate.own, FAINT * fitted.estimate.own.max(initial=0.0)) + fitted.ridge
    function = change * diagonal
    return np.asarray(function / (function @ change))


def regular_curvature(fitted: FittedFunction) -> Float:
    """Return the curvature over the independent values, with a little of the spread so that it has an inverse."""
    ridge = RIDGE * fitted.ridge[fitted.estimate.reduction.independent]
    return np.asarray(fitted.curvature + np.diag(ridge))


def reduced_functions(fitted: FittedFunction, functions: Sequence[Float]) -> Float:
    """Return linear functions of the free values over the independent ones, Float[functions, independent]."""
    rows = np.array(functions).reshape(len(functions), fitted.values.size)
    return fitted.estimate.reduction.rows(rows)


def factors_with(fitted: FittedFunction, functions: Float, added: Float, scatter: Float) -> Float:
    """Return the deviation of linear functions after data, relative to that before.

    Args:
        fitted: the fit before.
        functions: over the independent values, Float[functions, independent].
        added: Gauss-Newton matrix of the data, Float[independent, independent].
        scatter: variance of the gradient by their noise, Float[independent, independent].

    Returns:
        Float[functions].
    """
    estimate, curvature = fitted.estimate, regular_curvature(fitted)
    if estimate.noise is None:
        before, after = (_sandwich(functions, each, each) for each in (curvature, curvature + added))
        return _relative(after, before)
    noise, data = (expand_matrix(estimate, each) for each in (estimate.noise, estimate.data))
    # what is known without data has the noise of all
    claimed = noise + estimate.dispersion * (curvature - data)
    before = _sandwich(functions, curvature, claimed)
    return _relative(_sandwich(functions, curvature + added, claimed + scatter), before)


def _sandwich(functions: Float, curvature: Float, noise: Float) -> Float:
    """Return f'H^-1 M H^-1 f for each function f, Float[functions]."""
    rows = np.linalg.solve(curvature, functions.T)
    return np.asarray(np.einsum("if,if->f", rows, functions.T if noise is curvature else noise @ rows))


def _relative(after: Float, before: Float) -> Float:
    return np.asarray(np.sqrt(np.divide(after, before, out=np.ones_like(before), where=before > 0)))

"""Rows of the black-box models that the classical optimal designs are made for: polynomials, radial basis functions."""

from collections.abc import Mapping
from itertools import combinations
from typing import Literal

import numpy as np

from kennfeld.base.arrays import Float

RegressionModel = Literal["linear", "interaction", "quadratic", "rbf"]
MODELS: tuple[RegressionModel, ...] = ("linear", "interaction", "quadratic", "rbf")


def unit_columns(columns: Mapping[str, Float]) -> Float:
    """Scale channels to -1 ... 1 over their points, Float[points, channels]; those that are constant are left out."""
    scaled = []
    for values in columns.values():
        low, high = float(values.min()), float(values.max())
        if high > low:
            scaled.append((2 * values - low - high) / (high - low))
    count = len(next(iter(columns.values())))
    return np.column_stack(scaled) if scaled else np.zeros((count, 0))


def polynomial_rows(points: Float, model: RegressionModel) -> Float:
    """Return the terms of a polynomial at points, Float[points, coefficients]: 1, x, products, squares.

    >>> polynomial_rows(np.array([[2.0, 3.0]]), "quadratic").tolist()
    [[1.0, 2.0, 3.0, 6.0, 4.0, 9.0]]
    """
    columns = [np.ones(len(points)), *points.T]
    if model != "linear":
        columns += [points[:, i] * points[:, j] for i, j in combinations(range(points.shape[1]), 2)]
    if model == "quadratic":
        columns += [column**2 for column in points.T]
    return np.column_stack(columns)


def rbf_rows(points: Float, centres: int) -> Float:
    """Return a plane and Gaussian bells at points, Float[points, 1 + channels + centres].

    The centres are points far from each other, each the one farthest from those before it, beginning at the middle.
    The width of the bells is the mean distance of a centre to its nearest neighbour.
    """
    chosen = [int(np.square(points - points.mean(axis=0)).sum(axis=1).argmin())]
    nearest = np.square(points - points[chosen[0]]).sum(axis=1)
    while len(chosen) < min(centres, len(points)) and nearest.max() > 0:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.square(points - points[chosen[-1]]).sum(axis=1))
    middle = points[chosen]
    apart = np.square(middle[:, None] - middle[None]).sum(axis=2)
    np.fill_diagonal(apart, np.inf)
    width = float(np.sqrt(apart.min(axis=1)).mean()) if len(chosen) > 1 else 1.0
    squares = np.square(points[:, None] - middle[None]).sum(axis=2)
    return np.hstack([polynomial_rows(points, "linear"), np.exp(-squares / (2 * width**2))])


def model_rows(columns: Mapping[str, Float], model: RegressionModel, centres: int = 10) -> Float:
    """Return the rows of a model at points, Float[points, coefficients], over channels scaled to -1 ... 1."""
    points = unit_columns(columns)
    return rbf_rows(points, centres) if model == "rbf" else polynomial_rows(points, model)

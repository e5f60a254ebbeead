"""Rounds the end of a fit to storable values."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Float, Sparse
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import count_noun, join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.storage import StorageRounding
from kennfeld.native.cholesky import Cholesky
from kennfeld.native.samples import Samples
from kennfeld.native.symmetric import as_sparse, scaled, zeros_like
from kennfeld.optimize.limits.projection import FEASIBLE
from kennfeld.optimize.rounding.joint_rounding import round_values
from kennfeld.optimize.rounding.lattice import SLACK, GridBlock, Lattice, grid_blocks
from kennfeld.optimize.rounding.outcome import LabelRounding
from kennfeld.optimize.rounding.refit import FloatRefit
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective

ROUGHNESS = 0.1  # share of the roughness: steps cannot be as smooth as a fit, but values without data follow it
RELATIVE = 0.1  # weight of the relative loss of each criterion, against that of the whole cost
LEAST_COST = 1e-4  # share of a criterion in the cost, below which it is met almost exactly, whatever the rounding
MAX_LISTED = 3
REMEDY = "Choose a finer step, or raise max_shift."


@dataclass(frozen=True, eq=False)
class RoundedFit:
    """The free values of a fit, rounded in two ways.

    Attributes:
        nearest: each value on its own, Float[free].
        joint: all values together, Float[free].
        labels: what was rounded.
        warnings: limits that storage does not let hold, and values that could not be rounded.
    """

    nearest: Float
    joint: Float
    labels: tuple[LabelRounding, ...]
    warnings: tuple[Finding, ...]


class _Candidate(NamedTuple):
    breaks: bool  # limits of outputs
    cost: float
    values: Float
    numbers: Float


def round_fit(
    compiled: CompiledProblem,
    rounding: StorageRounding,
    limits: LinearLimits,
    fit: Float,
    keeps_outputs: Callable[[Float], bool] = lambda values: True,
) -> RoundedFit:
    """Round the free values of a fit.

    The errors of the joint rounding on the training data, without roughness, are never larger than those of the
    nearest one.

    Args:
        compiled: the problem.
        rounding: method and grids.
        limits: bounds, locks and rows of the free values.
        fit: the free values at the end of the search, Float[free].
        keeps_outputs: returns whether values keep the limits of outputs.
    """
    blocks = grid_blocks(compiled.problem, compiled.values, rounding)
    objective = LeastSquaresObjective(compiled, by_rows=False)
    curvature = _curvature(compiled, objective, fit)
    refit = FloatRefit(compiled.problem, compiled.values, rounding, limits, fit, curvature)
    matrix = refit.reduced()
    lattice = Lattice.of(fit, blocks, limits, rounding.max_shift)
    rounded = round_values(lattice, matrix)
    lattice = rounded.lattice

    def candidate(numbers: Float, follow: bool = True) -> _Candidate:
        values = lattice.values(numbers)
        values = refit.following(values) if follow else refit.stored(values)
        return _Candidate(not keeps_outputs(values), objective.data_cost(values), values, numbers)

    nearest = candidate(rounded.nearest, follow=False)
    joint = nearest
    # the quadratic model has ordered them; mostly the first one is better than the nearest, and no other is tried
    for numbers in rounded.joint:
        if joint[:2] < nearest[:2]:
            break
        joint = min(joint, candidate(numbers), key=lambda each: each[:2])
    applied = joint if rounding.method == "joint" else nearest
    labels = tuple(_labels(lattice, applied.numbers, lattice.in_steps(matrix)))
    warnings = (*_unrounded(lattice, blocks, limits), *_limits(lattice, limits, applied.values))
    if applied.breaks and keeps_outputs(fit):
        message = "rounding to storage exceeds limits of outputs that the fit keeps"
        warnings += (Finding(Location(), message, "Choose a finer step, or tighten these limits.", severity="warning"),)
    return RoundedFit(nearest.values, joint.values, labels, warnings)


def _curvature(compiled: CompiledProblem, objective: LeastSquaresObjective, fit: Float) -> Sparse:
    """Return the Gauss-Newton matrix of the data with a share of the roughness, sparse, shape (free, free)."""
    matrix = objective.normal(fit)[1]
    roughness = zeros_like(matrix)
    compiled.roughness.add(fit, np.zeros(fit.size), roughness)
    return as_sparse(matrix) - (1 - ROUGHNESS) * as_sparse(roughness) + _relative_losses(compiled, fit)


def _relative_losses(compiled: CompiledProblem, fit: Float) -> Sparse | float:
    """Return the share of the matrix that counts the loss of each criterion relative to its own errors.

    By its weight in the fit, a criterion of few samples could lose all of its accuracy for a little of the others'.
    """
    numbers = [number for number, criterion in enumerate(compiled.problem.criteria) if criterion.weight > 0]
    if len(numbers) < 2:
        return 0.0
    full = compiled.full(fit)
    parts = [compiled.over_selection(_of_criterion, number) for number in numbers]
    costs = [part.sums.cost(full) for part in parts]
    total, matrix = sum(costs), 0.0
    for part, cost in zip(parts, costs, strict=True):
        if cost > LEAST_COST * total:
            matrix = matrix + RELATIVE * total / (len(parts) * cost) * as_sparse(part.sums.normal(full).matrix)
    return matrix


def _of_criterion(compiled: CompiledProblem, number: int) -> Samples:
    """Return the samples with a weight of 0 for all other criteria."""
    factors = np.zeros(len(compiled.problem.criteria))
    factors[number] = 1.0
    return compiled.samples.reweighted(factors)


def _labels(lattice: Lattice, numbers: Float, matrix: Sparse) -> Iterator[LabelRounding]:
    """Yield what was rounded, with the share of each label in the squared change of the outputs."""
    offset = numbers - lattice.centre
    slope = matrix @ offset
    loss = float(offset @ slope)
    place = np.full(lattice.fit.size, -1)
    place[lattice.places] = np.arange(lattice.size)
    for block in lattice.blocks:
        own = place[block.places]
        own = own[own >= 0]
        if own.size:
            gain = _gain(matrix[own][:, own], slope[own])
            yield LabelRounding(
                name=block.name,
                step=block.grid.step,
                bits=block.grid.bits,
                values=own.size,
                moved=int(np.count_nonzero(numbers[own] != lattice.nearest[own])),
                largest_shift=float(np.abs(offset[own]).max()),
                share=min(gain / loss, 1.0) if loss > 0 else 0.0,
            )


def _gain(matrix: Sparse, slope: Float) -> float:
    """Return by how much the loss falls if these values take the best real numbers, the others staying: g'H^-1 g."""
    diagonal = matrix.diagonal()
    # values without an effect have no slope either
    damping = SLACK * diagonal.max() + np.where(diagonal > 0, 0.0, 1.0)
    factor = Cholesky(slope.size).factor(scaled(matrix, np.ones(slope.size)), damping)
    return 0.0 if factor is None else float(slope @ factor.solve(slope))


def _unrounded(lattice: Lattice, blocks: Sequence[GridBlock], limits: LinearLimits) -> Iterator[Finding]:
    """Yield a warning on values that keep the fit because no storable value keeps their limits."""
    rounded = np.zeros(lattice.fit.size, dtype=bool)
    rounded[lattice.places] = True
    for block in blocks:
        left = ~rounded[block.places] & limits.movable[block.places]
        if left.any():
            touching = limits.rows.coefficients != 0
            mine = (np.isin(limits.rows.columns, block.places[left]) & touching).any(axis=1)
            names = [name for name, own in zip(limits.rows.names, mine, strict=False) if own]
            what = f": {join_names(names, MAX_LISTED)}" if names else ""
            count = f"{int(left.sum())} of {count_noun(block.places.size, 'value')} of {block.name}"
            message = f"{count} not rounded: no storable values near the fit keep the limits{what}"
            yield Finding(Location(), message, REMEDY, severity="warning")


def _limits(lattice: Lattice, limits: LinearLimits, values: Float) -> Iterator[Finding]:
    """Yield a warning on pins and sums that storage cannot meet exactly."""
    missed = limits.violations(values, limits.sizes(values)) > FEASIBLE
    for row in np.flatnonzero(missed)[:MAX_LISTED]:
        reached, wanted = float(limits.rows.times(values)[row]), float(limits.rows.lower[row])
        message = f"{limits.rows.names[row]} is {reached:.6g} instead of {wanted:.6g}"
        if np.count_nonzero(limits.rows.coefficients[row] * limits.movable[limits.rows.columns[row]]) > 1:
            message += ", as close as half a step of one of its values"
            remedy = "Choose a finer step, or pin values at breakpoints to multiples of the step."
        else:
            message += ", the nearest that storage allows"
            remedy = "Pin a value that is a multiple of the step."
        yield Finding(Location(), message, remedy, severity="warning")
    more = int(np.count_nonzero(missed)) - MAX_LISTED
    if more > 0:
        message = f"{count_noun(more, 'further limit')} of pins and sums met as far as storage allows"
        yield Finding(Location(), message, severity="warning")

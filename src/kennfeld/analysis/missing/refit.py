"""Fits with a term: on all training data, and on folds of them that decide whether the term is kept."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kennfeld.analysis.cross_validation import (
    Fold,
    PartitionFold,
    fold_problem,
    folds_of,
    name_partitions,
    suitable_kind,
)
from kennfeld.analysis.missing.mean_errors import mean_squares
from kennfeld.analysis.missing.score import TermScore
from kennfeld.analysis.missing.terms import MissingTerm, extended_model
from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.constraints import Equality, Pin, Term
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.partitions import Partition
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.multistart import run

FOLDS = 3
MAX_ITERATIONS = 60
TOLERANCE = 1e-7  # relative change of the cost at which a fit ends
SMOOTHNESS = 1e-3  # of the curvature of the cost by the values of a curve: little beside data, enough without


def refit_options(options: Options) -> Options:
    """Return the options of a fit that begins near its end."""
    iterations = min(options.max_iterations, MAX_ITERATIONS)
    plain = replace(options, starts=1, steps=(), continuation="off", save_every=0, method="gauss-newton")
    return replace(plain, max_iterations=iterations, tolerance=max(options.tolerance or 0.0, TOLERANCE))


@dataclass(frozen=True)
class Addition:
    """A term as it is added to a problem.

    Attributes:
        term: the term.
        parameter: the new parameter without effect; None for a delay. Values of a map whose effect the function can
            take over are locked.
        smoothness: of a curve or map, on each axis.
        pin: holds one value of a curve whose size the function can take over, or the offset of recordings that were
            not fitted; None for others.
        constraints: that offsets of recordings have no mean, if the function can take it over.
    """

    term: MissingTerm
    parameter: Parameter | None
    smoothness: float = 0.0
    pin: Pin | None = None
    constraints: tuple[Equality, ...] = ()

    @classmethod
    def of(cls, problem: Problem, score: TermScore) -> "Addition":
        """Return a scored term with a parameter of its own."""
        term = score.term
        graph = problem.model.graph
        taken = {*graph.names, *graph.inputs, *graph.parameters, *problem.parameters, *problem.channels.values()}
        label = "" if term.kind == "delay" else term.label(taken)
        parameter = term.parameter(label) if label else None
        if parameter is None or not parameter.axes:
            return cls(term, parameter)
        if term.kind == "offset":
            *numbers, others = term.breakpoints
            free = score.columns == len(numbers)
            return cls(term, parameter, 0.0, Pin(label, (others,), 0.0), () if free else (no_mean(label, term),))
        smoothness = float(f"{SMOOTHNESS * score.curvature:.0e}")
        if term.second:
            locked = np.zeros(parameter.size, dtype=bool)
            locked[list(score.idle)] = True
            return cls(term, parameter.changed(locked=locked.reshape(parameter.values.shape)), smoothness)
        if score.columns == parameter.size:
            return cls(term, parameter, smoothness)
        middle = parameter.size // 2
        pin = Pin(label, (term.breakpoints[middle],), float(parameter.values[middle]))
        return cls(term, parameter, smoothness, pin)

    def to(self, problem: Problem, parameters: ParameterSet) -> Problem:
        """Return a problem with the term, which starts at these values."""
        name = "" if self.parameter is None else self.parameter.name
        model = extended_model(problem.model, self.term, name)
        if self.parameter is None:
            return replace(problem, model=model, parameters=parameters)
        axes = len(self.parameter.axes)
        smooth = {name: (self.smoothness,) * axes} if self.smoothness and axes else {}
        return replace(
            problem,
            model=model,
            parameters=parameters.with_parameters(self.parameter),
            free=(*problem.free, name),
            smoothness={**problem.smoothness, **smooth},
            pins=(*problem.pins, *([] if self.pin is None else [self.pin])),
            constraints=(*problem.constraints, *self.constraints),
        )

    def without_effect(self, problem: Problem) -> Problem:
        """Return a problem with the term at its neutral values, which are not free.

        It is the function as it is, over the samples that the function with the term has: those at which the channels
        of the term are known.
        """
        read = self.to(problem, problem.parameters)
        return replace(problem, model=read.model, parameters=read.parameters, free=problem.free_names)


def no_mean(label: str, term: MissingTerm) -> Equality:
    """Return the constraint that the offsets of the fitted recordings, a parameter of this name, have no mean."""
    return Equality(tuple(Term(label, (number,)) for number in term.breakpoints[:-1]), 0.0)


@dataclass(frozen=True)
class HeldOut:
    """A part of the data that is held out, and the errors of the function as it is there.

    Attributes:
        problem: with the held-out samples as test data.
        parameters: fitted to the rest.
        squares: mean squared error on the held-out samples.
        samples: their number.
        name: the files, or which part it is.
    """

    problem: Problem
    parameters: ParameterSet
    squares: float
    samples: int
    name: str = ""


def hold_out(
    problem: Problem, options: Options, *, whole: bool = True, known: Addition | None = None
) -> tuple[str, list[HeldOut]]:
    """Return what is held out, in words, and the parts.

    Args:
        problem: the problem.
        options: of the fits without them.
        whole: True if whole recordings are held out where there are enough.
        known: a term at whose samples the errors count; None for all.
    """
    folds: Sequence[Fold | PartitionFold]
    if problem.partitions is not None:
        name, folds = "files", _file_folds(problem.partitions.training)
    else:
        datasets = problem.fitted_datasets
        memory = bool(problem.model.graph.states)
        kind = suitable_kind(datasets, FOLDS, memory=memory, whole=whole)
        name = "samples" if kind == "random" else kind
        folds = folds_of(datasets, FOLDS, kind, memory=memory)
    parts = []
    for fold in folds:
        part = fold_problem(problem, fold)
        fitted = part if known is None else known.without_effect(part)
        result = run(fitted, options)
        parts.append(HeldOut(part, _only(result.parameters, part), *mean_squares(fitted, result, "test"), fold.name))
    return name, [part for part in parts if part.samples]


def _only(parameters: ParameterSet, problem: Problem) -> ParameterSet:
    """Return the parameters that a problem has."""
    return parameters.without([name for name in parameters if name not in problem.parameters])


def _file_folds(partitions: Sequence[Partition]) -> list[PartitionFold]:
    """Assign partitions of a file each to folds, as `folds_of` does with files that are not in partitions.

    Raises:
        InputError: there is a single file.
    """
    count = min(FOLDS, len(partitions))
    if count < 2:
        message = "one file cannot be held out from itself"
        raise InputError.of(Location("partitions"), message, "Write partition = 0, or record further files.")
    sizes, members = [0] * count, [list[int]() for _ in range(count)]
    # the longest first, each to the smallest fold
    for at in sorted(range(len(partitions)), key=lambda number: (-partitions[number].samples, number)):
        fold = int(np.argmin(sizes))
        sizes[fold] += partitions[at].samples
        members[fold].append(at)
    groups = [tuple(partitions[at] for at in sorted(own)) for own in members]
    return [PartitionFold(name_partitions(group), group) for group in groups]


def held_out_squares(parts: Sequence[HeldOut], addition: Addition, options: Options) -> list[float]:
    """Return the mean squared error on each held-out part, of a fit with the term to the rest.

    It ends at the part with which the term can no longer be better than the function as it is.
    """
    squares: list[float] = []
    total, sound = sum(part.squares * part.samples for part in parts), 0.0
    for part in parts:
        extended = addition.to(part.problem, part.parameters)
        squares.append(mean_squares(extended, run(extended, options), "test")[0])
        sound += squares[-1] * part.samples
        # not a comparison the other way round, which would pass a NaN
        if not sound < total:
            break
    return squares


def pooled(squares: Sequence[float], parts: Sequence[HeldOut]) -> float:
    """Return the RMSE over all held-out parts."""
    weights = np.array([part.samples for part in parts[: len(squares)]], dtype=np.float64)
    return float(np.sqrt(np.array(squares) @ weights / weights.sum())) if weights.size else float("nan")

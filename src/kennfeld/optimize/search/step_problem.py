"""Problems of the steps of a sequence, and the checks of a sequence against its problem."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from glob import escape

import numpy as np

from kennfeld.arrays import Bool
from kennfeld.constraints import Equality, Shape, Term
from kennfeld.criteria import Criterion
from kennfeld.errors import Finding
from kennfeld.formatting import nearest
from kennfeld.free_axes import with_fixed_axes
from kennfeld.optimize.linear_limits import grid_points
from kennfeld.optimize.options import Step, matching
from kennfeld.optimize.problem import Problem, Smoothness
from kennfeld.optimize.validation import check_shared_axes
from kennfeld.parameters import Parameter


def step_problem(problem: Problem, step: Step) -> Problem:
    """Return the problem of one step on the full grid; `with_fixed_limits` adapts its linear limits."""
    free = problem.free if step.free is None else tuple(step.free)
    return replace(
        problem,
        free=free,
        criteria=_active(problem.criteria, step.criteria),
        parameters=problem.parameters.with_parameters(*_locked(problem, step)),
        smoothness=_smoothness(problem, step),
    )


def with_fixed_limits(problem: Problem) -> Problem:
    """Restrict the linear limits of a problem to its free parameters; the others are inserted as constants."""
    free, used = problem.free_names, problem.model.graph.parameters

    def held(name: str) -> bool:
        return name in used and name not in free

    constraints: list[Shape | Equality] = []
    for constraint in problem.constraints:
        if isinstance(constraint, Shape):
            constraints += [] if held(constraint.parameter) else [constraint]
        else:
            fixed = [term for term in constraint.terms if held(term.parameter)]
            free_terms = [term for term in constraint.terms if not held(term.parameter)]
            value = constraint.value - sum(_value(problem.parameters[term.parameter], term) for term in fixed)
            constraints += [Equality(free_terms, value)] if free_terms else []
    pins = tuple(pin for pin in problem.pins if not held(pin.parameter))
    return replace(problem, pins=pins, constraints=tuple(constraints))


def _value(parameter: Parameter, term: Term) -> float:
    columns, weights = grid_points(parameter, term.at)
    return term.factor * float(weights @ parameter.values.ravel()[columns])


def sequence_problem(problem: Problem, steps: Sequence[Step]) -> Problem:
    """Return the problem that judges a sequence: everything is free that any step may change.

    Breakpoints on whose axis a table is never fitted are fixed.
    """
    if not steps:
        return problem
    variants = [step_problem(problem, step) for step in steps]
    names = dict.fromkeys(name for variant in variants for name in variant.free_names)
    held = [
        problem.parameters[name].changed(
            locked=np.logical_and.reduce([v.parameters[name].locked for v in variants if name in v.free_names])
        )
        for name in names
    ]
    free = tuple(escape(name) for name in names)
    result = replace(problem, free=free, parameters=problem.parameters.with_parameters(*held))
    fixed = [key for key, axis in result.free_axes.items() if check_shared_axes({key: axis}, result.free_names)]
    return with_fixed_limits(replace(result, parameters=with_fixed_axes(result.parameters, fixed)))


def _locked(problem: Problem, step: Step) -> list[Parameter]:
    """Return the parameters whose locks the step changes, with these locks."""
    if not step.lock:
        return []
    own: dict[str, Bool] = {name: np.asarray(p.locked) for name, p in problem.parameters.items()}
    locks = {name: matching(step.lock, name, own[name]) for name in own}
    return [problem.parameters[n].changed(locked=np.asarray(m, bool)) for n, m in locks.items() if m is not own[n]]


def _smoothness(problem: Problem, step: Step) -> Smoothness:
    if step.smoothness is None:
        return problem.smoothness
    tables = [name for name, parameter in problem.parameters.items() if parameter.axes]
    if not isinstance(step.smoothness, Mapping):
        return dict.fromkeys(tables, step.smoothness)
    factors = {name: matching(step.smoothness, name, None) for name in tables}
    return {**problem.smoothness, **{name: factor for name, factor in factors.items() if factor is not None}}


def _active(
    criteria: Sequence[Criterion], selection: Sequence[str | int] | Mapping[str | int, float] | None
) -> tuple[Criterion, ...]:
    """Return the criteria of a step with a weight > 0, with their weights in it."""
    if selection is None:
        return tuple(criteria)
    weights = selection if isinstance(selection, Mapping) else dict.fromkeys(selection)
    selected = []
    for position, criterion in enumerate(criteria, 1):
        keys = [key for key in (position, criterion.node) if key in weights]
        if keys:
            weight = weights[keys[0]]
            selected.append(criterion if weight is None else replace(criterion, weight=weight))
    return tuple(c for c in selected if c.weight > 0)


def check_steps(problem: Problem, steps: Sequence[Step]) -> list[Finding]:
    """Return the findings on steps that do not fit the problem."""
    if not steps:
        return []
    findings = check_shared_axes(problem.free_axes, problem.free_names)
    return findings + [f for number, step in enumerate(steps, 1) for f in _StepCheck(problem, step, number).run()]


class _StepCheck:
    """Checks names, shapes and numbers of one step."""

    def __init__(self, problem: Problem, step: Step, number: int) -> None:
        self.problem, self.step = problem, step
        self.location = f"step {number}"
        self.findings: list[Finding] = []

    def run(self) -> list[Finding]:
        step, used = self.step, self.problem.model.graph.parameters
        self._check_patterns("free", step.free or (), used, " that the function uses")
        self._check_patterns("lock", step.lock, self.problem.parameters)
        for key in ("smoothness", "grid_reduction"):
            by_parameter = getattr(step, key)
            if isinstance(by_parameter, Mapping):
                self._check_patterns(key, by_parameter, self.problem.parameters)
                self._check_axis_counts(key, by_parameter)
        self._check_masks()
        self._check_criteria()
        if not self.findings:
            self._check_not_empty()
        return self.findings

    def _report(self, key: str, message: str, remedy: str = "") -> None:
        self.findings.append(Finding(f"{self.location} {key}", message, remedy))

    def _check_patterns(self, key: str, patterns: Iterable[str], names: Collection[str], which: str = "") -> None:
        for pattern in patterns:
            if not any(name == pattern or fnmatchcase(name, pattern) for name in names):
                self._report(key, f"{pattern} matches no parameter{which}", nearest(pattern, names))

    def _check_axis_counts(self, key: str, by_parameter: Mapping[str, object]) -> None:
        for name, parameter in self.problem.parameters.items():
            value, axes = matching(by_parameter, name, None), len(parameter.axes)
            if isinstance(value, Sequence) and not isinstance(value, str) and axes and len(value) != axes:
                message = f"must have one number for each of {axes} axes, got {list(value)}"
                self._report(f"{key} {name}", message)

    def _check_masks(self) -> None:
        for name, parameter in self.problem.parameters.items():
            mask, shape = matching(self.step.lock, name, None), parameter.values.shape
            if mask is not None and np.shape(mask) not in ((), shape):
                message = f"the mask has shape {list(np.shape(mask))}, but the parameter has {list(shape)}"
                self._report(f"lock {name}", message, "Give one entry per grid point.")

    def _check_criteria(self) -> None:
        nodes = [criterion.node for criterion in self.problem.criteria]
        selection = self.step.criteria or ()
        for key in selection:
            if isinstance(key, int):
                if not 1 <= key <= len(nodes):
                    self._report("criteria", f"there is no criterion {key}", f"Use numbers from 1 to {len(nodes)}.")
            elif key not in nodes:
                remedy = nearest(key, nodes) or f"Criteria exist for {', '.join(nodes)}."
                self._report("criteria", f"there is no criterion for {key}", remedy)
        for key, weight in selection.items() if isinstance(selection, Mapping) else ():
            if not 0 <= weight < np.inf:
                self._report(f"criteria {key}", f"the weight must be >= 0, got {weight}")

    def _check_not_empty(self) -> None:
        problem = step_problem(self.problem, self.step)
        if not problem.criteria:
            self._report("criteria", "no criterion has a weight > 0", "Select at least one.")
        if not problem.free_names:
            self._report("free", "no parameter that the function uses is free", "Free at least one.")

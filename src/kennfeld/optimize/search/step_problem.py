"""One step of a sequence, and the problem that it solves."""

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
from kennfeld.free_axes import with_fixed_axes as axes_standing
from kennfeld.optimize.linear_limits import grid_points
from kennfeld.optimize.options import Step, matching
from kennfeld.optimize.problem import Problem, Smoothness
from kennfeld.optimize.validation import check_shared_axes
from kennfeld.parameters import Parameter

__all__ = ["check_steps", "sequence_problem", "step_problem", "with_fixed_limits"]


def step_problem(problem: Problem, step: Step) -> Problem:
    """The problem of one step, on the full grid; `standing` adapts its pins and other linear limits."""
    free = problem.free if step.free is None else tuple(step.free)
    return replace(
        problem,
        free=free,
        criteria=_active(problem.criteria, step.criteria),
        parameters=problem.parameters.with_parameters(*_locked(problem, step)),
        smoothness=_smoothness(problem, step),
    )


def with_fixed_limits(problem: Problem) -> Problem:
    """The problem with the linear limits on what is free alone, the other parameters standing as they are."""
    free, used = problem.free_names, problem.model.graph.parameters

    def held(name: str) -> bool:
        return name in used and name not in free

    constraints: list[Shape | Equality] = []
    for constraint in problem.constraints:
        if isinstance(constraint, Shape):
            constraints += [] if held(constraint.parameter) else [constraint]
        else:
            fixed = [term for term in constraint.terms if held(term.parameter)]
            left = [term for term in constraint.terms if not held(term.parameter)]
            value = constraint.value - sum(_value(problem.parameters[term.parameter], term) for term in fixed)
            constraints += [Equality(left, value)] if left else []
    pins = tuple(pin for pin in problem.pins if not held(pin.parameter))
    return replace(problem, pins=pins, constraints=tuple(constraints))


def _value(parameter: Parameter, term: Term) -> float:
    """What a term of an equality is."""
    columns, weights = grid_points(parameter, term.at)
    return term.factor * float(weights @ parameter.values.ravel()[columns])


def sequence_problem(problem: Problem, steps: Sequence[Step]) -> Problem:
    """The problem with everything free that any step may change, by which a sequence is judged.

    Breakpoints on whose axis a table is never fitted stand still.
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
    made = replace(problem, free=free, parameters=problem.parameters.with_parameters(*held))
    never = [key for key, axis in made.free_axes.items() if check_shared_axes({key: axis}, made.free_names)]
    return with_fixed_limits(replace(made, parameters=axes_standing(made.parameters, never)))


def _locked(problem: Problem, step: Step) -> list[Parameter]:
    """The parameters that the step locks or unlocks."""
    if not step.lock:
        return []
    own: dict[str, Bool] = {name: np.asarray(p.locked) for name, p in problem.parameters.items()}
    found = {name: matching(step.lock, name, own[name]) for name in own}
    return [problem.parameters[n].changed(locked=np.asarray(f, bool)) for n, f in found.items() if f is not own[n]]


def _smoothness(problem: Problem, step: Step) -> Smoothness:
    given = step.smoothness
    if given is None:
        return problem.smoothness
    tables = [name for name, parameter in problem.parameters.items() if parameter.axes]
    if not isinstance(given, Mapping):
        return dict.fromkeys(tables, given)
    found = {name: matching(given, name, None) for name in tables}
    return {**problem.smoothness, **{name: factor for name, factor in found.items() if factor is not None}}


def _active(
    criteria: Sequence[Criterion], given: Sequence[str | int] | Mapping[str | int, float] | None
) -> tuple[Criterion, ...]:
    """The criteria that count in a step, with their weights there."""
    if given is None:
        return tuple(criteria)
    weights = given if isinstance(given, Mapping) else dict.fromkeys(given)
    found = []
    for position, criterion in enumerate(criteria, 1):
        keys = [key for key in (position, criterion.node) if key in weights]
        if keys:
            weight = weights[keys[0]]
            found.append(criterion if weight is None else replace(criterion, weight=weight))
    return tuple(c for c in found if c.weight > 0)


def check_steps(problem: Problem, steps: Sequence[Step]) -> list[Finding]:
    """What in a sequence does not fit the problem."""
    if not steps:
        return []
    found = check_shared_axes(problem.free_axes, problem.free_names)
    return found + [f for place, step in enumerate(steps, 1) for f in _Checking(problem, step, place).findings()]


class _Checking:
    """The names and shapes in one step."""

    def __init__(self, problem: Problem, step: Step, number: int) -> None:
        self.problem, self.step = problem, step
        self.place = f"step {number}"
        self.found: list[Finding] = []

    def findings(self) -> list[Finding]:
        step, used = self.step, self.problem.model.graph.parameters
        self._patterns("free", step.free or (), used, " that the function uses")
        self._patterns("lock", step.lock, self.problem.parameters)
        for key in ("smoothness", "grid_reduction"):
            given = getattr(step, key)
            if isinstance(given, Mapping):
                self._patterns(key, given, self.problem.parameters)
                self._an_axis_each(key, given)
        self._masks()
        self._criteria()
        if not self.found:
            self._purpose()
        return self.found

    def _report(self, key: str, message: str, remedy: str = "") -> None:
        self.found.append(Finding(f"{self.place} {key}".strip(), message, remedy))

    def _patterns(self, key: str, patterns: Iterable[str], names: Collection[str], which: str = "") -> None:
        for pattern in patterns:
            if not any(name == pattern or fnmatchcase(name, pattern) for name in names):
                self._report(key, f"{pattern} matches no parameter{which}", nearest(pattern, names))

    def _an_axis_each(self, key: str, given: Mapping[str, object]) -> None:
        for name, parameter in self.problem.parameters.items():
            one, axes = matching(given, name, None), len(parameter.axes)
            if isinstance(one, Sequence) and not isinstance(one, str) and axes and len(one) != axes:
                self._report(
                    f"{key} {name}", f"{list(one)} are {len(one)} numbers for {axes} axes", "Give one an axis."
                )

    def _masks(self) -> None:
        for name, parameter in self.problem.parameters.items():
            mask = matching(self.step.lock, name, None)
            if mask is not None and np.shape(mask) not in ((), parameter.values.shape):
                shapes = f"{list(np.shape(mask))}, the parameter {list(parameter.values.shape)}"
                self._report(f"lock {name}", f"the mask has the shape {shapes}", "Give one entry a grid point.")

    def _criteria(self) -> None:
        nodes = [criterion.node for criterion in self.problem.criteria]
        given = self.step.criteria or ()
        for key in given:
            if isinstance(key, int):
                if not 1 <= key <= len(nodes):
                    self._report(
                        "criteria", f"there is no criterion {key}", f"They are counted from 1 to {len(nodes)}."
                    )
            elif key not in nodes:
                remedy = nearest(key, nodes) or f"The criteria are on {', '.join(nodes)}."
                self._report("criteria", f"there is no criterion on {key}", remedy)
        for key, weight in given.items() if isinstance(given, Mapping) else ():
            if not 0 <= weight < np.inf:
                self._report(f"criteria {key}", f"the weight {weight} must be a number from 0 on")

    def _purpose(self) -> None:
        """Whether anything is left to fit, and something to fit it to."""
        made = step_problem(self.problem, self.step)
        if not made.criteria:
            self._report("criteria", "no criterion has a weight above 0", "Name at least one.")
        if not made.free_names:
            self._report("free", "no parameter that the function uses is free", "Free at least one.")

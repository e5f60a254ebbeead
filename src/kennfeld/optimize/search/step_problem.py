"""Problems of the steps of a sequence: their checks, what they fit, and tables on every nth of their breakpoints.

Tables of a step with grid reduction are interpolated back to the full grid afterwards.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from glob import escape

import numpy as np

from kennfeld.base.arrays import Bool, Int
from kennfeld.base.errors import Finding, Findings, Location
from kennfeld.base.formatting import nearest
from kennfeld.domain.axis import Axis
from kennfeld.domain.constraints import Equality, Shape, Term
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.free_axes import with_fixed_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.optimize.limits.linear_limits import grid_points
from kennfeld.optimize.problem.options import Step, matching
from kennfeld.optimize.problem.problem import Factor, Problem, Smoothness
from kennfeld.optimize.problem.validation import check_shared_axes


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

    def fixed(name: str) -> bool:
        return name in used and name not in free

    constraints: list[Shape | Equality] = []
    for constraint in problem.constraints:
        if isinstance(constraint, Shape):
            constraints += [] if fixed(constraint.parameter) else [constraint]
        else:
            constants = [_value(problem.parameters[t.parameter], t) for t in constraint.terms if fixed(t.parameter)]
            terms = [term for term in constraint.terms if not fixed(term.parameter)]
            constraints += [Equality(terms, constraint.value - sum(constants))] if terms else []
    pins = tuple(pin for pin in problem.pins if not fixed(pin.parameter))
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
    locked = [
        problem.parameters[name].changed(
            # locked throughout only if each step that fits the parameter locks it
            locked=np.logical_and.reduce([v.parameters[name].locked for v in variants if name in v.free_names])
        )
        for name in names
    ]
    # `free` are patterns, and names may contain their special characters
    free = tuple(escape(name) for name in names)
    result = replace(problem, free=free, parameters=problem.parameters.with_parameters(*locked))
    shared = [key for key, axis in result.free_axes.items() if check_shared_axes({key: axis}, result.free_names)]
    return with_fixed_limits(replace(result, parameters=with_fixed_axes(result.parameters, shared)))


def _locked(problem: Problem, step: Step) -> list[Parameter]:
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
    if selection is None:
        return tuple(criteria)
    weights = selection if isinstance(selection, Mapping) else dict.fromkeys(selection)
    selected = []
    for number, criterion in enumerate(criteria, 1):
        # a criterion is selected by its number or by its node
        key = number if number in weights else criterion.node
        if key in weights:
            weight = weights[key]
            selected.append(criterion if weight is None else replace(criterion, weight=weight))
    return tuple(c for c in selected if c.weight > 0)


def check_steps(problem: Problem, steps: Sequence[Step]) -> list[Finding]:
    """Return the findings on steps that do not fit the problem."""
    if not steps:
        return []
    findings = check_shared_axes(problem.free_axes, problem.free_names)
    return findings + [f for number, step in enumerate(steps, 1) for f in _StepCheck(problem, step, number).run()]


class _StepCheck:
    def __init__(self, problem: Problem, step: Step, number: int) -> None:
        self.problem, self.step, self.number = problem, step, number
        self.findings = Findings()

    def run(self) -> Findings:
        step, parameters = self.step, self.problem.parameters
        self._check_patterns("free", step.free or (), self.problem.model.graph.parameters, " that the function uses")
        self._check_patterns("lock", step.lock, parameters)
        for key in ("smoothness", "grid_reduction"):
            by_parameter = getattr(step, key)
            if isinstance(by_parameter, Mapping):
                self._check_patterns(key, by_parameter, parameters)
                for name, parameter in parameters.items():
                    value, axes = matching(by_parameter, name, None), len(parameter.axes)
                    if isinstance(value, Sequence) and not isinstance(value, str) and axes and len(value) != axes:
                        message = f"must have one number for each of {axes} axes, got {list(value)}"
                        self._report(f"{key} {name}", message)
        for name, parameter in parameters.items():
            mask, shape = matching(step.lock, name, None), parameter.values.shape
            if mask is not None and np.shape(mask) not in ((), shape):
                message = f"the mask has shape {list(np.shape(mask))}, but the parameter has {list(shape)}"
                self._report(f"lock {name}", message, "Give one entry per grid point.")
        self._check_criteria()
        if not len(self.findings):
            fitted = step_problem(self.problem, step)
            if not fitted.criteria:
                self._report("criteria", "no criterion has a weight > 0", "Select at least one.")
            if not fitted.free_names:
                self._report("free", "no parameter that the function uses is free", "Free at least one.")
        return self.findings

    def _report(self, key: str, message: str, remedy: str = "") -> None:
        self.findings.error(Location(f"step {self.number}", path=key), message, remedy)

    def _check_patterns(self, key: str, patterns: Iterable[str], names: Collection[str], which: str = "") -> None:
        for pattern in patterns:
            if not any(name == pattern or fnmatchcase(name, pattern) for name in names):
                self._report(key, f"{pattern} matches no parameter{which}", nearest(pattern, names))

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


def kept_breakpoints(count: int, factor: int) -> Int:
    """Choose the breakpoints, Int[kept], if every nth is kept: the ends, and others spread evenly between them.

    >>> kept_breakpoints(10, 2), kept_breakpoints(6, 2), kept_breakpoints(9, 2), kept_breakpoints(3, 5)
    (array([0, 2, 4, 7, 9]), array([0, 2, 5]), array([0, 2, 4, 6, 8]), array([0, 2]))
    """
    # both ends at least
    size = min(count, max(2, -(-count // factor)))
    return np.asarray(np.round(np.linspace(0, count - 1, size)).astype(np.int64))


def reduce_table(parameter: Parameter, factors: Sequence[int], points: Sequence[Int] = ()) -> Parameter:
    """Reduce a table to the kept breakpoints, with the bounds and locks of these grid points.

    Those of the grid `points`, given as flat indices, are always kept. Axes leave their group, whose other tables keep
    all breakpoints.
    """
    # coordinates along each axis of grid points that must stay
    needed = [np.unravel_index(each, parameter.values.shape) for each in points]
    places = [
        np.unique(np.concatenate([kept_breakpoints(len(axis), factor), *(at[i] for at in needed)]))
        for i, (axis, factor) in enumerate(zip(parameter.axes, factors, strict=True))
    ]
    if all(place.size == len(axis) for place, axis in zip(places, parameter.axes, strict=True)):
        return parameter
    chosen = np.ix_(*places)
    axes = [
        Axis(axis.breakpoints[place], axis.input, axis.unit) for axis, place in zip(parameter.axes, places, strict=True)
    ]
    arrays = {name: getattr(parameter, name)[chosen] for name in ("values", "lower", "upper", "locked")}
    return parameter.changed(axes=tuple(axes), **arrays)


def refine_table(coarse: Parameter, like: Parameter) -> Parameter:
    """Interpolate a reduced table to all grid points of `like`, whose locked values and bounds are kept."""
    values = coarse.values
    for i, (before, after) in enumerate(zip(coarse.axes, like.axes, strict=True)):
        if len(before) != len(after):
            place = position(after.breakpoints, before.breakpoints, "clip")
            weights = cell_weights(place, len(before))[0]
            values = np.moveaxis(np.tensordot(weights, values, axes=(1, i)), 0, i)
    # interpolation between kept grid points may pass bounds of those between them
    return like.with_values(np.where(like.locked, like.values, np.clip(values, like.lower, like.upper)))


def penalty_ratio(full: Parameter, coarse: Parameter, axis: int) -> float:
    """Return the ratio of the roughness along an axis on the coarse grid to that on the full grid, for one surface.

    A surface with the second derivative c along the axis has second differences c h^2, h being the mean spacing, on
    even and on uneven axes; so R = lines (N - 2) / N (c h^2)^2. The ratio is exact if c is constant. For a curve of
    many points on twice the spacing it is 16. It is 1 if a grid is too small to have a roughness.
    """
    sizes = []
    for table in (full, coarse):
        points = table.axes[axis].breakpoints
        spacing = float(points[-1] - points[0]) / max(points.size - 1, 1)
        # lines (N - 2) / N h^4, without the common factor c^2
        sizes.append(table.size / points.size * max(points.size - 2, 0) / points.size * spacing**4)
    return sizes[1] / sizes[0] if min(sizes) > 0 else 1.0


def reduce_problem(problem: Problem, factors: Mapping[str, Sequence[int]]) -> Problem:
    """Return the problem with the named tables on coarse grids.

    Smoothness factors are scaled so that a surface keeps its penalty; automatic ones are chosen on the coarse grid.
    Breakpoints around pins and around values in equalities are kept, so that these can be satisfied as before; so is
    the grid of a table whose values are summed.
    """
    changed: list[Parameter] = []
    rescaled: dict[str, list[Factor]] = {}
    for name, reductions in factors.items():
        full = problem.parameters[name]
        table = reduce_table(full, reductions, list(_needed(problem, name)))
        if table is not full:
            changed.append(table)
            settings = enumerate(zip(problem.automatic(name), problem.factors(name), strict=True))
            rescaled[name] = ["auto" if auto else f / penalty_ratio(full, table, i) for i, (auto, f) in settings]
    if not changed:
        return problem
    return replace(
        problem,
        parameters=problem.parameters.with_parameters(*changed),
        smoothness={**problem.smoothness, **rescaled},
        restraints={name: each for name, each in problem.restraints.items() if name not in rescaled},
    )


def _needed(problem: Problem, name: str) -> Iterator[Int]:
    """Return the grid points used by pins and equalities."""
    terms = [Term(pin.parameter, pin.at) for pin in problem.pins]
    terms += [term for each in problem.constraints if isinstance(each, Equality) for term in each.terms]
    for term in terms:
        if term.parameter == name:
            yield grid_points(problem.parameters[name], term.at)[0]


def refine_parameters(coarse: ParameterSet, full: ParameterSet) -> ParameterSet:
    """Interpolate reduced tables to the grids of `full`."""
    return full.with_parameters(
        *(
            full[name].with_values(table.values)
            if table.values.shape == full[name].values.shape
            else refine_table(table, full[name])
            for name, table in coarse.items()
        )
    )

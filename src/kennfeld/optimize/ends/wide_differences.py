"""Differences over wide steps, for called functions whose own slopes say nothing about whole simulations.

An event of an FMU, a relay or a counter changes results at a sample that depends on parameters. Slopes within a sample,
and differences over tiny steps, do not include that the sample moves: a descent may end where no slope is left although
the cost falls not far away. Costs at a few wide steps from the end show this. The search then goes on along differences
over such steps, which shrink from one descent to the next.
"""

from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.graph.traversal import dependents
from kennfeld.optimize.solver.levenberg_marquardt import Report, SolverResult, SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.jumps import MAX_NAMES, global_search_remedy
from kennfeld.optimize.strategies.output_limits import OutputLimits
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective

COMPARED = 0.01  # step at which slopes are compared, relative to the size of a value
DISAGREEMENT = 0.1  # of a slope, from which it says nothing about whole simulations
STEPS = (0.3, 0.1, 0.03, 0.01, 0.003, 0.001)  # of the differences, relative to the size of a value
MAX_VALUES = 24  # values whose slopes are compared
CHANGED = "The search went on along differences of whole simulations, because the slopes of called functions mislead."


def called_values(compiled: CompiledProblem, limits: LinearLimits) -> Int:
    """Find the places of the movable values on which called functions depend, Int[values]."""
    graph, problem = compiled.problem.graph, compiled.problem
    functions = [at for at, node in enumerate(graph.nodes) if node.op == "external"]
    if not functions:
        return np.zeros(0, dtype=np.int64)
    movable = np.flatnonzero(limits.movable)
    reaching = np.zeros(limits.lower.size, dtype=bool)
    for name in problem.free_names:
        reached = dependents(graph, lambda node, name=name: node.parameter == name)  # type: ignore[misc]
        at = compiled.values.offsets[name]
        reaching[at : at + problem.parameters[name].size] = not reached.isdisjoint(functions)
    return movable[reaching[movable]]


def misleading_values(
    objective: LeastSquaresObjective, compiled: CompiledProblem, values: Float, limits: LinearLimits
) -> Int:
    """Find the places, Int[values], of values of called functions whose slopes are not those of wide steps.

    With a robust loss, differences of weighted residuals contain those of the weights, which slopes leave out.
    """
    places = called_values(compiled, limits)[:MAX_VALUES]
    square = all(output.loss == "square" for output in compiled.kernel.outputs)
    if not places.size or not objective.uses_qr or not square:
        return places[:0]
    own = objective.rows(values)[1][:, places]
    wide = DifferenceObjective(compiled, limits, COMPARED).jacobian(values, places)
    # relative to the larger of both columns, as one may be 0
    sizes = np.maximum(np.linalg.norm(own, axis=0), np.linalg.norm(wide, axis=0))
    differ = np.linalg.norm(own - wide, axis=0) > DISAGREEMENT * sizes
    return np.asarray(places[differ], dtype=np.int64)


def find_misleading_slopes(compiled: CompiledProblem, places: Int) -> list[Finding]:
    """Return a warning that names the parameters of `misleading_values`, if there are any."""
    if not places.size:
        return []
    problem = compiled.problem
    ends = {name: compiled.values.offsets[name] + problem.parameters[name].size for name in problem.free_names}
    names = [n for n, end in ends.items() if np.any((places < end) & (places >= compiled.values.offsets[n]))]
    message = (
        f"the slopes of called functions by {join_names(names, MAX_NAMES)} are not those of whole simulations, because "
        "events move with parameters: the cost has steps, and the search may have ended beside its minimum"
    )
    return [
        Finding(
            Location.of_file(problem.model.source), message, global_search_remedy(problem, names), severity="warning"
        )
    ]


def _size(values: Float, place: int) -> float:
    return abs(float(values[place])) or 1.0


def descend_by_differences(
    compiled: CompiledProblem,
    end: SolverResult,
    limits: LinearLimits,
    outputs: OutputLimits | None,
    settings: SolverSettings,
    report: Report,
) -> SolverResult:
    """Descend from an end along differences over shrinking steps; return the end if that does not lower the cost."""
    ends, best = [end], end
    for step in STEPS:
        ends.append(
            levenberg_marquardt(DifferenceObjective(compiled, limits, step), best.values, limits, settings, report)
        )
        # each width begins at the best values so far
        best = ends[-1] if ends[-1].cost < best.cost else best
        if ends[-1].status == "stopped":
            break
    if best is end or (outputs is not None and not outputs.is_satisfied(best.values)):
        return end.with_effort_of(ends)
    return replace(best, message=f"{best.message} {CHANGED}").with_effort_of(ends)


class DifferenceObjective(LeastSquaresObjective):
    """An objective whose Jacobian consists of central differences over steps relative to the size of each value."""

    def __init__(self, compiled: CompiledProblem, limits: LinearLimits, step: float) -> None:
        super().__init__(compiled)
        self.supports_acceleration = self.supports_secant = False
        self._limits, self._step = limits, step

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Compute residuals and Jacobian, Float[residuals, free], with those of the roughness below."""
        residual, movable = self.residual(values), np.flatnonzero(self._limits.movable)
        jacobian = np.zeros((residual.size, values.size))
        jacobian[:, movable] = self.jacobian(values, movable)
        return residual, jacobian

    def jacobian(self, values: Float, places: Int) -> Float:
        """Return the columns of some values, Float[residuals, places]."""
        columns = []
        for place in places.tolist():
            ends = []
            for sign in (1, -1):
                changed = values.copy()
                changed[place] += sign * self._step * _size(values, place)
                ends.append(self._limits.clip(changed))
            # clipped at a bound, the step is shorter, or one-sided
            distance = ends[0][place] - ends[1][place]
            columns.append((self.residual(ends[0]) - self.residual(ends[1])) / distance)
        return np.stack(columns, axis=1)

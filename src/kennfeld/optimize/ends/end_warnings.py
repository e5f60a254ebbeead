"""Warnings about the end of a fit, and remarks for its message."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.criteria import ROBUST_LOSSES
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.ends.doubtful_ends import FREE_ALL, HELD, LIMITED, find_poor_fits, find_slopes, steepness
from kennfeld.optimize.ends.equal_neurons import find_equal_neurons
from kennfeld.optimize.ends.kinks import find_kinks, values_at_kinks
from kennfeld.optimize.ends.repeats import repeat_findings
from kennfeld.optimize.ends.runaways import find_runaways
from kennfeld.optimize.ends.wide_differences import find_misleading_slopes
from kennfeld.optimize.ends.worsening import admissible_share, find_worsening
from kennfeld.optimize.limits.linear_limits import touching_pairs
from kennfeld.optimize.limits.projection import leaves_room
from kennfeld.optimize.problem.doubtful_arguments import find_crossed, find_short_lags
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.validation import dataset_location
from kennfeld.optimize.quality.quality import Quality
from kennfeld.optimize.solver.certificate import Certificate
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.jumps import find_jumps
from kennfeld.optimize.strategies.output_limits import OutputLimits
from kennfeld.optimize.sums.compiled import CompiledProblem, smoothable
from kennfeld.optimize.sums.objective import LeastSquaresObjective

MAX_LISTED = 5
NEARER, SAME = 0.1, 1e-9  # share of the way back to the start, and change of the cost that is none


def scored_nodes(problem: Problem) -> set[str]:
    """Return the nodes of the criteria with a weight."""
    return {criterion.node for criterion in problem.criteria if criterion.weight > 0}


def targeted_nodes(problem: Problem) -> set[str]:
    """Return those of them that are to meet their target, not only to stay below it."""
    return scored_nodes(problem) - {criterion.node for criterion in problem.criteria if criterion.loss == "excess"}


def robust_nodes(problem: Problem) -> set[str]:
    """Return the nodes of criteria whose loss counts large errors less."""
    return {criterion.node for criterion in problem.criteria if criterion.loss in ROBUST_LOSSES}


@dataclass(frozen=True)
class EndWarnings:
    """The warnings about the end of a search that did not fail."""

    compiled: CompiledProblem
    objective: LeastSquaresObjective
    limits: LinearLimits
    options: Options
    end: SolverResult
    outputs: OutputLimits | None = None

    def find(
        self,
        fitted: ParameterSet,
        quality: Sequence[Quality],
        certificate: Certificate | None,
        misleading: Int | None,
    ) -> tuple[Finding, ...]:
        """Return all warnings.

        Args:
            fitted: the parameters at the end.
            quality: of all criteria on all datasets.
            certificate: of an end that counts as converged, if there is one.
            misleading: see `misleading_values`; None if slopes do not matter, because the data are met exactly or the
                search did not use them.
        """
        problem, start, values = self.compiled.problem, self.objective.start, self.end.values
        before, after = (self.objective.data_cost(each) for each in (start, values))
        outweighed = after > before
        # only a start that is rough leaves room for smoothness to raise the cost of the data
        smooth = outweighed and self.compiled.roughness.cost(start) > 0
        share = admissible_share(self.compiled, self.limits, values, before) if smooth else None
        steep = steepness(self.compiled.residuals, int(self.limits.movable.sum()))
        moved, in_steps = not np.array_equal(values, start), bool(self.options.steps)
        unsmoothed = self.options.continuation == "off" and smoothable(problem)
        slopes = tuple(find_slopes(certificate, steep, moved=moved, in_steps=in_steps, unsmoothed=unsmoothed))
        # the last step of a sequence may fit a part of the values, which explains slopes that are left
        partial_end = FREE_ALL if in_steps and slopes else ""
        worse = tuple(
            find_worsening(quality, scored_nodes(problem), outweighed=outweighed, share=share, partial_end=partial_end)
        )
        return (
            *worse,
            *(
                ()
                if outweighed
                else find_poor_fits(
                    quality, targeted_nodes(problem), robust_nodes(problem), self._what_limits, self._have_faded
                )
            ),
            *(() if worse and partial_end and outweighed else slopes),
            *(() if misleading is None else self._slopes(misleading)),
            *(() if problem.partitions is not None else repeat_findings(problem, dataset_location)),
            *find_runaways(self.compiled, self.objective, start, values),
            *find_equal_neurons(problem.model.graph, problem.parameters, fitted),
            *find_short_lags(problem, fitted),
            *find_crossed(problem, fitted),
        )

    def _what_limits(self) -> str:
        """Return a remedy if all values are at bounds or determined by limits, or limits of outputs are reached."""
        values, limits = self.end.values, self.limits
        if not leaves_room(values, limits, (limits.lower < values) & (values < limits.upper)):
            return HELD
        return "" if self.outputs is None or self.outputs.near_active(values) is None else LIMITED

    def _have_faded(self) -> bool:
        """Return whether parameters have lost all their effect since the start, also a tenth of the way back there.

        At a minimum, as that of a^2 at a = 0, only the slope vanishes.
        """
        values = self.end.values
        back = self.objective.with_effect(values, self.objective.start)
        # at a minimum without slope, the cost would rise on the way back
        nearer = values + NEARER * (back - values)
        return not np.array_equal(back, values) and self.objective.cost(nearer) < (1 + SAME) * self.end.cost

    def _slopes(self, misleading: Int) -> Iterator[Finding]:
        """Yield warnings about slopes that do not describe how the cost changes."""
        yield from find_jumps(self.compiled.problem)
        yield from find_misleading_slopes(self.compiled, misleading)
        # small problems, whose Jacobian is at hand
        if self.objective.uses_qr:
            at_kinks = values_at_kinks(self.objective, self.end.values, self.objective.start, self.limits)
            yield from find_kinks(self.compiled, at_kinks)


def describe_uninformed(informed: Mapping[str, Bool], parameters: ParameterSet) -> str:
    """Return a sentence on the number of values of each parameter that kept their start without a lock."""
    counts = {name: int((~known & ~parameters[name].locked).sum()) for name, known in informed.items()}
    listed = ", ".join(f"{count} of {name}" for name, count in counts.items() if count)
    if not listed:
        return ""
    return f"Not determined by data or smoothness, kept at their start values: {listed}."


def describe_close_breakpoints(problem: Problem, parameters: ParameterSet) -> str:
    """Return sentences on free axes with breakpoints that ended at their minimum distance."""
    sentences = []
    for key, before in problem.free_axes.items():
        table, axis = before.places[0]
        points: Float = parameters[table].axes[axis].breakpoints
        close = touching_pairs(points, before.axis.least_distance)
        if close.size and not np.array_equal(points, before.axis.breakpoints):
            pairs = ", ".join(f"{points[i]:g} and {points[i + 1]:g}" for i in close[:MAX_LISTED])
            sentences.append(f"Breakpoints of {key} ended at their minimum distance: {pairs}.")
            sentences.append("Consider fewer breakpoints.")
    return " ".join(sentences)

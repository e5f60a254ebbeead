"""A trial of what is proposed for a project: the level of each table, and where the function looks it up.

Tables over inner nodes get axes from the values that these nodes take, and all tables start from the level at which one
number for each of them fits best, so that the first evaluation shows an error of the size of the data.
"""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from kennfeld.app.session.live_model import LiveModel
from kennfeld.app.session.proposal import Range
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.factors import factors
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.lookup_coverage import Coverage
from kennfeld.project.model import initial_level

MOST_SAMPLES = 4000  # of the training data that the levels are fitted to
MOST_STEPS = 12
PADDING = 0.2  # of the range of an inner node, on each side of it
SHARE = 1e-3  # of the weight of all samples that the roughness of a table gets


@dataclass(frozen=True, eq=False)
class Trial:
    """The result of a trial of proposed parameters.

    Attributes:
        levels: the number at which each starts.
        ranges: by table where each coordinate of its lookups lies, with a margin; None if it never is a number.
        smoothness: by table a factor that is weak beside the data.
    """

    levels: Mapping[str, float]
    ranges: Mapping[str, Sequence[Range | None]]
    smoothness: Mapping[str, float]


def try_out(problem: Problem, names: Collection[str], *, fitted: bool = True) -> Trial:
    """Evaluate a function with one number for each of some parameters.

    Args:
        problem: with tables of any axes for these parameters.
        names: the parameters.
        fitted: fit the numbers to the targets of the problem.
    """
    model = LiveModel(problem)
    start = {name: initial_level(problem.model.graph, name) for name in names}
    levels = _fit_levels(model, start) if fitted else start
    parameters = _at_levels(problem.parameters, levels)
    tables = [name for name in names if problem.parameters[name].axes]
    samples, spread = _target_spread(model)
    multiplying = factors(problem.model.graph)
    # a factor of a thing of the size of the target acts as strongly as its level is small
    weights = {name: (spread / levels[name]) ** 2 if name in multiplying and levels[name] else 1.0 for name in tables}
    smoothness = {name: float(f"{max(SHARE * samples * weights[name], 1e-12):.1g}") for name in tables}
    return Trial(levels, _ranges(model, parameters, tables), smoothness)


def _at_levels(parameters: ParameterSet, levels: Mapping[str, float]) -> ParameterSet:
    changed = (parameters[name].with_values(np.full(parameters[name].values.shape, levels[name])) for name in levels)
    return parameters.with_parameters(*changed)


def _fit_levels(model: LiveModel, start: Mapping[str, float]) -> dict[str, float]:
    """Fit one number for each parameter to the training data; the start if that does not make the errors smaller."""
    from scipy.optimize import least_squares

    names, parameters = list(start), model.problem.parameters
    initial = np.array([start[name] for name in names])
    if not names or sum(recording.count for recording in model.recordings) <= len(names):
        return dict(start)

    def errors(levels: Float) -> Float:
        evaluation = model.evaluate(_at_levels(parameters, dict(zip(names, levels.tolist(), strict=True))))
        own = [
            _thinned(row) / scale
            for number, part in enumerate(evaluation.errors)
            if model.recordings[number].use == "training"
            for row, scale in zip(part, scales, strict=True)
        ]
        values = np.concatenate([*own, np.zeros(1)])
        return np.where(scored, np.nan_to_num(values, nan=1e6, posinf=1e6, neginf=-1e6), 0.0)

    scales = [_spread(model, number) or 1.0 for number in range(len(model.problem.criteria))]
    targets = [
        _thinned(recording.targets[number]) if recording.targets.size else np.zeros(0)
        for recording in model.recordings
        if recording.use == "training"
        for number in range(len(scales))
    ]
    scored = np.isfinite(np.concatenate([*targets, np.zeros(1)]))
    with np.errstate(all="ignore"):
        before = errors(initial)
        # its first step may be 100 times the start, as tables of other units need
        fit = least_squares(errors, initial, method="lm", x_scale="jac", max_nfev=MOST_STEPS * (len(names) + 1))
    better = np.isfinite(fit.x).all() and 2 * fit.cost < float(before @ before)
    return {name: float(f"{level:.3g}") for name, level in zip(names, fit.x if better else initial, strict=True)}


def _thinned(values: Float) -> Float:
    return values[:: max(1, values.size // MOST_SAMPLES)]


def _spread(model: LiveModel, criterion: int) -> float:
    """Return the standard deviation of the target of a criterion over the training data."""
    own = [r.targets[criterion] for r in model.recordings if r.use == "training" and r.targets.size]
    known = np.concatenate([values[np.isfinite(values)] for values in own]) if own else np.zeros(0)
    return float(known.std()) if known.size else 0.0


def _target_spread(model: LiveModel) -> tuple[int, float]:
    """Return the number of training samples, and the standard deviation of the first target."""
    samples = sum(recording.count for recording in model.recordings if recording.use == "training")
    return samples, (_spread(model, 0) if model.problem.criteria else 0.0) or 1.0


def _ranges(model: LiveModel, parameters: ParameterSet, tables: Collection[str]) -> dict[str, list[Range | None]]:
    coverage = Coverage(model.problem.graph, parameters, tables)
    ends: dict[str, list[list[float]]] = {name: [[] for _ in parameters[name].axes] for name in tables}
    for recording in model.recordings:
        if recording.use != "training":
            continue
        for block in coverage.blocks(recording.bound):
            for axis, values in zip(ends[block.name], block.coordinates, strict=True):
                known = values[np.isfinite(values)]
                axis += [float(known.min()), float(known.max())] if known.size else []
    return {name: [_padded(axis) for axis in axes] for name, axes in ends.items()}


def _padded(ends: Sequence[float]) -> Range | None:
    if not ends:
        return None
    low, high = min(ends), max(ends)
    margin = PADDING * (high - low or abs(high) or 1.0)
    return Range(low - margin, high + margin)

"""Whether the step of a model is short enough where a solver with a fixed step takes the place of its own."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import Finding, InputError
from kennfeld.models import Model
from kennfeld.optimize import Problem
from kennfeld.optimize.data.binding import Bound
from kennfeld.optimize.scoring import Nodes
from kennfeld.project.function import read_function
from kennfeld.project.schema import ProjectFile

__all__ = ["step_warning"]

_NEAR = 0.01  # of what a node varies
_USUAL = 0.95  # of the samples; events that move by a step make large differences in few
_HALVINGS = 6
_MOST_SAMPLES = 5_000
_MOST_STEPS = 1_000_000  # of one run


class _Gap(NamedTuple):
    """How far a node of two runs is apart: `share` of what it varies."""

    node: str
    share: float


def step_warning(file: ProjectFile, problem: Problem) -> Iterator[Finding]:
    """A warning where half the step gives other values, with the step that does not, as far as one is found.

    Each run starts with the values of the project, over the beginning of the first training dataset. Inputs keep still
    within the original step, so that the solver alone makes the difference.
    """
    bound = next(iter(problem.training), None) if problem.model.stepped else None
    if bound is None or "dt" not in bound.clock or bound.hold is not None or bound.count < 2:
        return
    step = problem.model.step or float(np.median(bound.clock["dt"]))
    trial = _Trial(file, problem, bound, step)
    first = trial.gap(1)
    if first is None or first.share <= _NEAR:
        return
    halvings = (2**k for k in range(1, _HALVINGS))
    parts = next((n for n in halvings if (gap := trial.gap(n)) is not None and gap.share <= _NEAR), 0)
    what = f"with half the step of {step:g} s, {_told(first)}: the step is too long for a solver with a fixed one"
    mend = f"Write step = {step / parts:g} under [model]." if parts else "Try much shorter ones: step under [model]."
    yield Finding(file.place("[model] step"), what, mend, severity="warning")


def _told(gap: _Gap) -> str:
    if np.isfinite(gap.share):
        return f"{gap.node} differs by {gap.share:.0%} of what it varies"
    return f"{gap.node} is a number where it was none, or the other way round"


class _Trial:
    """Runs of a problem's model with parts of its step, the inputs held."""

    def __init__(self, file: ProjectFile, problem: Problem, bound: Bound, step: float) -> None:
        self.file, self.problem, self.bound, self.step = file, problem, bound, step
        names = problem.model.graph.names
        self.nodes = [one for one in dict.fromkeys(c.node for c in problem.criteria) if one in names]
        self._runs: dict[int, Float | None] = {1: self._run(problem.model, 1)}

    def gap(self, parts: int) -> _Gap | None:
        """The largest difference between a part of the step and half of it; None where one cannot be run."""
        one, other = self._values(parts), self._values(2 * parts)
        if one is None or other is None:
            return None
        gaps = [_Gap(name, _share(a, b)) for name, a, b in zip(self.nodes, one, other, strict=True)]
        return max(gaps, key=lambda gap: gap.share, default=None)

    def _values(self, parts: int) -> Float | None:
        if parts not in self._runs:
            model = self._model(parts) if parts * self._count <= _MOST_STEPS else None
            self._runs[parts] = self._run(model, parts) if model is not None else None
        return self._runs[parts]

    def _model(self, parts: int) -> Model | None:
        entry = replace(self.file.model, step=self.step / parts)
        findings: list[Finding] = []
        known, surrogates = list(self.problem.parameters), self.problem.model.surrogates
        try:
            found = read_function(replace(self.file, model=entry), known, surrogates, findings, self.problem.parameters)
        except InputError:
            return None
        return found.model if found is not None and not findings else None

    @property
    def _count(self) -> int:
        return min(self.bound.count, _MOST_SAMPLES)

    def _run(self, model: Model, parts: int) -> Float:
        """The nodes of the criteria at the original samples, Float[nodes, samples]."""
        count = self._count
        columns = {name: np.repeat(values[:count], parts) for name, values in self.bound.columns.items()}
        columns["dt"] = columns["dt"] / parts
        if "t" in columns:
            columns["t"] = columns["t"] + columns["dt"] * np.tile(np.arange(parts), count)
        starts = [parts * int(start) for start in self.bound.starts if start < count]
        compiled = Nodes(model.graph, self.problem.parameters, self.nodes)
        with np.errstate(all="ignore"):
            return compiled.over(columns, parts * count, self.problem.parameters, starts)[:, ::parts]


def _share(one: Float, other: Float) -> float:
    """The usual difference over what the values vary; infinite where only one of both is a number."""
    known = np.isfinite(one)
    if not np.array_equal(known, np.isfinite(other)):
        return np.inf
    if not known.any():
        return 0.0
    varies = max(float(np.std(other[known])), 1e-9 * float(np.max(np.abs(other[known]))), 1e-300)
    return float(np.quantile(np.abs(one[known] - other[known]), _USUAL)) / varies

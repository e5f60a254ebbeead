"""How a model steps: its solver, and the step that hits the sample times of its blocks."""

import math
from collections.abc import Sequence

from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.simulink import blocks
from kennfeld.models.simulink.expressions.parameter_expressions import Expressions
from kennfeld.models.simulink.flattening.flat_model import FlatBlock
from kennfeld.models.simulink.lowering.continuous_states import SOLVERS
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES
from kennfeld.models.simulink.lowering.scheduling import (
    CONTINUOUS_BLOCK_TYPES,
    ModelClock,
    common_step,
    explicit_sample_time,
)
from kennfeld.models.simulink.reader.model_tree import StoredSolver
from kennfeld.models.simulink.signals import CONSTANT
from kennfeld.models.simulink.variables.mask_scope import Scope

__all__ = ["SolverSelection"]

_FIXED = {*SOLVERS, "ode8", "ode14x", "ode1be", "odeN", "FixedStepDiscrete", "FixedStepAuto"}
_STIFF = ("ode15s", "ode23s", "ode23t", "ode23tb", "ode14x", "ode1be", "odeN")
_TASKS = {"on": True, "off": False, "Auto": True, "MultiTasking": True, "SingleTasking": False}
_LEAST_SHARE = 1e-4  # of the shortest sample time, for a step that hits all of them
_CONTROLLERS = ("PID 1dof", "PID Controller", "PID Controller (with Approximate Derivative)", "PID 2dof")


class SolverSelection:
    """The `solver` and the `clock` of blocks whose model has these settings; `scope` is what the settings see.

    `replaced` says whether another solver takes the place of the model's. `substitutions` say what takes the place of
    what the model asks for, `remarks` which settings have no value. `found` are those substitutions that tell of a
    step, which a step of the user's own makes void.
    """

    def __init__(
        self, settings: StoredSolver, atoms: Sequence[FlatBlock], expressions: Expressions, scope: Scope
    ) -> None:
        self.settings = settings
        self.expressions = expressions
        self.scope = scope
        self.substitutions: list[str] = []
        self.remarks: list[str] = []
        self.found: list[str] = []
        continuous = any(map(_is_continuous, atoms))
        periods = _periods(atoms, expressions)
        name = settings.name
        fixed = name.casefold() in {one.casefold() for one in _FIXED}
        is_auto = name.casefold() == "fixedstepauto"
        self.solver = name if name in SOLVERS else "ode3" if is_auto else "ode4"
        self.replaced = continuous and name not in SOLVERS and not is_auto
        if self.replaced:
            self._replace_solver(fixed)
        step = self._fixed_step(periods, continuous) if fixed else self._common(periods)
        if step is not None and not fixed:
            self._instead(f"a variable step -> {step:g} s, the longest that hits all sample times")
        self.clock = ModelClock(step, continuous, _TASKS.get(settings.tasks) if fixed else False)

    def _replace_solver(self, fixed: bool) -> None:
        """Say that another solver takes the place of the model's."""
        name = self.settings.name
        data = " with a fixed step: the step is that of the data unless sample times ask for another"
        self.substitutions.append(f"{name or 'an unknown solver'} -> {self.solver}{'' if fixed else data}")
        if name in _STIFF:
            watch = "watch for steps that are too long for ode4; check compares with half the step"
            self.substitutions.append(f"{name} is for stiff models: {watch}")

    def _fixed_step(self, periods: list[float], continuous: bool) -> float | None:
        text = self.settings.fixed_step.strip()
        stated = self._number(text) if text not in ("", "auto") else None
        if stated is not None and stated > 0:
            return stated
        common = self._common(periods)
        if common is not None or not continuous:
            return common
        start, stop = (self._number(text) for text in (self.settings.start, self.settings.stop))
        return (stop - start) / 50 if start is not None and stop is not None and start < stop < math.inf else None

    def _common(self, periods: list[float]) -> float | None:
        """The longest step that hits all times; the shortest of them where such a step would be absurd."""
        step = common_step(periods)
        if step is None or step >= _LEAST_SHARE * min(periods):
            return step
        self._instead(f"no step hits all sample times: {min(periods):g} s is the shortest, others hit behind")
        return min(periods)

    def _instead(self, sentence: str) -> None:
        self.substitutions.append(sentence)
        self.found.append(sentence)

    def _number(self, text: str) -> float | None:
        try:
            found = self.expressions.numbers(text, self.scope)
        except EvaluationError:
            self.remarks.append(f"the solver's setting {text[:60]} has no value")
            return None
        return float(found.item()) if found.size == 1 else None


def _is_continuous(atom: FlatBlock) -> bool:
    """Whether a block has continuous states; a controller says so itself."""
    known = atom.kind in CONTINUOUS_BLOCK_TYPES or atom.kind in _CONTROLLERS
    return known and atom.block.value("TimeDomain") != "Discrete-time"


def _periods(atoms: Sequence[FlatBlock], expressions: Expressions) -> list[float]:
    """All sample times that blocks state, and the times between which pulses change."""
    found: list[float] = []
    for atom in atoms:
        try:
            rate = explicit_sample_time(atom, expressions, BLOCK_TYPES.get(atom.kind))
            found += [rate.period, rate.offset] if rate is not None else []
            found += blocks.sources.pulse_times(atom, expressions)
        except EvaluationError:
            continue
    return [period for period in found if 0 < period < CONSTANT]

"""Solver selection and the step that hits the sample times of all blocks."""

import math
from collections.abc import Sequence

from kennfeld.base.errors import Finding, Location
from kennfeld.graph.integration import SOLVERS
from kennfeld.importers.simulink.blocks.sources import pulse_times
from kennfeld.importers.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.lowering.registry import has_continuous_states
from kennfeld.importers.simulink.lowering.scheduling import ModelClock, explicit_sample_time
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.reader.model_tree import StoredSolver
from kennfeld.importers.simulink.signals import CONSTANT
from kennfeld.importers.simulink.variables.mask_scope import Scope
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.sample_times import common_step

_FIXED = {*SOLVERS, "ode14x", "ode1be", "odeN", "FixedStepDiscrete", "FixedStepAuto"}
_STIFF = ("ode15s", "ode23s", "ode23t", "ode23tb", "ode14x", "ode1be", "odeN")
_TASKS = {"on": True, "off": False, "Auto": True, "MultiTasking": True, "SingleTasking": False}
_MIN_STEP_RATIO = 1e-4  # of the shortest sample time, for a step that hits all of them
_CONTROLLERS = ("PID 1dof", "PID Controller", "PID Controller (with Approximate Derivative)", "PID 2dof")


class SolverSelection:
    """The `solver` and `clock` for a model's settings, evaluated in `scope`.

    `replaced` is True if the model's solver is not available. `substitutions` are sentences on what replaces the
    settings, `step_substitutions` those that a step given by the user makes void; `warnings` name settings without
    a value.
    """

    def __init__(
        self, settings: StoredSolver, flat_blocks: Sequence[FlatBlock], expressions: ParameterExpressions, scope: Scope
    ) -> None:
        self.settings = settings
        self.expressions = expressions
        self.scope = scope
        self.substitutions: list[str] = []
        self.warnings: list[Finding] = []
        self.step_substitutions: list[str] = []
        continuous = any(map(_is_continuous, flat_blocks))
        periods = _periods(flat_blocks, expressions)
        name = match_word(settings.name, (*SOLVERS, *_FIXED)) or settings.name
        fixed, is_auto = name in _FIXED, name == "FixedStepAuto"
        # the choice of FixedStepAuto for models with continuous states is ode3
        self.solver = name if name in SOLVERS else "ode3" if is_auto else "ode4"
        # without continuous states, no solver is used
        self.replaced = continuous and name not in SOLVERS and not is_auto
        if self.replaced:
            self._replace_solver(name, fixed)
        step = self._fixed_step(periods, continuous) if fixed else self._common_step(periods)
        if step is not None and not fixed:
            self._substitute(f"variable step -> {step:g} s, the longest step that hits all sample times")
        tasks = _TASKS.get(match_word(settings.tasks, _TASKS) or "") if fixed else False
        self.clock = ModelClock(step, continuous, tasks)

    def _replace_solver(self, name: str, fixed: bool) -> None:
        data = " with a fixed step: the step of the data unless sample times require another"
        self.substitutions.append(f"{name or 'an unknown solver'} -> {self.solver}{'' if fixed else data}")
        if match_word(name, _STIFF) is not None:
            watch = "check that the step is short enough for ode4 (kennfeld check compares with half the step)"
            self.substitutions.append(f"{name} is a solver for stiff models: {watch}")

    def _fixed_step(self, periods: list[float], continuous: bool) -> float | None:
        text = self.settings.fixed_step.strip()
        stated = self._number(text) if text and match_word(text, ["auto"]) is None else None
        if stated is not None and stated > 0:
            return stated
        common = self._common_step(periods)
        if common is not None or not continuous:
            return common
        # without sample times, Simulink divides the simulated time into 50 steps
        start, stop = (self._number(text) for text in (self.settings.start, self.settings.stop))
        return (stop - start) / 50 if start is not None and stop is not None and start < stop < math.inf else None

    def _common_step(self, periods: list[float]) -> float | None:
        """Return the longest step that hits all sample times, or their minimum if it would be too small."""
        step = common_step(periods)
        if step is None or step >= _MIN_STEP_RATIO * min(periods):
            return step
        self._substitute(f"no step hits all sample times: using the shortest, {min(periods):g} s; others are hit late")
        return min(periods)

    def _substitute(self, sentence: str) -> None:
        self.substitutions.append(sentence)
        self.step_substitutions.append(sentence)

    def _number(self, text: str) -> float | None:
        try:
            numbers = self.expressions.numbers(text, self.scope)
        except EvaluationError:
            message = f"the solver setting {text[:60]} has no value"
            self.warnings.append(Finding(Location(), message, severity="warning"))
            return None
        return float(numbers.item()) if numbers.size == 1 else None


def _is_continuous(flat: FlatBlock) -> bool:
    """Return True if a block has continuous states; PID controllers specify it in a field."""
    known = has_continuous_states(flat) or flat.type in _CONTROLLERS
    return known and not flat.block.is_set_to("TimeDomain", "Discrete-time")


def _periods(flat_blocks: Sequence[FlatBlock], expressions: ParameterExpressions) -> list[float]:
    """Return all specified sample times, and intervals between pulse edges, in s."""
    numbers: list[float] = []
    for flat in flat_blocks:
        try:
            rate = explicit_sample_time(flat, expressions)
            numbers += [rate.period, rate.offset] if rate is not None else []
            numbers += pulse_times(flat, expressions)
        except EvaluationError:
            continue
    return [period for period in numbers if 0 < period < CONSTANT]

"""Runs of a session: those that have ended, and the running or last one as it is shown."""

import time
from collections.abc import Mapping
from dataclasses import field

from kennfeld.analysis.extrapolation import Extrapolation
from kennfeld.analysis.validation_result import CrossValidation
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.fit.result import Result, TraceLine
from kennfeld.optimize.problem.problem import Problem


@dataclass(frozen=True, eq=False)
class Run:
    """A run that has ended.

    Attributes:
        number: counted from 1.
        before: the values at its start.
        result: its result.
        problem: what was calibrated, None if it is the present problem.
        extrapolation: use of surrogates outside their training data; None if it is not computed yet.
        ended: when it ended, in s since 1970.
        part: the values that were fitted, in words; empty if all were.
        seconds: from its start to its end, with the process that it ran in; 0 if unknown.
    """

    number: int
    before: ParameterSet
    result: Result
    problem: Problem | None = None
    extrapolation: tuple[Extrapolation, ...] | None = None
    ended: float = field(default_factory=time.time)
    part: str = ""
    seconds: float = 0.0

    @property
    def elapsed(self) -> float:
        """Elapsed time in s."""
        return self.seconds or self.result.seconds.total


@dataclass(frozen=True, eq=False)
class ValidationRun:
    """A cross-validation that has ended.

    Attributes:
        after: number of runs before it.
        result: its result.
        ended: when it ended, in s since 1970.
    """

    after: int
    result: CrossValidation
    ended: float = field(default_factory=time.time)


@dataclass
class Job:
    """The running or last calibration or cross-validation, as it is shown.

    Attributes:
        state: idle, running, stopping, or the status of the last result.
        message: a sentence on it.
        began: monotonic time of its start, in s.
        seconds: how long it has run.
        trace: the steps so far.
        preview: values of the best step so far, by parameter.
        problem: what is calibrated.
        validates: True for a cross-validation.
        part: the values that are fitted, in words; empty if all are.
    """

    state: str = "idle"
    message: str = ""
    began: float = 0.0
    seconds: float = 0.0
    trace: list[TraceLine] = field(default_factory=list)
    preview: Mapping[str, Float] = field(default_factory=dict)
    problem: Problem | None = None
    validates: bool = False
    part: str = ""

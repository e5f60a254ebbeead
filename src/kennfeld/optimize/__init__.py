"""Calibration: the problem, the solver, and the result."""

from typing import TYPE_CHECKING

from kennfeld.base.lazy_names import lazy_names
from kennfeld.domain.constraints import Equality, Limit, Pin, Shape, Term
from kennfeld.domain.criteria import Criterion, Region, Target

if TYPE_CHECKING:
    from kennfeld.optimize.api import calibrate, simulate
    from kennfeld.optimize.fit.result import (
        Checkpoint,
        CheckpointSink,
        Progress,
        Result,
        Seconds,
        StartResult,
        TraceLine,
    )
    from kennfeld.optimize.problem.options import Options, Step
    from kennfeld.optimize.problem.problem import Problem
    from kennfeld.optimize.quality.quality import Quality
    from kennfeld.optimize.quality.recording_quality import RecordingQuality, WorstStretch
    from kennfeld.optimize.search.multistart import run
    from kennfeld.optimize.solver.levenberg_marquardt import Stop
    from kennfeld.optimize.trust import Direction, NullSpace, Remedy, Trust

__all__ = [
    "Checkpoint",
    "CheckpointSink",
    "Criterion",
    "Direction",
    "Equality",
    "Limit",
    "NullSpace",
    "Options",
    "Pin",
    "Problem",
    "Progress",
    "Quality",
    "RecordingQuality",
    "Region",
    "Remedy",
    "Result",
    "Seconds",
    "Shape",
    "StartResult",
    "Step",
    "Stop",
    "Target",
    "Term",
    "TraceLine",
    "Trust",
    "WorstStretch",
    "calibrate",
    "run",
    "simulate",
]

__getattr__ = lazy_names(
    __name__,
    {
        "api": "calibrate simulate",
        "problem.options": "Options Step",
        "problem.problem": "Problem",
        "quality.quality": "Quality",
        "quality.recording_quality": "RecordingQuality WorstStretch",
        "fit.result": "Checkpoint CheckpointSink Progress Result Seconds StartResult TraceLine",
        "search.multistart": "run",
        "solver.levenberg_marquardt": "Stop",
        "trust": "Direction NullSpace Remedy Trust",
    },
)

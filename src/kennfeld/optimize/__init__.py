"""Calibration: the problem, the solver, and the result."""

from typing import TYPE_CHECKING

from kennfeld.constraints import Equality, Limit, Pin, Shape, Term
from kennfeld.criteria import Criterion, Region, Target
from kennfeld.lazy_names import lazy_names

if TYPE_CHECKING:
    from kennfeld.optimize.api import calibrate, simulate
    from kennfeld.optimize.options import Options, Step
    from kennfeld.optimize.problem import Problem
    from kennfeld.optimize.quality import Quality
    from kennfeld.optimize.recording_quality import RecordingQuality, WorstStretch
    from kennfeld.optimize.result import Checkpoint, CheckpointSink, Progress, Result, Seconds, StartResult, TraceLine
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
        "options": "Options Step",
        "problem": "Problem",
        "quality": "Quality",
        "recording_quality": "RecordingQuality WorstStretch",
        "result": "Checkpoint CheckpointSink Progress Result Seconds StartResult TraceLine",
        "search.multistart": "run",
        "solver.levenberg_marquardt": "Stop",
        "trust": "Direction NullSpace Remedy Trust",
    },
)

"""Calibration: the problem, the solver, and the result."""

from kennfeld.optimize.api import calibrate, simulate
from kennfeld.optimize.calibration import Progress
from kennfeld.optimize.criterion import Criterion, Region, Target
from kennfeld.optimize.limits.constraints import Equality, Limit, Pin, Shape, Term
from kennfeld.optimize.options import Options
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.quality import Quality
from kennfeld.optimize.result import Result, Seconds, StartResult, TraceLine
from kennfeld.optimize.search.multistart import run
from kennfeld.optimize.search.saved import Keep, Saved
from kennfeld.optimize.search.step import Step
from kennfeld.optimize.solver.gauss_newton import Stop
from kennfeld.optimize.trust import Direction, NullSpace, Remedy, Trust

__all__ = [
    "Criterion",
    "Direction",
    "Equality",
    "Keep",
    "Limit",
    "NullSpace",
    "Options",
    "Pin",
    "Problem",
    "Progress",
    "Quality",
    "Region",
    "Remedy",
    "Result",
    "Saved",
    "Seconds",
    "Shape",
    "StartResult",
    "Step",
    "Stop",
    "Target",
    "Term",
    "TraceLine",
    "Trust",
    "calibrate",
    "run",
    "simulate",
]

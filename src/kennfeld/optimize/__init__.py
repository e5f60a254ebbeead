"""Calibration: the problem, the solver, and the result."""

from kennfeld.optimize.api import calibrate, simulate
from kennfeld.optimize.calibration import Options, Progress, run
from kennfeld.optimize.constraints import Equality, Limit, Pin, Shape, Term
from kennfeld.optimize.criterion import Criterion, Region, Target
from kennfeld.optimize.gauss_newton import Stop
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.result import Quality, Result, Seconds, TraceLine

__all__ = [
    "Criterion",
    "Equality",
    "Limit",
    "Options",
    "Pin",
    "Problem",
    "Progress",
    "Quality",
    "Region",
    "Result",
    "Seconds",
    "Shape",
    "Stop",
    "Target",
    "Term",
    "TraceLine",
    "calibrate",
    "run",
    "simulate",
]

"""Calibration: the problem, the solver, and the result."""

from kennfeld.optimize.api import calibrate, simulate
from kennfeld.optimize.calibration import Options, Progress, run
from kennfeld.optimize.criterion import Criterion, Limit, Pin, Region, Target
from kennfeld.optimize.gauss_newton import Stop
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.result import Quality, Result, Seconds, TraceLine

__all__ = [
    "Criterion",
    "Limit",
    "Options",
    "Pin",
    "Problem",
    "Progress",
    "Quality",
    "Region",
    "Result",
    "Seconds",
    "Stop",
    "Target",
    "TraceLine",
    "calibrate",
    "run",
    "simulate",
]

"""Calibration: the problem, the solver, and the result."""

from kennfeld.optimize.api import calibrate, simulate
from kennfeld.optimize.calibration import Options, Progress, run
from kennfeld.optimize.criterion import Criterion, Limit, Pin, Target
from kennfeld.optimize.gauss_newton import Stop
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.result import Quality, Result, Seconds, TraceLine
from kennfeld.optimize.trust import Direction, Trust

__all__ = [
    "Criterion",
    "Direction",
    "Limit",
    "Options",
    "Pin",
    "Problem",
    "Progress",
    "Quality",
    "Result",
    "Seconds",
    "Stop",
    "Target",
    "TraceLine",
    "Trust",
    "calibrate",
    "run",
    "simulate",
]

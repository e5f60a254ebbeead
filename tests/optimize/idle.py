"""The idle speed engine of Crossley and Cook, with its governor by crank angle and as a mean-value model.

Each function gives data, model and start. The set value steps from 1980 to 2970 rpm at 5 s; the load is 25 Nm, and
20 Nm between 2 s and 8 s.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import kennfeld as kf

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "idle-speed"
RPM = 30 / np.pi
SET_RPM = 311.01 * RPM


def recording(step):
    """10 s of set value and load, every `step` seconds."""
    time = np.arange(round(10 / step) + 1) * step
    reference = np.where(time < 5 - step / 2, 207.34, 311.01)
    load = np.where((time > 2 + step / 2) & (time < 8 - step / 2), 20.0, 25.0)
    channels = {"N_ref": reference, "load": load, "rpm_ref": reference * RPM}
    return kf.Dataset.of("steps", channels, time=time)


def gains(kp=0.0, kI=0.0, most=1.0):
    return kf.ParameterSet([kf.Scalar("kp", kp, lower=0.0, upper=most), kf.Scalar("kI", kI, lower=0.0, upper=most)])


def by_crank_angle(step=1e-3):
    """The governor acts each 180 degrees: the cost has steps of about 1 %."""
    model = kf.formula((FOLDER / "idle.kf").read_text("utf-8"))
    return recording(step), replace(model, step=step), gains()


def mean_value():
    """The governor acts every 20 ms and the charge burns 20 ms later: the cost is smooth in the gains.

    Within the bounds the best gains overshoot the set value, `SET_RPM`, by more than 100 rpm.
    """
    return recording(2e-3), kf.formula((FOLDER / "mean_value.kf").read_text("utf-8")), gains(most=0.3)

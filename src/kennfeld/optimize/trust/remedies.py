"""Remedies as data: what to change in a calibration so that something undetermined becomes determined."""

from collections.abc import Mapping
from dataclasses import field

from kennfeld.base.arrays import Bool
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.constraints import Pin

Marks = Mapping[str, Bool]  # by parameter, of the shape of its values


@dataclass(frozen=True)
class Remedy:
    """Changes of a calibration that determine values; all of them belong together.

    `pins` are an argument of `calibrate`; `locks` apply to parameters that have the fitted values already. Axes are
    named `AxisSpeed` for a group axis, else `MapTorque.x`.

    Attributes:
        pins: values to pin, at their fitted values; known values can be pinned instead.
        locks: values to lock, by parameter, as masks in the shape of its values.
        axes: axes whose breakpoints to fix.
        coarser: axes that should have fewer breakpoints.
        smoother: tables whose smoothness to increase.
    """

    pins: tuple[Pin, ...] = ()
    locks: Marks = field(default_factory=dict)
    axes: tuple[str, ...] = ()
    coarser: tuple[str, ...] = ()
    smoother: tuple[str, ...] = ()

"""Physical numbers to the nearest raw ones that can be stored, and what that costs."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.calfiles.a2l.datatypes import Raw, native
from kennfeld.calfiles.a2l.parts import Kept, Part
from kennfeld.calfiles.format import Notes, counted
from kennfeld.parameters import Axis

__all__ = ["Rounded", "Roundings", "nearest_raw"]

_MOST = 5  # values of one label that are told
_HALF = 0.5 * (1 + 1e-6)


@dataclass(frozen=True)
class Rounded:
    """Raw numbers for a part, and how far the physical ones they stand for are from those wanted."""

    raw: Raw
    off: Float  # in physical units; 0 where nothing changes
    steps: Float  # the same in steps of the storage; 0 for floating-point numbers
    wanted: Float
    unit: str


def nearest_raw(
    name: str, part: Part, values: Float, unlike: Bool, thing: str, axes: Sequence[Axis] | None, notes: Notes
) -> Rounded | None:
    """The raw numbers to store, those that are not `unlike` as they are.

    None, and an error for each of the first values that cannot be stored.
    """
    kept = part.kept
    if kept.conversion.raw is None:
        notes.error(0, name, f"cannot be changed: the conversion {kept.conversion.name} has no inverse")
        return None
    with np.errstate(all="ignore"):
        exact = np.asarray(kept.conversion.raw(np.where(np.isnan(values), 0.0, values)), dtype=np.float64)
    exact = np.where(np.isnan(values), np.nan, exact)
    rounded = np.rint(exact) if kept.integer else exact
    wrong = _complaints(part, values, rounded, unlike & (rounded != part.raw))
    if wrong.any():
        _complain(name, kept, values, wrong, thing, notes)
        return None
    raw = part.raw.copy()
    raw[unlike] = rounded[unlike].astype(native(kept.data_type) if not kept.difference else raw.dtype)
    off = np.where(unlike, np.abs(kept.physical(raw) - values), 0.0)
    step = kept.step(raw.astype(np.float64))
    alone = np.where((off > 0) & kept.integer, np.inf, 0.0)  # a number without neighbours
    steps = np.divide(off, step, out=alone, where=step > 0)
    return Rounded(raw, off, steps, values, kept.conversion.unit)


def _complaints(part: Part, values: Float, raw: Float, unlike: Bool) -> Bool:
    """Which of the values to change cannot be stored or are not allowed."""
    kept = part.kept
    least, largest = kept.span
    with np.errstate(all="ignore"):
        outside = ~((raw >= least) & (raw <= largest))
        if kept.difference:
            distances = np.diff(raw, prepend=0.0)
            outside |= ~((distances >= least) & (distances <= largest))
        slack = 0.5 * kept.step(np.clip(np.nan_to_num(raw), least, largest)) + 1e-9 * np.abs(values)
        beyond = ~((values >= kept.lower - slack) & (values <= kept.upper + slack))
    return unlike & (outside | beyond)


def _complain(name: str, kept: Kept, values: Float, wrong: Bool, thing: str, notes: Notes) -> None:
    low, high = kept.range
    low, high = (
        max(low, kept.lower) if low == low else kept.lower,
        min(high, kept.upper) if high == high else kept.upper,
    )
    places = [tuple(int(i) for i in at) for at in np.argwhere(wrong)]
    for at in places[:_MOST]:
        where = f" {[i + 1 for i in at]}" if at else ""
        what = f"the {thing}{where} is {values[at]:g} {kept.conversion.unit}".rstrip()
        notes.error(0, name, f"{what}, which is outside what can be stored and is allowed: {low:g} to {high:g}")
    if len(places) > _MOST:
        notes.error(0, name, f"{counted(len(places) - _MOST, f'further {thing}')} outside {low:g} to {high:g}")


@dataclass
class Roundings:
    """What rounding has done to all labels."""

    labels: dict[str, tuple[float, float, str, int]] = field(default_factory=dict)  # share, off, unit, values
    far: dict[str, tuple[float, float, str]] = field(default_factory=dict)

    def keep(self, name: str, found: Rounded) -> None:
        """Count what was rounded for one label."""
        size = float(np.nanmax(np.abs(found.wanted), initial=0.0)) or 1.0
        moved = int((found.off > 1e-12 * size).sum())
        if not moved:
            return
        off = float(np.nanmax(found.off))
        before = self.labels.get(name, (0.0, 0.0, "", 0))
        self.labels[name] = max(before, (off / size, off, found.unit, moved + before[3]))
        if float(np.nanmax(found.steps)) > _HALF:
            at = np.unravel_index(int(np.nanargmax(found.steps)), found.off.shape)
            self.far[name] = (float(found.wanted[at]), float(found.off[at]), found.unit)

    def tell(self, notes: Notes) -> None:
        """One remark on all rounding, and one for each label where it is more than half a step of the storage."""
        if self.labels:
            count = sum(values for *_, values in self.labels.values())
            name, (share, off, unit, _) = max(self.labels.items(), key=lambda one: one[1])
            what = (
                f"{counted(count, 'number')} of {counted(len(self.labels), 'label')} rounded to what the control unit "
                f"can store, at most by {off:.3g} {unit}".rstrip()
            )
            notes.remark(0, "", f"{what} ({name}, {share:.2g} of its largest number)")
        for name, (wanted, off, unit) in self.far.items():
            what = f"{wanted:g} {unit}".rstrip()
            notes.remark(0, name, f"the closest number to {what} that it can have is {off:.3g} away")

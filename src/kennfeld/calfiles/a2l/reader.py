"""The parameters in an image, as its A2L file describes them."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kennfeld.calfiles.a2l.labels import Label, Labels
from kennfeld.calfiles.a2l.objects import A2l, AxisPts, Characteristic
from kennfeld.calfiles.a2l.record_layout import AbsentError
from kennfeld.calfiles.a2l.syntax import A2lError
from kennfeld.calfiles.flash.image import Image
from kennfeld.calfiles.format import Findings, FlashOrigin
from kennfeld.errors import ArgumentError
from kennfeld.formatting import count_noun, join_limited
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

__all__ = ["check_epk", "read_parameters"]

_MOST_ALIKE = 20  # remarks that say the same


@dataclass
class _Found:
    members: list[Parameter] = field(default_factory=list)
    texts: list[Text] = field(default_factory=list)
    axes: list[Axis] = field(default_factory=list)
    aside: dict[str, list[tuple[int, str]]] = field(default_factory=dict)  # for each reason the lines and the labels
    absent: list[str] = field(default_factory=list)
    dependent: list[str] = field(default_factory=list)

    def leave(self, source: AxisPts | Characteristic, reason: str) -> None:
        """Leave a label aside."""
        self.aside.setdefault(reason, []).append((source.line, source.name))

    def tell_aside(self, notes: Findings) -> None:
        """Tell what was left aside: each label, or in one remark the many that have one reason."""
        for reason, labels in self.aside.items():
            if len(labels) > _MOST_ALIKE:
                names = join_limited([name for _, name in labels])
                notes.remark(labels[0][0], "and others", f"{names} left aside, since each {reason}")
            else:
                for line, name in labels:
                    notes.remark(line, name, f"{reason}; left aside")


def read_parameters(a2l: A2l, image: Image, notes: Findings) -> ParameterSet:
    """Every label of an A2L file that is in an image, in physical units.

    Scalars with words and ASCII labels become texts, AXIS_PTS group axes. Limits become bounds unless they are the
    range of the data type; READ_ONLY labels are locked. What cannot be read is left aside with a remark that says
    why; one more remark tells which labels are not in the image. The set remembers where it was read from.
    """
    _say_byte_order(a2l, notes)
    check_epk(a2l, image, notes)
    labels, found = Labels(a2l, image), _Found()
    for name, axis in a2l.axis_pts.items():
        _take_axis(labels, name, axis, found, notes)
    for name, source in a2l.characteristics.items():
        if name in a2l.axis_pts:
            found.leave(source, "is the name of an AXIS_PTS too")
        else:
            _take(labels, source, found, notes)
    found.tell_aside(notes)
    if found.absent:
        message = f"{join_limited(found.absent)} left aside: their addresses are not in {image.name}"
        notes.remark(0, "", message, "See whether the image is complete and belongs to this description.")
    if found.dependent:
        message = (
            f"{join_limited(found.dependent)} follow from other labels by formulas; their numbers are read as they are"
        )
        notes.remark(0, "", message)
    return ParameterSet(found.members, found.texts, found.axes, origin=FlashOrigin(a2l, image))


def _take_axis(labels: Labels, name: str, source: AxisPts, found: _Found, notes: Findings) -> None:
    try:
        shared = labels.shared(name)
    except A2lError as error:
        found.leave(source, str(error))
    except AbsentError:
        found.absent.append(name)
    else:
        if shared.axis is not None:
            found.axes.append(shared.axis)
        else:
            notes.remark(source.line, name, "gives tables their breakpoints; as a parameter it is left aside")


def _take(labels: Labels, source: Characteristic, found: _Found, notes: Findings) -> None:
    try:
        label = labels.label(source.name)
    except (A2lError, ArgumentError) as error:
        found.leave(source, str(error))
        return
    except AbsentError:
        found.absent.append(source.name)
        return
    if label.text is not None:
        found.texts.append(replace(label.text, **_attributes(source)))
    elif label.member is not None:
        _say_missing(label, notes)
        found.members.append(label.member.changed(**_attributes(source)))
    if source.dependent_on:
        found.dependent.append(source.name)


def _attributes(source: Characteristic) -> dict[str, Any]:
    return {"functions": source.functions, "display_name": source.display_identifier}


def _say_missing(label: Label, notes: Findings) -> None:
    missing = int(np.isnan(label.part.physical).sum())
    if missing:
        all_of = f"{missing} of {count_noun(label.part.physical.size, 'value')}"
        message = f"{all_of} have no finite physical number under the conversion {label.source.conversion}"
        notes.remark(label.source.line, label.source.name, message)


def _say_byte_order(a2l: A2l, notes: Findings) -> None:
    order = a2l.common.byte_order
    if order in ("BIG_ENDIAN", "LITTLE_ENDIAN"):
        meant = "MSB_FIRST" if order == "BIG_ENDIAN" else "MSB_LAST"
        message = (
            f"BYTE_ORDER {order} is taken as {meant}; old versions of the standard use the words the other way round"
        )
        notes.remark(0, "MOD_COMMON", message, f"Write BYTE_ORDER {meant}.")
    elif not order:
        notes.remark(0, "MOD_COMMON", "states no BYTE_ORDER; MSB_LAST is taken")


def check_epk(a2l: A2l, image: Image, notes: Findings) -> None:
    """Tell where the image holds another identifier (EPK) than that of the program that the description is for."""
    wanted = a2l.epk.encode("latin-1", errors="replace")
    for address in a2l.epk_addresses if wanted else ():
        held = image.read(address, len(wanted))
        if held is not None and held != wanted:
            shown = held.decode("latin-1")
            message = (
                f"holds the program identifier {shown[:60]!r} at 0x{address:X}, {a2l.file} is for {a2l.epk[:60]!r}"
            )
            notes.remark(0, image.name, message, "Take the A2L file of this program.")

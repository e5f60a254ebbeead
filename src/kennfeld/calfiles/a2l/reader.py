"""Reads the parameters of an image as its A2L file describes them."""

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
from kennfeld.formatting import count_labels, count_noun
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

_MAX_LISTED = 20  # remarks that say the same


@dataclass
class _ReadLabels:
    members: list[Parameter] = field(default_factory=list)
    texts: list[Text] = field(default_factory=list)
    axes: list[Axis] = field(default_factory=list)
    aside: dict[str, list[tuple[int, str]]] = field(default_factory=dict)  # for each reason the lines and the labels
    absent: list[str] = field(default_factory=list)
    dependent: list[str] = field(default_factory=list)

    def skip(self, source: AxisPts | Characteristic, reason: str) -> None:
        self.aside.setdefault(reason, []).append((source.line, source.name))

    def report_skipped(self, findings: Findings) -> None:
        """Report the skipped labels, in one warning if many share a reason."""
        for reason, labels in self.aside.items():
            if len(labels) > _MAX_LISTED:
                names = count_labels([name for _, name in labels])
                findings.warning(labels[0][0], "and others", f"skipped {names}: each {reason}")
            else:
                for line, name in labels:
                    findings.warning(line, name, f"{reason}; skipped")


def read_parameters(a2l: A2l, image: Image, findings: Findings) -> ParameterSet:
    """Return every label of an A2L file that is in an image, in physical units.

    Scalars with words and ASCII labels become texts, AXIS_PTS group axes. Limits become bounds unless they are the
    range of the data type; READ_ONLY labels are locked. What cannot be read is skipped with a remark that says
    why; one more remark tells which labels are not in the image. The set remembers where it was read from.
    """
    _warn_about_byte_order(a2l, findings)
    check_epk(a2l, image, findings)
    labels, found = Labels(a2l, image), _ReadLabels()
    for name, axis in a2l.axis_pts.items():
        _take_axis(labels, name, axis, found, findings)
    for name, source in a2l.characteristics.items():
        if name in a2l.axis_pts:
            found.skip(source, "is also the name of an AXIS_PTS")
        else:
            _take_label(labels, source, found, findings)
    found.report_skipped(findings)
    if found.absent:
        message = f"skipped {count_labels(found.absent)}: address not in {image.name}"
        findings.warning(0, "", message, "Check that the image is complete and belongs to this A2L file.")
    if found.dependent:
        message = f"computed from other labels, read as stored: {count_labels(found.dependent)}"
        findings.warning(0, "", message)
    return ParameterSet(found.members, found.texts, found.axes, origin=FlashOrigin(a2l, image))


def _take_axis(labels: Labels, name: str, source: AxisPts, found: _ReadLabels, findings: Findings) -> None:
    try:
        shared = labels.shared(name)
    except A2lError as error:
        found.skip(source, str(error))
    except AbsentError:
        found.absent.append(name)
    else:
        if shared.axis is not None:
            found.axes.append(shared.axis)
        else:
            findings.warning(source.line, name, "only provides breakpoints of tables; skipped as a parameter")


def _take_label(labels: Labels, source: Characteristic, found: _ReadLabels, findings: Findings) -> None:
    try:
        label = labels.label(source.name)
    except (A2lError, ArgumentError) as error:
        found.skip(source, str(error))
        return
    except AbsentError:
        found.absent.append(source.name)
        return
    if label.text is not None:
        found.texts.append(replace(label.text, **_attributes(source)))
    elif label.member is not None:
        _warn_about_missing(label, findings)
        found.members.append(label.member.changed(**_attributes(source)))
    if source.dependent_on:
        found.dependent.append(source.name)


def _attributes(source: Characteristic) -> dict[str, Any]:
    return {"functions": source.functions, "display_name": source.display_identifier}


def _warn_about_missing(label: Label, findings: Findings) -> None:
    missing = int(np.isnan(label.part.physical).sum())
    if missing:
        all_of = f"{missing} of {count_noun(label.part.physical.size, 'value')}"
        message = f"{all_of} have no finite physical value under the conversion {label.source.conversion}"
        findings.warning(label.source.line, label.source.name, message)


def _warn_about_byte_order(a2l: A2l, findings: Findings) -> None:
    order = a2l.common.byte_order
    if order in ("BIG_ENDIAN", "LITTLE_ENDIAN"):
        meant = "MSB_FIRST" if order == "BIG_ENDIAN" else "MSB_LAST"
        message = f"BYTE_ORDER {order} is read as {meant}; old versions of the standard swap the two words"
        findings.warning(0, "MOD_COMMON", message, f"Write BYTE_ORDER {meant}.")
    elif not order:
        findings.warning(0, "MOD_COMMON", "states no BYTE_ORDER; MSB_LAST is assumed")


def check_epk(a2l: A2l, image: Image, findings: Findings) -> None:
    """Warn if the program identifier (EPK) in the image differs from that of the A2L file."""
    wanted = a2l.epk.encode("latin-1", errors="replace")
    for address in a2l.epk_addresses if wanted else ():
        held = image.read(address, len(wanted))
        if held is not None and held != wanted:
            shown = held.decode("latin-1")
            contains = f"contains the program identifier {shown[:60]!r} at 0x{address:X}"
            message = f"{contains}, but {a2l.file} is for {a2l.epk[:60]!r}"
            findings.warning(0, image.name, message, "Use the A2L file of this program.")

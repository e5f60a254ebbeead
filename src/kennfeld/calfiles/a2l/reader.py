"""Reads the parameters of an image as its A2L file describes them."""

from dataclasses import field, replace
from typing import Any

import numpy as np

from kennfeld.base.errors import ArgumentError
from kennfeld.base.formatting import count_labels, count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.a2l.labels import Labels
from kennfeld.calfiles.a2l.objects import A2l, AxisPts, Characteristic
from kennfeld.calfiles.a2l.origin import FlashOrigin
from kennfeld.calfiles.a2l.record_layout import AbsentError
from kennfeld.calfiles.a2l.syntax import A2lError
from kennfeld.calfiles.flash.image import Image
from kennfeld.calfiles.format import FileFindings
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text

_MAX_LISTED = 20  # warnings with the same reason


def read_parameters(a2l: A2l, image: Image, findings: FileFindings) -> ParameterSet:
    """Return every label of an A2L file that is in an image, in physical units.

    Scalars with words and ASCII labels become texts, AXIS_PTS group axes. Limits become bounds unless they are the
    range of the data type; READ_ONLY labels are locked. What cannot be read is skipped with a warning that says
    why; one more warning tells which labels are not in the image. The set remembers where it was read from.
    """
    _warn_about_byte_order(a2l, findings)
    check_epk(a2l, image, findings)
    reader = _LabelReader(Labels(a2l, image), findings)
    sources: tuple[AxisPts | Characteristic, ...] = (*a2l.axis_pts.values(), *a2l.characteristics.values())
    for source in sources:
        reader.take(source)
    reader.report_skipped()
    if reader.absent:
        message = f"skipped {count_labels(reader.absent)}: address not in {image.name}"
        findings.warning(0, "", message, "Check that the image is complete and belongs to this A2L file.")
    if reader.dependent:
        findings.warning(0, "", f"computed from other labels, read as stored: {count_labels(reader.dependent)}")
    return ParameterSet(reader.members, reader.texts, reader.axes, origin=FlashOrigin(a2l, image))


@dataclass
class _LabelReader:
    labels: Labels
    findings: FileFindings
    members: list[Parameter] = field(default_factory=list)
    texts: list[Text] = field(default_factory=list)
    axes: list[Axis] = field(default_factory=list)
    skipped: dict[str, list[AxisPts | Characteristic]] = field(default_factory=dict)  # by reason
    absent: list[str] = field(default_factory=list)
    dependent: list[str] = field(default_factory=list)

    def take(self, source: AxisPts | Characteristic) -> None:
        """Read one label; one that cannot be read is kept for `report_skipped`."""
        try:
            if isinstance(source, AxisPts):
                self._take_axis(source)
            elif source.name in self.labels.a2l.axis_pts:
                raise A2lError("is also the name of an AXIS_PTS")
            else:
                self._take_label(source)
        except (A2lError, ArgumentError) as error:
            self.skipped.setdefault(str(error), []).append(source)
        except AbsentError:
            self.absent.append(source.name)

    def _take_axis(self, source: AxisPts) -> None:
        axis = self.labels.shared(source.name).axis
        if axis is not None:
            self.axes.append(axis)
        else:
            message = "only provides breakpoints of tables; skipped as a parameter"
            self.findings.warning(source.line, source.name, message)

    def _take_label(self, source: Characteristic) -> None:
        label = self.labels.label(source.name)
        attributes: dict[str, Any] = {"functions": source.functions, "display_name": source.display_identifier}
        if label.text is not None:
            self.texts.append(replace(label.text, **attributes))
        elif label.member is not None:
            missing = int(np.isnan(label.part.physical).sum())
            if missing:
                count = f"{missing} of {count_noun(label.part.physical.size, 'value')}"
                message = f"{count} have no finite physical value under the conversion {source.conversion}"
                self.findings.warning(source.line, source.name, message)
            self.members.append(label.member.changed(**attributes))
        if source.dependent_on:
            self.dependent.append(source.name)

    def report_skipped(self) -> None:
        """Report the skipped labels, in one warning if many share a reason."""
        for reason, sources in self.skipped.items():
            if len(sources) > _MAX_LISTED:
                names = count_labels([source.name for source in sources])
                self.findings.warning(sources[0].line, "and others", f"skipped {names}: each {reason}")
            else:
                for source in sources:
                    self.findings.warning(source.line, source.name, f"{reason}; skipped")


def _warn_about_byte_order(a2l: A2l, findings: FileFindings) -> None:
    order = a2l.common.byte_order
    if order in ("BIG_ENDIAN", "LITTLE_ENDIAN"):
        actual = "MSB_FIRST" if order == "BIG_ENDIAN" else "MSB_LAST"
        message = f"BYTE_ORDER {order} is read as {actual}; old versions of the standard swap the two words"
        findings.warning(0, "MOD_COMMON", message, f"Write BYTE_ORDER {actual}.")
    elif not order:
        findings.warning(0, "MOD_COMMON", "states no BYTE_ORDER; MSB_LAST is assumed")


def check_epk(a2l: A2l, image: Image, findings: FileFindings) -> None:
    """Warn if the program identifier (EPK) in the image differs from that of the A2L file."""
    expected = a2l.epk.encode("latin-1", errors="replace")
    for address in a2l.epk_addresses if expected else ():
        actual = image.read(address, len(expected))
        if actual is not None and actual != expected:
            text = actual.decode("latin-1")[:60]
            message = (
                f"contains the program identifier {text!r} at 0x{address:X}, but {a2l.file} is for {a2l.epk[:60]!r}"
            )
            findings.warning(0, image.name, message, "Use the A2L file of this program.")

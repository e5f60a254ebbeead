"""Writes values into an image, rounded to what the control unit can store.

An unchanged number keeps its bytes; a changed one becomes the nearest raw value (ties to even). Checksums of the
control unit are not updated.
"""

from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.formatting import count_labels, count_noun, join_names, size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.a2l.conversion import IDENTITY, VerbalConversion
from kennfeld.calfiles.a2l.labels import ENCODINGS, AxisInMemory, Label, Labels, SharedAxis
from kennfeld.calfiles.a2l.objects import DIRECTIONS, A2l, AxisPts, Characteristic
from kennfeld.calfiles.a2l.reader import check_epk
from kennfeld.calfiles.a2l.record_layout import AbsentError, PartOffsets
from kennfeld.calfiles.a2l.storage import ObjectPart, Raw, Roundings, StorageFormat, encode_raw, native, nearest_raw
from kennfeld.calfiles.a2l.syntax import A2lError
from kennfeld.calfiles.content import turn
from kennfeld.calfiles.flash.image import Image
from kennfeld.calfiles.flash.records import read_image
from kennfeld.calfiles.format import FileFindings
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text

# of its span, as far as a breakpoint that cannot change may be off in a file with few digits
_FIXED_POINT_TOLERANCE = 1e-5


@dataclass
class Memory:
    """Bytes to write, by address: their bits, the mask of the bits that are set, and the label that sets them."""

    findings: FileFindings
    cells: dict[int, tuple[int, int, str]] = field(default_factory=dict)
    clashes: set[tuple[str, str]] = field(default_factory=set)

    def put(self, name: str, address: int, part: ObjectPart, raw: Any, where: Bool) -> None:
        """Put raw numbers of a part of an object at an address, those of the mask `where`, both in the part's shape."""
        storage = part.storage
        stored: Raw = np.asarray(raw)
        if storage.difference:
            # a changed point changes the distances on both sides, so all of them are written
            stored, where = np.diff(stored, prepend=stored.dtype.type(0)), np.full(stored.shape, bool(where.any()))
        chosen = np.asarray(where)
        stored = stored.astype(native(storage.data_type))
        content, bits = encode_raw(stored, storage.data_type, storage.byte_order, storage.bit_mask)
        places = part.offsets[chosen][..., None] + np.arange(content.shape[-1]) + address
        columns = (places, content[chosen], bits[chosen])
        for at, value, mask in zip(*(column.ravel().tolist() for column in columns), strict=True):
            self._cell(name, at, value, mask)

    def _cell(self, name: str, at: int, value: int, mask: int) -> None:
        before, known, other = self.cells.get(at, (0, 0, name))
        # bits that both set, to different values
        if (before ^ value) & mask & known and other != name and (other, name) not in self.clashes:
            self.clashes.add((other, name))
            message = f"shares memory with {other} at 0x{at:X}, which is set to another value"
            self.findings.error(0, name, message, "Set both to the same value.")
        self.cells[at] = ((before & ~mask) | (value & mask), known | mask, name)

    def changes(self, image: Image) -> dict[int, bytes]:
        """Return the bytes of the image to be changed, by address."""
        result = {}
        for run in _runs(sorted(self.cells)):
            before = image.read(run[0], len(run))
            if before is None:
                continue
            cells = (self.cells[at] for at in run)
            after = bytes((old & ~mask & 255) | value for old, (value, mask, _) in zip(before, cells, strict=True))
            if after != before:
                result[run[0]] = after
        return result


def _runs(addresses: list[int]) -> Iterator[list[int]]:
    start = 0
    for at in range(1, len(addresses) + 1):
        if at == len(addresses) or addresses[at] != addresses[at - 1] + 1:
            yield addresses[start:at]
            start = at


def write_values(a2l: A2l, image: Image, parameters: ParameterSet, findings: FileFindings) -> bytes:
    """Return the file of an image with the values of `parameters` in it; byte for byte the same if nothing changed.

    Reports an error for each value beyond what its data type or its limits allow and for each shape that the memory
    does not have, and a warning on what is rounded, cannot be written or is not in the A2L file.
    """
    writer = _ImageWriter(Labels(a2l, image), findings, parameters, Memory(findings))
    writer.write()
    content = image.changed(writer.memory.changes(image))
    writer.roundings.report(findings)  # also if each value is rounded back to its old raw number
    if content != image.raw:
        check_epk(a2l, image, findings)
        findings.warning(0, "", "checksums of the control unit are not updated; the flash tool must do it")
        # formulas of the A2L file are not evaluated
        derived = (label for label in a2l.characteristics.values() if writer.changed.intersection(label.dependent_on))
        dependent = [label.name for label in derived if label.name not in writer.changed]
        if dependent:
            message = f"not recomputed although labels in their formulas changed: {count_labels(dependent)}"
            findings.warning(0, "", message)
        _report_shared_memory(a2l, image, content, writer, findings)
    return content


@dataclass
class _ImageWriter:
    labels: Labels
    findings: FileFindings
    parameters: ParameterSet
    memory: Memory
    roundings: Roundings = field(default_factory=Roundings)
    changed: set[str] = field(default_factory=set)  # what may have changed

    def write(self) -> None:
        a2l = self.labels.a2l
        self._warn_about_units()
        for axis in self.parameters.axes:
            if axis.name in a2l.axis_pts:
                self._try_write(a2l.axis_pts[axis.name], axis)
        unknown = []
        for item in self.parameters.chosen:
            source = a2l.characteristics.get(item.name)
            if source is None:
                unknown.append(item.name)
            else:
                self._try_write(source, item)
        others = list(self.parameters.others_by_name)
        if others:
            message = f"further variants of {count_labels(others)} left out: the control unit has one place for each"
            self.findings.warning(0, "", message)
        if unknown:
            self.findings.warning(0, "", f"{count_labels(unknown)} left out: not in {a2l.file}")

    def _warn_about_units(self) -> None:
        """Warn about values in another unit than the control unit's; conversion is left to the user."""
        differing = []
        for member in self.parameters.parameters:
            source = self.labels.a2l.characteristics.get(member.name)
            unit = "" if source is None else self.labels.unit(source)
            if unit and member.unit and unit != member.unit:
                differing.append(f"{member.name} in {member.unit}, not {unit}")
        if differing:
            names = join_names(differing, 3, "; ")
            message = f"written without conversion, since {self.labels.a2l.file} states another unit: {names}"
            self.findings.warning(0, "", message, "Check that this is intended.")

    def _try_write(self, source: AxisPts | Characteristic, item: Axis | Parameter | Text) -> None:
        """Write a label, with a warning if it is not possible."""
        try:
            if isinstance(item, Axis):
                self._shared_axis(item)
            elif isinstance(item, Text):
                self._text(item)
            else:
                self._parameter(item)
        except A2lError as error:
            self.findings.warning(0, source.name, f"cannot be written: it {error}")
        except AbsentError:
            message = f"cannot be written: 0x{source.address:X} is not in {self.labels.image.name}"
            self.findings.warning(0, source.name, message)

    def _shared_axis(self, axis: Axis) -> None:
        shared = self.labels.shared(axis.name)
        if shared.axis is None:
            self.findings.warning(0, axis.name, "is a rescale axis, which is not written")
            return
        points = turn(axis.breakpoints, (shared.axis,))
        if points.size != len(shared.axis):
            self._resize_axis(shared, points, len(shared.axis))
        else:
            self._numbers(shared.source, shared.part, points, "breakpoint")

    def _resize_axis(self, shared: SharedAxis, points: Float, before: int) -> None:
        """Change the size of an axis, if the memory stores its point count, with all tables that share it."""
        name = shared.source.name
        users = [
            label.name
            for label in self.labels.a2l.characteristics.values()
            if any(axis.axis_pts_ref == name for axis in label.axes) and label.name not in self.parameters
        ]
        if users:
            message = f"has {points.size} breakpoints, but the image has {before}"
            message = f"{message}, and {count_labels(users)} sharing them are not given"
            self.findings.error(0, name, message, "Include these tables.")
            return
        places = self._resize(shared.source, {"AXIS_PTS_X": points.size}, (before,))
        if places is not None:
            part = self.labels.part(shared.source.address, places, "AXIS_PTS_X", shared.part.storage)
            self._numbers(shared.source, part, points, "breakpoint", everything=True)

    def _resize(
        self, source: AxisPts | Characteristic, counts: Mapping[str, int], before: tuple[int, ...]
    ) -> PartOffsets | None:
        """Locate all parts for other point counts, and write these; None, with an error, if that is impossible."""
        layout = self.labels.layout(source.record_layout)
        adjustable = {f"AXIS_PTS_{part.direction}" for part in layout.components if part.kind == "NO_AXIS_PTS"}
        for direction, axis in zip(DIRECTIONS, source.axes if isinstance(source, Characteristic) else (), strict=False):
            if axis.attribute == "COM_AXIS":
                adjustable.add(f"AXIS_PTS_{direction}")
        message = f"has {size_text(counts.values())} points, but {size_text(before)} in the image"
        if not counts.keys() <= adjustable:
            self.findings.error(0, source.name, f"{message}, which stores no point count", "Use the same number.")
            return None
        try:
            places = self.labels.places(source, counts)
        except A2lError as error:
            self.findings.error(0, source.name, f"{message}: it {error}")
            return None
        except AbsentError:
            self.findings.error(0, source.name, f"{message}, where there is no room for them")
            return None
        for key, component in places.components.items():
            if component.kind == "NO_AXIS_PTS":
                number = np.array(float(places.counts[f"AXIS_PTS_{component.direction}"]))
                storage = StorageFormat(component.data_type, self.labels.order(source), IDENTITY)
                part = self.labels.part(source.address, places, key, storage)
                self._numbers(source, part, number, "number of points")
        return places

    def _parameter(self, member: Parameter) -> None:
        label = self.labels.label(member.name)
        if label.member is None:
            message = "is a text in the control unit; the number given is not written"
            self.findings.warning(0, member.name, message)
        elif label.member.values.ndim != member.values.ndim or len(label.axes) != len(member.axes):
            message = f"is a {member.kind}, but a {label.member.kind} in the control unit"
            self.findings.error(0, member.name, message)
        elif member.values.shape != label.member.values.shape:
            self._resize_table(label, member)
        else:
            for direction, stored, axis in zip(DIRECTIONS, label.axes, member.axes, strict=False):
                self._axis(label, direction, stored, axis)
            self._numbers(label.source, label.part, label.in_memory_order(member.values), "value")

    def _axis(self, label: Label, direction: str, stored: AxisInMemory, axis: Axis) -> None:
        if stored.part is not None:
            points = turn(axis.breakpoints, (stored.axis,))
            item = f"{direction} breakpoint"
            self._numbers(label.source, stored.part, points, item, locked=stored.read_only)
            return
        expected = self._shared_points(stored)
        difference = np.abs(axis.breakpoints - expected)
        if np.any(difference > _FIXED_POINT_TOLERANCE * (float(np.ptp(expected)) or 1.0)):
            at = int(np.argmax(difference))
            which = f"where the common axis {stored.shared} has" if stored.shared else "which the control unit fixes to"
            message = f"has the {direction} breakpoint {axis.breakpoints[at]:g}, {which} {expected[at]:g}"
            self.findings.error(0, label.source.name, message, "Use the same breakpoints.")

    def _shared_points(self, stored: AxisInMemory) -> Float:
        """Return the breakpoints that a common axis will have."""
        axes = (axis for axis in self.parameters.axes if stored.shared and axis.name == stored.shared)
        return next(axes, stored.axis).breakpoints

    def _resize_table(self, label: Label, member: Parameter) -> None:
        source, before, sizes = label.source, label.part.physical.shape, member.values.shape
        if not label.axes:
            message = f"has {size_text(sizes)} values, but {size_text(before)} in the control unit"
            self.findings.error(0, member.name, message)
            return
        pairs = zip(DIRECTIONS, sizes, before, strict=False)
        counts = {f"AXIS_PTS_{direction}": size for direction, size, old in pairs if size != old}
        places = self._resize(source, counts, before)
        if places is None:
            return
        for direction, stored, axis in zip(DIRECTIONS, label.axes, member.axes, strict=False):
            points, key = turn(axis.breakpoints, (stored.axis,)), f"AXIS_PTS_{direction}"
            if stored.part is not None:
                part = self.labels.part(source.address, places, key, stored.part.storage)
                self._numbers(source, part, points, f"{direction} breakpoint", everything=True)
            elif len(self._shared_points(stored)) == len(axis):
                self._axis(label, direction, stored, axis)
            else:
                message = f"has {len(axis)} {direction} breakpoints, but its axis has another number"
                self.findings.error(0, member.name, message)
        part = self.labels.part(source.address, places, "FNC_VALUES", label.part.storage)
        self._numbers(source, part, label.in_memory_order(member.values), "value", everything=True)

    def _text(self, text: Text) -> None:
        label = self.labels.label(text.name)
        if label.text is None:
            message = f"is a {label.source.type} in the control unit; the text given is not written"
            self.findings.warning(0, text.name, message)
            return
        if text.kind != label.text.kind:
            self.findings.warning(0, text.name, f"is of kind {text.kind}, but {label.text.kind} in the control unit")
        if text.text == label.text.text:
            return
        if label.source.read_only:
            self._warn_about_read_only(label.source, 1)
            return
        raw = self._raw_word(label.words, text) if label.words is not None else self._raw_characters(label, text)
        if raw is not None:
            self.changed.add(text.name)
            # of a text, the characters that differ; a word is one number
            where = np.asarray(raw != label.part.stored) if label.words is None else np.asarray(True)
            self.memory.put(text.name, label.source.address, label.part, raw, where)

    def _raw_word(self, words: VerbalConversion, text: Text) -> Raw | None:
        raw = words.raw(text.text)
        if raw is not None:
            return np.asarray(raw)
        known = ", ".join(dict.fromkeys(word for _, _, word in words.table.ranges))
        message = f"must be one of its texts, got {text.text[:40]!r}"
        self.findings.error(0, text.name, message, f"Choose from {known[:200]}.")
        return None

    def _raw_characters(self, label: Label, text: Text) -> Raw | None:
        size = label.part.stored.size
        content = text.text.encode(ENCODINGS[label.source.encoding], errors="replace")
        if len(content) > size:
            message = f"has {len(content)} characters, but there is room for {size}"
            self.findings.error(0, text.name, message, "Shorten the text.")
            return None
        raw = np.frombuffer(content.ljust(size, b"\0"), dtype=np.uint8).astype(np.float64)
        # a signed byte holds the upper half of the characters as negative numbers
        return np.where(raw > 127, raw - 256, raw) if label.part.storage.data_type == "SBYTE" else raw

    def _numbers(
        self,
        source: AxisPts | Characteristic,
        part: ObjectPart,
        values: Float,
        item: str,
        *,
        everything: bool = False,
        locked: bool = False,
    ) -> None:
        """Write the numbers that differ from the memory, or all if `everything` is set."""
        unlike = part.unlike(values) | everything
        rounded = nearest_raw(source.name, part, values, unlike, item, self.findings) if unlike.any() else None
        if rounded is None:
            return
        # a changed value may round to the number that is stored
        changed = (rounded.raw != part.raw) & unlike
        if (source.read_only or locked) and changed.any():
            self._warn_about_read_only(source, int(changed.sum()))
            return
        self.changed.add(source.name)
        self.roundings.keep(source.name, rounded)
        self.memory.put(source.name, source.address, part, rounded.raw, changed | everything)

    def _warn_about_read_only(self, source: AxisPts | Characteristic, count: int) -> None:
        message = f"is READ_ONLY: {count_noun(count, 'changed value')} not written"
        self.findings.warning(0, source.name, message)


def _report_shared_memory(a2l: A2l, image: Image, content: bytes, writer: _ImageWriter, findings: FileFindings) -> None:
    """Report labels that change only because they share memory with others."""
    # the written image is read again, so that overlaps of any layouts show
    after = Labels(a2l, read_image(content, image.name, FileFindings(image.name)))
    message = "changes unintentionally: it shares memory with another label that is changed"
    for name in a2l.characteristics:
        if name in writer.changed or name in a2l.axis_pts:
            continue
        try:
            before, now = writer.labels.label(name), after.label(name)
        except (A2lError, AbsentError):
            continue
        if before.places.offsets.keys() != now.places.offsets.keys() or not before.same_numbers(now):
            (findings.error if name in writer.parameters else findings.warning)(0, name, message)

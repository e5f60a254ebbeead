"""Writes values into an image, rounded to what the control unit can store.

An unchanged number keeps its bytes; a changed one becomes the nearest raw value (ties to even). Checksums of the
control unit are not updated.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.calfiles.a2l.labels import AxisInMemory, Label, Labels, SharedAxis, encoding_of
from kennfeld.calfiles.a2l.objects import DIRECTIONS, A2l, AxisPts, Characteristic
from kennfeld.calfiles.a2l.reader import check_epk
from kennfeld.calfiles.a2l.record_layout import AbsentError, PartOffsets
from kennfeld.calfiles.a2l.storage import ObjectPart, Raw, Roundings, StorageFormat, encode_raw, native, nearest_raw
from kennfeld.calfiles.a2l.syntax import A2lError
from kennfeld.calfiles.flash.image import Image
from kennfeld.calfiles.flash.records import read_image
from kennfeld.calfiles.format import Findings
from kennfeld.formatting import count_labels, count_noun, join_names
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

_FIXED_POINT_TOLERANCE = (
    1e-5  # of its span, as far as a breakpoint that cannot change may be off in a file with few digits
)


@dataclass
class Memory:
    """Bytes to write, by address: their bits, the mask of the bits that are set, and the label that sets them."""

    findings: Findings
    cells: dict[int, tuple[int, int, str]] = field(default_factory=dict)
    clashes: set[tuple[str, str]] = field(default_factory=set)

    def put(self, name: str, address: int, part: ObjectPart, raw: Any, where: Bool) -> None:
        """Put raw numbers of a part of an object at an address, those of `where`."""
        kept = part.kept
        stored: Raw = np.asarray(raw)
        if kept.difference:
            stored, where = np.diff(stored, prepend=stored.dtype.type(0)), np.full(stored.shape, bool(where.any()))
        chosen = np.asarray(where)
        content, bits = encode_raw(
            stored.astype(native(kept.data_type)), kept.data_type, kept.byte_order, kept.bit_mask
        )
        places = part.offsets[chosen][..., None] + np.arange(content.shape[-1]) + address
        columns = (places, content[chosen], bits[chosen])
        for at, value, mask in zip(*(column.ravel().tolist() for column in columns), strict=True):
            self._cell(name, at, value, mask)

    def _cell(self, name: str, at: int, value: int, mask: int) -> None:
        before, known, other = self.cells.get(at, (0, 0, name))
        if (before ^ value) & mask & known and other != name and (other, name) not in self.clashes:
            self.clashes.add((other, name))
            message = f"shares memory with {other} at 0x{at:X}, which is set to another value"
            self.findings.error(0, name, message, "Set both to the same value.")
        self.cells[at] = ((before & ~mask) | (value & mask), known | mask, name)

    def changes(self, image: Image) -> dict[int, bytes]:
        """Return the bytes of the image to be changed, by address."""
        result = {}
        for run in _runs(sorted(self.cells)):
            held = image.read(run[0], len(run))
            if held is None:
                continue
            cells = (self.cells[at] for at in run)
            new = bytes((old & ~mask & 255) | value for old, (value, mask, _) in zip(held, cells, strict=True))
            if new != held:
                result[run[0]] = new
        return result


def _runs(addresses: list[int]) -> Iterator[list[int]]:
    """Yield runs of consecutive addresses."""
    start = 0
    for at in range(1, len(addresses) + 1):
        if at == len(addresses) or addresses[at] != addresses[at - 1] + 1:
            yield addresses[start:at]
            start = at


def write_values(a2l: A2l, image: Image, parameters: ParameterSet, findings: Findings) -> bytes:
    """Return the file of an image with the values of `parameters` in it; byte for byte the same where nothing changed.

    Notes an error for each value beyond what its data type or its limits allow and for each shape that the memory
    does not have, and remarks on what is rounded, cannot be written or is not in the A2L file.
    """
    writer = _ImageWriter(Labels(a2l, image), findings, parameters)
    writer.write()
    content = image.changed(writer.memory.changes(image))
    if content != image.raw:
        check_epk(a2l, image, findings)
        writer.roundings.report(findings)
        findings.warning(0, "", "checksums of the control unit are not updated; the flash tool must do it")
        _warn_about_dependent(a2l, writer.done, findings)
        _report_shared_memory(a2l, image, content, writer, findings)
    return content


@dataclass
class _ImageWriter:
    labels: Labels
    findings: Findings
    given: ParameterSet
    memory: Memory = field(init=False)
    roundings: Roundings = field(default_factory=Roundings)
    done: dict[str, None] = field(default_factory=dict)  # what may have changed
    left: list[str] = field(default_factory=list)  # names the A2L file does not have

    def __post_init__(self) -> None:
        self.memory = Memory(self.findings)

    def write(self) -> None:
        """Return every group axis, parameter and text."""
        self._warn_about_units()
        for axis in self.given.axes:
            if axis.name in self.labels.a2l.axis_pts:
                self._try_write(self.labels.a2l.axis_pts[axis.name], partial(self._shared_axis, axis))
        for item in self.given.chosen:
            source = self.labels.a2l.characteristics.get(item.name)
            if source is None:
                self.left.append(item.name)
            elif isinstance(item, Text):
                self._try_write(source, partial(self._text, item))
            else:
                self._try_write(source, partial(self._parameter, item))
        others = list(dict.fromkeys(item.name for item in self.given.others))
        if others:
            message = f"further variants of {count_labels(others)} left out: the control unit has one place for each"
            self.findings.warning(0, "", message)
        if self.left:
            self.findings.warning(0, "", f"{count_labels(self.left)} left out: not in {self.labels.a2l.file}")

    def _warn_about_units(self) -> None:
        """Warn about values in another unit than the control unit's; conversion is left to the user."""
        found = []
        for member in self.given.parameters:
            source = self.labels.a2l.characteristics.get(member.name)
            unit = "" if source is None else self.labels.unit(source)
            if unit and member.unit and unit != member.unit:
                found.append(f"{member.name} in {member.unit}, not {unit}")
        if found:
            shown = join_names(found, 3, "; ")
            message = f"written without conversion, since {self.labels.a2l.file} states another unit: {shown}"
            self.findings.warning(0, "", message, "Check that this is intended.")

    def _try_write(self, source: AxisPts | Characteristic, write: Callable[[], None]) -> None:
        """Write a label, with a warning if it is not possible."""
        try:
            write()
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
        points = _memory_order(axis.breakpoints, shared.falling)
        if points.size != len(shared.axis):
            self._resized_axis(shared, points)
        else:
            self._numbers(shared.source, shared.part, points, shared.source.address, "breakpoint")

    def _resized_axis(self, shared: SharedAxis, points: Float) -> None:
        """Change the size of an axis, if the memory stores its point count, with all tables that share it."""
        name = shared.source.name
        users = [
            one.name
            for one in self.labels.a2l.characteristics.values()
            if any(axis.axis_pts_ref == name for axis in one.axes) and one.name not in self.given
        ]
        if users:
            self._wrong(
                name,
                f"has {points.size} breakpoints, but the image has {len(shared.axis or ())}, and {count_labels(users)} "
                "sharing them are not given",
                "Include these tables.",
            )
            return
        places = self._resized(shared.source, {"AXIS_PTS_X": points.size}, (len(shared.axis or ()),))
        if places is not None:
            part = self.labels.part(shared.source.address, places, "AXIS_PTS_X", shared.part.kept)
            self._counts(shared.source, places)
            self._numbers(shared.source, part, points, shared.source.address, "breakpoint", everything=True)

    def _resized(
        self, source: AxisPts | Characteristic, counts: Mapping[str, int], before: tuple[int, ...]
    ) -> PartOffsets | None:
        """Locate all parts for other point counts; None, with an error, if the memory stores no counts."""
        layout = self.labels.layout(source.record_layout)
        stored = {f"AXIS_PTS_{one.direction}" for one in layout.components if one.kind == "NO_AXIS_PTS"}
        shared = isinstance(source, Characteristic) and {
            f"AXIS_PTS_{direction}"
            for direction, axis in zip(DIRECTIONS, source.axes, strict=False)
            if axis.attribute == "COM_AXIS"
        }
        sizes = " x ".join(map(str, counts.values()))
        said = f"has {sizes} points, but {' x '.join(map(str, before))} in the image"
        if not set(counts) <= stored | (shared or set()):
            self._wrong(source.name, f"{said}, which stores no point count", "Use the same number.")
            return None
        try:
            return self.labels.places(source, counts)
        except A2lError as error:
            self._wrong(source.name, f"{said}: it {error}")
        except AbsentError:
            self._wrong(source.name, f"{said}, where there is no room for them")
        return None

    def _counts(self, source: AxisPts | Characteristic, places: PartOffsets) -> None:
        """Write the numbers of points that the memory keeps."""
        for key, component in places.components.items():
            if component.kind != "NO_AXIS_PTS":
                continue
            number = places.counts[f"AXIS_PTS_{component.direction}"]
            order = self.labels.order(source)
            kept = StorageFormat(component.data_type, order, self.labels.plain)
            part = self.labels.part(source.address, places, key, kept)
            self._numbers(source, part, np.array(float(number)), source.address, "number of points")

    def _parameter(self, member: Parameter) -> None:
        label = self.labels.label(member.name)
        if label.member is None:
            message = "is a text in the control unit"
            self.findings.warning(0, member.name, f"{message}; the number given is not written")
            return
        if label.member.values.ndim != member.values.ndim or len(label.axes) != len(member.axes):
            self._wrong(member.name, f"is a {member.kind}, but a {label.member.kind} in the control unit")
            return
        if member.values.shape != label.member.values.shape:
            self._resized_table(label, member)
            return
        for direction, mine, axis in zip(DIRECTIONS, label.axes, member.axes, strict=False):
            self._axis(label, direction, mine, axis)
        values = label.in_memory_order(member.values)
        self._numbers(label.source, label.part, values, label.source.address, "value", member)

    def _axis(self, label: Label, direction: str, mine: AxisInMemory, axis: Axis) -> None:
        points = _memory_order(axis.breakpoints, mine.falling)
        if mine.part is not None:
            self._numbers(
                label.source, mine.part, points, label.source.address, f"{direction} breakpoint", locked=mine.read_only
            )
            return
        wanted = self._shared_points(mine)
        span = float(np.ptp(wanted)) or 1.0
        if np.any(np.abs(axis.breakpoints - wanted) > _FIXED_POINT_TOLERANCE * span):
            at = int(np.argmax(np.abs(axis.breakpoints - wanted)))
            which = f"where the common axis {mine.shared} has" if mine.shared else "which the control unit fixes to"
            message = f"has the {direction} breakpoint {axis.breakpoints[at]:g}, {which} {wanted[at]:g}"
            self._wrong(label.source.name, message, "Use the same breakpoints.")

    def _shared_points(self, mine: AxisInMemory) -> Float:
        """Return the breakpoints that a common axis will have."""
        given = next((axis for axis in self.given.axes if axis.name == mine.shared), None) if mine.shared else None
        return mine.axis.breakpoints if given is None else given.breakpoints

    def _resized_table(self, label: Label, member: Parameter) -> None:
        before, sizes = label.part.physical.shape, member.values.shape
        if not label.axes:
            said = " x ".join(map(str, sizes))
            self._wrong(member.name, f"has {said} values, but {' x '.join(map(str, before))} in the control unit")
            return
        both = zip(DIRECTIONS, sizes, before, strict=False)
        counts = {f"AXIS_PTS_{direction}": size for direction, size, old in both if size != old}
        places = self._resized(label.source, counts, before)
        if places is None:
            return
        self._counts(label.source, places)
        for direction, mine, axis in zip(DIRECTIONS, label.axes, member.axes, strict=False):
            points, key = _memory_order(axis.breakpoints, mine.falling), f"AXIS_PTS_{direction}"
            if mine.part is not None:
                part = self.labels.part(label.source.address, places, key, mine.part.kept)
                self._numbers(
                    label.source, part, points, label.source.address, f"{direction} breakpoint", everything=True
                )
            elif len(self._shared_points(mine)) == len(axis):
                self._axis(label, direction, mine, axis)
            else:
                self._wrong(member.name, f"has {len(axis)} {direction} breakpoints, but its axis has another number")
        part = self.labels.part(label.source.address, places, "FNC_VALUES", label.part.kept)
        values = label.in_memory_order(member.values)
        self._numbers(label.source, part, values, label.source.address, "value", member, everything=True)

    def _text(self, text: Text) -> None:
        label = self.labels.label(text.name)
        if label.text is None:
            message = f"is a {label.source.type} in the control unit"
            self.findings.warning(0, text.name, f"{message}; the text given is not written")
            return
        if text.kind != label.text.kind:
            self.findings.warning(0, text.name, f"is of kind {text.kind}, but {label.text.kind} in the control unit")
        if text.text == label.text.text:
            return
        if label.source.read_only:
            self._read_only(label.source, 1)
        elif label.words is not None:
            self._word(label, text)
        else:
            self._characters(label, text)

    def _word(self, label: Label, text: Text) -> None:
        words = label.part.kept.conversion.words
        raw = None if words is None else words.raw(text.text)
        if raw is None or words is None:
            known = ", ".join(dict.fromkeys(word for _, _, word in words.table.ranges)) if words else ""
            self._wrong(text.name, f"must be one of its texts, got {text.text[:40]!r}", f"Choose from {known[:200]}.")
            return
        self.done[text.name] = None
        self.memory.put(label.source.name, label.source.address, label.part, np.asarray(raw), np.asarray(True))

    def _characters(self, label: Label, text: Text) -> None:
        size = label.part.stored.size
        content = text.text.encode(encoding_of(label.source), errors="replace")
        if len(content) > size:
            self._wrong(text.name, f"has {len(content)} characters, but there is room for {size}", "Shorten the text.")
            return
        raw = np.frombuffer(content.ljust(size, b"\0"), dtype=np.uint8).astype(np.float64)
        if label.part.kept.data_type == "SBYTE":
            raw = np.where(raw > 127, raw - 256, raw)
        self.done[text.name] = None
        self.memory.put(text.name, label.source.address, label.part, raw, raw != label.part.stored)

    def _numbers(
        self,
        source: AxisPts | Characteristic,
        part: ObjectPart,
        values: Float,
        address: int,
        item: str,
        member: Parameter | None = None,
        *,
        everything: bool = False,
        locked: bool = False,
    ) -> None:
        """Write the numbers that differ from the memory, or all if `everything` is set."""
        unlike = part.unlike(values) | everything
        if not unlike.any():
            return
        axes = None if member is None else member.axes
        found = nearest_raw(source.name, part, values, unlike, item, axes, self.findings)
        if found is None:
            return
        changed = (found.raw != part.raw) & unlike
        if (source.read_only or locked) and changed.any():
            self._read_only(source, int(changed.sum()))
            return
        self.done[source.name] = None
        self.roundings.keep(source.name, found)
        self.memory.put(source.name, address, part, found.raw, changed | everything)

    def _read_only(self, source: AxisPts | Characteristic, count: int) -> None:
        message = f"is READ_ONLY: {count_noun(count, 'changed value')} not written"
        self.findings.warning(0, source.name, message)

    def _wrong(self, name: str, message: str, remedy: str = "") -> None:
        self.findings.error(0, name, message, remedy)


def _memory_order(points: Float, falling: bool) -> Float:
    return points[::-1] if falling else points


def _warn_about_dependent(a2l: A2l, changed: Collection[str], findings: Findings) -> None:
    """Warn about labels that formulas derive from changed ones."""
    found = [
        one.name
        for one in a2l.characteristics.values()
        if one.name not in changed and any(name in changed for name in one.dependent_on)
    ]
    if found:
        message = f"not recomputed although labels in their formulas changed: {count_labels(found)}"
        findings.warning(0, "", message)


def _report_shared_memory(a2l: A2l, image: Image, content: bytes, writer: _ImageWriter, findings: Findings) -> None:
    """Report labels that change only because they share memory with others."""
    after = Labels(a2l, read_image(content, image.name, Findings(image.name)))
    for name in a2l.characteristics:
        if name in writer.done or name in a2l.axis_pts:
            continue
        try:
            before, now = writer.labels.label(name), after.label(name)
        except (A2lError, AbsentError):
            continue
        if before.places.offsets.keys() == now.places.offsets.keys() and before.same_numbers(now):
            continue
        given = name in writer.given
        message = "changes unintentionally: it shares memory with another label that is changed"
        (findings.error if given else findings.warning)(0, name, message)

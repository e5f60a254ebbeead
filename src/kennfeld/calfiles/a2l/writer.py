"""Values written back into an image, as the control unit can store them.

A number that has not changed keeps its bytes; a changed one becomes the nearest raw number (of two as near the even
one). Checksums of the control unit are not touched.

Bytes to be put into an image, gathered over all labels; no bit gets two values.
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
from kennfeld.calfiles.a2l.storage import ObjectPart, Raw, Roundings, StorageFormat, encoded, native, nearest_raw
from kennfeld.calfiles.a2l.syntax import A2lError
from kennfeld.calfiles.flash.image import Image
from kennfeld.calfiles.flash.records import read_image
from kennfeld.calfiles.format import Findings
from kennfeld.formatting import count_noun, join_limited
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

__all__ = ["stored"]

_CLOSE = 1e-5  # of its span, as far as a breakpoint that cannot change may be off in a file with few digits


@dataclass
class Memory:
    """What labels put at which address: the bits, which of them count, and who wants them."""

    notes: Findings
    cells: dict[int, tuple[int, int, str]] = field(default_factory=dict)
    clashes: set[tuple[str, str]] = field(default_factory=set)

    def put(self, name: str, address: int, part: ObjectPart, raw: Any, where: Bool) -> None:
        """Put raw numbers of a part of an object at an address, those of `where`."""
        kept = part.kept
        stored: Raw = np.asarray(raw)
        if kept.difference:
            stored, where = np.diff(stored, prepend=stored.dtype.type(0)), np.full(stored.shape, bool(where.any()))
        chosen = np.asarray(where)
        content, bits = encoded(stored.astype(native(kept.data_type)), kept.data_type, kept.byte_order, kept.bit_mask)
        places = part.offsets[chosen][..., None] + np.arange(content.shape[-1]) + address
        columns = (places, content[chosen], bits[chosen])
        for at, value, mask in zip(*(column.ravel().tolist() for column in columns), strict=True):
            self._cell(name, at, value, mask)

    def _cell(self, name: str, at: int, value: int, mask: int) -> None:
        before, known, other = self.cells.get(at, (0, 0, name))
        if (before ^ value) & mask & known and other != name and (other, name) not in self.clashes:
            self.clashes.add((other, name))
            message = f"lies in the same memory as {other} at 0x{at:X}, which shall have another value"
            self.notes.error(0, name, message, "Give both the same.")
        self.cells[at] = ((before & ~mask) | (value & mask), known | mask, name)

    def changes(self, image: Image) -> dict[int, bytes]:
        """The bytes of the image to be changed, by address."""
        made = {}
        for run in _runs(sorted(self.cells)):
            held = image.read(run[0], len(run))
            if held is None:
                continue
            cells = (self.cells[at] for at in run)
            new = bytes((old & ~mask & 255) | value for old, (value, mask, _) in zip(held, cells, strict=True))
            if new != held:
                made[run[0]] = new
        return made


def _runs(addresses: list[int]) -> Iterator[list[int]]:
    """Addresses that follow each other."""
    start = 0
    for at in range(1, len(addresses) + 1):
        if at == len(addresses) or addresses[at] != addresses[at - 1] + 1:
            yield addresses[start:at]
            start = at


def stored(a2l: A2l, image: Image, parameters: ParameterSet, notes: Findings) -> bytes:
    """The file of an image with the values of `parameters` in it; byte for byte the same where nothing changed.

    Notes an error for each value beyond what its data type or its limits allow and for each shape that the memory
    does not have, and remarks on what is rounded, cannot be written or is not in the A2L file.
    """
    writer = _ImageWriter(Labels(a2l, image), notes, parameters)
    writer.write()
    content = image.changed(writer.memory.changes(image))
    if content != image.raw:
        check_epk(a2l, image, notes)
        writer.roundings.tell(notes)
        notes.remark(0, "", "the checksums of the control unit are left to the flash tool")
        _tell_dependent(a2l, writer.done, notes)
        _tell_shared_memory(a2l, image, content, writer, notes)
    return content


@dataclass
class _ImageWriter:
    labels: Labels
    notes: Findings
    given: ParameterSet
    memory: Memory = field(init=False)
    roundings: Roundings = field(default_factory=Roundings)
    done: dict[str, None] = field(default_factory=dict)  # what may have changed
    left: list[str] = field(default_factory=list)  # names the A2L file does not have

    def __post_init__(self) -> None:
        self.memory = Memory(self.notes)

    def write(self) -> None:
        """Every group axis, parameter and text."""
        self._tell_units()
        for axis in self.given.axes:
            if axis.name in self.labels.a2l.axis_pts:
                self._guarded(self.labels.a2l.axis_pts[axis.name], partial(self._shared_axis, axis))
        for thing in self.given.chosen:
            source = self.labels.a2l.characteristics.get(thing.name)
            if source is None:
                self.left.append(thing.name)
            elif isinstance(thing, Text):
                self._guarded(source, partial(self._text, thing))
            else:
                self._guarded(source, partial(self._parameter, thing))
        others = list(dict.fromkeys(thing.name for thing in self.given.others))
        if others:
            message = f"further variants of {join_limited(others)} left out: the control unit has one place for each"
            self.notes.remark(0, "", message)
        if self.left:
            self.notes.remark(0, "", f"{join_limited(self.left)} left out: {self.labels.a2l.file} does not have them")

    def _tell_units(self) -> None:
        """Numbers in another unit than the control unit's would be wrong; that is for a person to decide."""
        found = []
        for member in self.given.parameters:
            source = self.labels.a2l.characteristics.get(member.name)
            unit = "" if source is None else self.labels.unit(source)
            if unit and member.unit and unit != member.unit:
                found.append(f"{member.name} in {member.unit}, not {unit}")
        if found:
            message = f"{count_noun(len(found), 'label')} in another unit than {self.labels.a2l.file} states"
            self.notes.remark(
                0, "", f"{message}, written as they are: {'; '.join(found[:3])}", "See whether that is meant."
            )

    def _guarded(self, source: AxisPts | Characteristic, write: Callable[[], None]) -> None:
        """Do it; what cannot be written is told."""
        try:
            write()
        except A2lError as error:
            self.notes.remark(0, source.name, f"cannot be written: it {error}")
        except AbsentError:
            message = f"cannot be written: 0x{source.address:X} is not in {self.labels.image.name}"
            self.notes.remark(0, source.name, message)

    def _shared_axis(self, axis: Axis) -> None:
        shared = self.labels.shared(axis.name)
        if shared.axis is None:
            self.notes.remark(0, axis.name, "is a rescale axis, which is not written")
            return
        points = _in_order(axis.breakpoints, shared.falling)
        if points.size != len(shared.axis):
            self._resized_axis(shared, points)
        else:
            self._numbers(shared.source, shared.part, points, shared.source.address, "breakpoint")

    def _resized_axis(self, shared: SharedAxis, points: Float) -> None:
        """Another number of breakpoints: possible where the memory counts them, with all tables that share them."""
        name = shared.source.name
        users = [
            one.name
            for one in self.labels.a2l.characteristics.values()
            if any(axis.axis_pts_ref == name for axis in one.axes) and one.name not in self.given
        ]
        if users:
            self._wrong(
                name,
                f"has {points.size} breakpoints, the image {len(shared.axis or ())}, and {join_limited(users)} "
                "that share them are not given",
                "Give these tables too.",
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
        """Where everything is with other numbers of points; None, and an error, where the memory has none of them."""
        layout = self.labels.layout(source.record_layout)
        stored = {f"AXIS_PTS_{one.direction}" for one in layout.components if one.kind == "NO_AXIS_PTS"}
        shared = isinstance(source, Characteristic) and {
            f"AXIS_PTS_{direction}"
            for direction, axis in zip(DIRECTIONS, source.axes, strict=False)
            if axis.attribute == "COM_AXIS"
        }
        sizes = " x ".join(map(str, counts.values()))
        said = f"has {sizes} points here, {' x '.join(map(str, before))} in the image"
        if not set(counts) <= stored | (shared or set()):
            self._wrong(source.name, f"{said}, which keeps no number of them", "Give it as many.")
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
            self.notes.remark(0, member.name, f"{message}; the number given is not written")
            return
        if label.member.values.ndim != member.values.ndim or len(label.axes) != len(member.axes):
            self._wrong(member.name, f"is a {member.kind} here and a {label.member.kind} in the control unit")
            return
        if member.values.shape != label.member.values.shape:
            self._resized_table(label, member)
            return
        for direction, mine, axis in zip(DIRECTIONS, label.axes, member.axes, strict=False):
            self._axis(label, direction, mine, axis)
        values = label.in_memory_order(member.values)
        self._numbers(label.source, label.part, values, label.source.address, "value", member)

    def _axis(self, label: Label, direction: str, mine: AxisInMemory, axis: Axis) -> None:
        points = _in_order(axis.breakpoints, mine.falling)
        if mine.part is not None:
            self._numbers(
                label.source, mine.part, points, label.source.address, f"{direction} breakpoint", locked=mine.read_only
            )
            return
        wanted = self._shared_points(mine)
        span = float(np.ptp(wanted)) or 1.0
        if np.any(np.abs(axis.breakpoints - wanted) > _CLOSE * span):
            at = int(np.argmax(np.abs(axis.breakpoints - wanted)))
            which = f"where the common axis {mine.shared} has" if mine.shared else "which the control unit fixes to"
            message = f"has the {direction} breakpoint {axis.breakpoints[at]:g}, {which} {wanted[at]:g}"
            self._wrong(label.source.name, message, "Give both the same breakpoints.")

    def _shared_points(self, mine: AxisInMemory) -> Float:
        """The breakpoints that a common axis will have."""
        given = next((axis for axis in self.given.axes if axis.name == mine.shared), None) if mine.shared else None
        return mine.axis.breakpoints if given is None else given.breakpoints

    def _resized_table(self, label: Label, member: Parameter) -> None:
        before, sizes = label.part.physical.shape, member.values.shape
        if not label.axes:
            said = " x ".join(map(str, sizes))
            self._wrong(member.name, f"has {said} values here, {' x '.join(map(str, before))} in the control unit")
            return
        both = zip(DIRECTIONS, sizes, before, strict=False)
        counts = {f"AXIS_PTS_{direction}": size for direction, size, old in both if size != old}
        places = self._resized(label.source, counts, before)
        if places is None:
            return
        self._counts(label.source, places)
        for direction, mine, axis in zip(DIRECTIONS, label.axes, member.axes, strict=False):
            points, key = _in_order(axis.breakpoints, mine.falling), f"AXIS_PTS_{direction}"
            if mine.part is not None:
                part = self.labels.part(label.source.address, places, key, mine.part.kept)
                self._numbers(
                    label.source, part, points, label.source.address, f"{direction} breakpoint", everything=True
                )
            elif len(self._shared_points(mine)) == len(axis):
                self._axis(label, direction, mine, axis)
            else:
                self._wrong(member.name, f"has {len(axis)} {direction} breakpoints, its axis has another number")
        part = self.labels.part(label.source.address, places, "FNC_VALUES", label.part.kept)
        values = label.in_memory_order(member.values)
        self._numbers(label.source, part, values, label.source.address, "value", member, everything=True)

    def _text(self, text: Text) -> None:
        label = self.labels.label(text.name)
        if label.text is None:
            message = f"is a {label.source.type} in the control unit"
            self.notes.remark(0, text.name, f"{message}; the text given is not written")
            return
        if text.kind != label.text.kind:
            self.notes.remark(0, text.name, f"is of the kind {text.kind} here, {label.text.kind} in the control unit")
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
            self._wrong(text.name, f"{text.text[:40]!r} is no word that it can have", f"Choose from {known[:200]}.")
            return
        self.done[text.name] = None
        self.memory.put(label.source.name, label.source.address, label.part, np.asarray(raw), np.asarray(True))

    def _characters(self, label: Label, text: Text) -> None:
        size = label.part.stored.size
        content = text.text.encode(encoding_of(label.source), errors="replace")
        if len(content) > size:
            self._wrong(text.name, f"has {len(content)} characters, there is room for {size}", "Shorten the text.")
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
        thing: str,
        member: Parameter | None = None,
        *,
        everything: bool = False,
        locked: bool = False,
    ) -> None:
        """Write the numbers that differ from the memory, or `everything` where it lies anew."""
        unlike = part.unlike(values) | everything
        if not unlike.any():
            return
        axes = None if member is None else member.axes
        found = nearest_raw(source.name, part, values, unlike, thing, axes, self.notes)
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
        message = f"is READ_ONLY: {count_noun(count, 'other value')} given for it not written"
        self.notes.remark(0, source.name, message)

    def _wrong(self, name: str, message: str, remedy: str = "") -> None:
        self.notes.error(0, name, message, remedy)


def _in_order(points: Float, falling: bool) -> Float:
    return points[::-1] if falling else points


def _tell_dependent(a2l: A2l, changed: Collection[str], notes: Findings) -> None:
    """Tell which labels a formula gives from others that have changed."""
    found = [
        one.name
        for one in a2l.characteristics.values()
        if one.name not in changed and any(name in changed for name in one.dependent_on)
    ]
    if found:
        message = f"{join_limited(found)} follow from changed labels by formulas, which are not calculated"
        notes.remark(0, "", f"{message}; their numbers stay")


def _tell_shared_memory(a2l: A2l, image: Image, content: bytes, writer: _ImageWriter, notes: Findings) -> None:
    """Tell which labels that were not to change have changed, because they lie in the same memory as others."""
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
        message = "changes although it is not to: it lies in the same memory as another label that does"
        (notes.error if given else notes.remark)(0, name, message)

"""Labels of an A2L file as stored in an image: each a parameter or a text, with the memory it was read from.

Breakpoints are stored, computed from offset and distance, or derived from rescale pairs and other curves. They are
returned in ascending order; an axis is falling if the memory has them in descending order.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import inf, prod
from typing import Any, TypeVar

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import holds_control_characters
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.a2l.conversion import IDENTITY, VerbalConversion, conversion_of
from kennfeld.calfiles.a2l.objects import (
    DIRECTIONS,
    A2l,
    AxisDescr,
    AxisPts,
    Characteristic,
    Component,
    RecordLayout,
    StoredNumbers,
)
from kennfeld.calfiles.a2l.record_layout import AbsentError, LayoutRequest, PartOffsets, place_parts
from kennfeld.calfiles.a2l.storage import SIZES, ObjectPart, StorageFormat, decode_raw, first_byte_order
from kennfeld.calfiles.a2l.syntax import A2lError
from kennfeld.calfiles.content import in_rising_order, turn
from kennfeld.calfiles.flash.image import Image
from kennfeld.calfiles.verbal_values import kind_of_words
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Block, Parameter, parameter
from kennfeld.domain.texts import Text

_AXES = {"CURVE": 1, "MAP": 2, "CUBOID": 3, "CUBE_4": 4}
ENCODINGS = {"": "latin-1", "ASCII": "latin-1", "UTF8": "utf-8"}  # of texts, as Python names them
_MAX_DIMENSIONS = 4
_MAX_COUNT = 2**31
_MAX_NESTING = 16  # curves that give each other their axes

Stored = TypeVar("Stored", "SharedAxis", "Label")


def fixed_points(axis: AxisDescr, count: int) -> Float:
    """Compute the raw numbers of the first breakpoints of a fixed axis, Float[count]."""
    if axis.fixed_spacing is not None:
        return space_points(*axis.fixed_spacing[:2], count)
    if not axis.fixed_points:
        raise A2lError(f"has a {axis.attribute} without breakpoints")
    return np.array(axis.fixed_points[:count])


def space_points(offset: float, distance: float, count: int) -> Float:
    """Space raw numbers at equal distances: offset + distance * k, Float[count]."""
    points: Float = offset + distance * np.arange(count, dtype=np.float64)
    return points


def sort_points(points: Float) -> tuple[Float, bool]:
    """Sort breakpoints, Float[points], and return True if they fell; `A2lError` if they neither rise nor fall."""
    if not np.all(np.isfinite(points)):
        raise A2lError("has breakpoints without a physical value")
    rising, falls = in_rising_order(points)
    if np.all(rising[1:] > rising[:-1]):
        return rising, falls
    steps = np.diff(points)
    at = int(np.flatnonzero((steps <= 0) if steps[0] > 0 else (steps >= 0))[0]) if steps[0] else 0
    raise A2lError(
        f"has breakpoints that are not monotonic: number {at + 1} is {points[at]:g}, "
        f"number {at + 2} is {points[at + 1]:g}"
    )


def resolve_axis(inputs: Float, positions: Float, count: int, name: str, unit: str, quantity: str) -> Axis:
    """Return the inputs, Float[pairs], of the positions 0, 1, ...: the same lookup only if every pair is a column."""
    if not np.array_equal(positions, np.arange(count)) or np.any(np.diff(inputs) <= 0):
        raise A2lError(f"has breakpoints that cannot be derived from the positions of {name}")
    return Axis(inputs, input=quantity, unit=unit)


@dataclass(frozen=True)
class AxisInMemory:
    """An axis of a table, falling if the memory has it so, and where its breakpoints come from."""

    axis: Axis
    part: ObjectPart | None = None  # of its own
    shared: str = ""  # the AXIS_PTS that it refers to
    read_only: bool = False


@dataclass(frozen=True)
class SharedAxis:
    """Breakpoints that tables share: an axis, or the pairs of input and position of a rescale axis."""

    source: AxisPts
    places: PartOffsets
    part: ObjectPart
    axis: Axis | None = None
    pairs: Float | None = None  # one row a pair


@dataclass(frozen=True)
class Label:
    """A characteristic in the memory."""

    source: Characteristic
    places: PartOffsets
    part: ObjectPart
    axes: tuple[AxisInMemory, ...] = ()
    member: Parameter | None = None
    text: Text | None = None
    words: VerbalConversion | None = None  # if the text is a word for a number

    def same_numbers(self, other: "Label") -> bool:
        """Check whether another state of the same label has the same raw numbers."""
        parts = [(self.part, other.part)]
        parts += [(a.part, b.part) for a, b in zip(self.axes, other.axes, strict=True) if a.part and b.part]
        # a NaN that stays is not a change
        return all(np.array_equal(a.stored, b.stored, equal_nan=not a.storage.integer) for a, b in parts)

    def in_memory_order(self, values: Float) -> Float:
        """Convert values, Float[x, y, ...], between rising axes and the order of the memory, in either direction."""
        return turn(values, [each.axis for each in self.axes])


class Labels:
    """Reader of single labels; unsupported ones raise `A2lError`, those not in the image `AbsentError`."""

    def __init__(self, a2l: A2l, image: Image) -> None:
        self.a2l, self.image = a2l, image
        self._shared: dict[str, SharedAxis | Exception] = {}
        self._labels: dict[str, Label | Exception] = {}
        self._depth = 0

    def shared(self, name: str) -> SharedAxis:
        return _read_once(self._shared, name, lambda: self._read_shared(name))

    def label(self, name: str) -> Label:
        return _read_once(self._labels, name, lambda: self._read_label(self.a2l.characteristics[name]))

    def _read_shared(self, name: str) -> SharedAxis:
        source = self.a2l.axis_pts.get(name)
        if source is None:
            raise A2lError(f"refers to the axis {name[:80]}, which is not defined")
        places = self.places(source)
        key = next((key for key in ("AXIS_PTS_X", "AXIS_RESCALE_X") if key in places.offsets), "")
        if not key:
            raise A2lError(f"has the record layout {source.record_layout}, which has no AXIS_PTS_X")
        part = self.part(source.address, places, key, self._axis_storage(source, places.components[key]))
        if key == "AXIS_RESCALE_X":
            # inputs in physical units, positions as column numbers
            pairs = np.column_stack([part.physical[:, 0], part.raw[:, 1].astype(np.float64)])
            return SharedAxis(source, places, part, pairs=pairs)
        points, falling = sort_points(part.physical)
        quantity, unit = _input_quantity(source.input_quantity), self.unit(source)
        return SharedAxis(source, places, part, Axis(points, quantity, unit, name, falling=falling))

    def unit(self, source: StoredNumbers) -> str:
        method = self.a2l.compu_methods.get(source.conversion)
        return (source.phys_unit or (method.unit if method else "")).strip()

    def _axis_storage(self, source: AxisPts | AxisDescr, component: Component, outer_order: str = "") -> StorageFormat:
        difference = (source.deposit or self.a2l.common.deposit) == "DIFFERENCE"
        if difference and component.mode == "INDEX_DECR":
            raise A2lError("stores breakpoints as differences in descending order")
        conversion = conversion_of(self.a2l, source.conversion, source.lower, source.upper)
        if conversion.words is not None:
            raise A2lError("has verbal values as breakpoints")
        order = first_byte_order(source.byte_order, outer_order, self.a2l.common.byte_order)
        # rescale pairs are never stored as differences
        difference &= component.kind == "AXIS_PTS"
        return StorageFormat(component.data_type, order, conversion, None, difference, *hard_limits(source))

    def layout(self, name: str) -> RecordLayout:
        if name not in self.a2l.record_layouts:
            raise A2lError(f"has the record layout {name[:60]}, which is not defined")
        return self.a2l.record_layouts[name]

    def places(self, source: AxisPts | Characteristic, counts: Mapping[str, int] | None = None) -> PartOffsets:
        """Locate the parts of an object, with the point counts of the image or those of `counts`."""
        layout = self.layout(source.record_layout)

        def count_at(component: Component, offset: int) -> int:
            key = f"{'AXIS_RESCALE' if component.kind == 'NO_RESCALE' else 'AXIS_PTS'}_{component.direction}"
            # an object to be resized has the counts of the new set
            if counts is not None and key in counts:
                return counts[key]
            memory = self.image.read(source.address + offset, SIZES[component.data_type])
            if memory is None:
                raise AbsentError
            number = float(decode_raw(memory, np.array(0), component.data_type, self.order(source)))
            # 0 if it cannot be a count, which is refused as a number of points
            return int(number) if 0 <= number < _MAX_COUNT else 0

        request, alignments = self._request(source, counts), self.a2l.common.alignments
        return place_parts(layout, source.address, request, alignments, count_at, self.image.holds)

    def _request(self, source: AxisPts | Characteristic, counts: Mapping[str, int] | None) -> LayoutRequest:
        if isinstance(source, AxisPts):
            return LayoutRequest({"X": source.max_axis_points}, values=False)
        if not source.axes:
            return LayoutRequest({}, _value_sizes(source))
        most = {}
        for direction, axis in zip(DIRECTIONS, source.axes, strict=False):
            most[direction] = self._most(axis)
            if counts is not None and axis.attribute == "COM_AXIS":
                most[direction] = counts.get(f"AXIS_PTS_{direction}", most[direction])
        return LayoutRequest(most)

    def _most(self, axis: AxisDescr) -> int:
        """Return the maximum number of points of an axis, or the actual number if they are stored elsewhere."""
        if axis.attribute == "COM_AXIS":
            shared = self.shared(axis.axis_pts_ref)
            if shared.axis is None:
                raise A2lError(f"refers to {axis.axis_pts_ref} as common breakpoints, which are rescale pairs")
            return len(shared.axis)
        fixed = axis.fixed_spacing[2] if axis.fixed_spacing else len(axis.fixed_points)
        # FIX_AXIS_PAR and its like state the number themselves
        return fixed if axis.attribute == "FIX_AXIS" and fixed else axis.max_axis_points

    def order(self, source: AxisPts | Characteristic) -> str:
        return first_byte_order(source.byte_order, self.a2l.common.byte_order)

    def part(self, address: int, places: PartOffsets, key: str, storage: StorageFormat) -> ObjectPart:
        """Return the numbers of one part of an object at an address."""
        offsets = places.offsets[key]
        # one piece of memory from the first to the last number, with whatever lies between
        start, size = int(offsets.min()), int(offsets.max() - offsets.min()) + SIZES[storage.data_type]
        memory = self.image.read(address + start, size)
        if memory is None:
            raise AbsentError
        stored = decode_raw(memory, offsets - start, storage.data_type, storage.byte_order, storage.bit_mask)
        return ObjectPart(storage, offsets, stored)

    def _read_label(self, source: Characteristic) -> Label:
        if source.virtual:
            raise A2lError("is virtual: its value is computed, not stored")
        if source.name in self.a2l.variant_coded:
            raise A2lError("is variant-coded: it is stored once per variant")
        if source.type == "CUBE_5":
            raise A2lError("has five axes, but a table has at most four")
        if len(source.axes) != _AXES.get(source.type, 0):
            raise A2lError(f"is a {source.type} with {len(source.axes)} axes")
        places = self.places(source)
        data_type = places.components["FNC_VALUES"].data_type
        conversion = conversion_of(self.a2l, source.conversion, source.lower, source.upper)
        mask = source.bit_mask or None
        storage = StorageFormat(data_type, self.order(source), conversion, mask, False, *hard_limits(source))
        part = self.part(source.address, places, "FNC_VALUES", storage)
        if source.type == "ASCII":
            return Label(source, places, part, text=_ascii_text(source, part))
        if conversion.words is not None:
            return self._word(source, places, part, conversion.words)
        pairs = zip(DIRECTIONS, source.axes, strict=False)
        axes = tuple(self._axis(source, axis, direction, places) for direction, axis in pairs)
        return self._table(Label(source, places, part, axes))

    def _table(self, label: Label) -> Label:
        source, part = label.source, label.part
        low, high = part.storage.bounds(source.lower, source.upper)
        attributes: dict[str, Any] = {"unit": self.unit(source), "description": source.description}
        attributes |= {"lower": low, "upper": high, "locked": source.read_only}
        values = label.in_memory_order(part.physical)
        # a VALUE may have a MATRIX_DIM as well
        if source.type == "VAL_BLK" or part.offsets.ndim > len(label.axes):
            if values.ndim > _MAX_DIMENSIONS:
                raise A2lError(f"has {values.ndim} dimensions, but a value block has at most {_MAX_DIMENSIONS}")
            return replace(label, member=Block(source.name, values, **attributes))
        return replace(label, member=parameter(source.name, values, [axis.axis for axis in label.axes], **attributes))

    def _word(self, source: Characteristic, places: PartOffsets, part: ObjectPart, words: VerbalConversion) -> Label:
        if part.raw.ndim:
            raise A2lError(f"is a {source.type} of verbal values, which cannot be calibrated")
        word = words.text(float(part.raw))
        if word is None:
            raise A2lError(f"has the raw value {float(part.raw):g}, for which {words.table.name} defines no text")
        # the kind depends on all words of the table, not on the present one
        known = [word for _, _, word in words.table.ranges]
        kind = kind_of_words(known + ([words.table.default] if words.table.default else []))
        text = Text(source.name, word, source.description, unit=self.unit(source), kind=kind)
        return Label(source, places, part, text=text, words=words)

    def _axis(self, source: Characteristic, axis: AxisDescr, direction: str, places: PartOffsets) -> AxisInMemory:
        if axis.attribute == "STD_AXIS" and f"AXIS_PTS_{direction}" in places.offsets:
            return self._own(source, axis, direction, places)
        count = places.offsets["FNC_VALUES"].shape[DIRECTIONS.index(direction)]
        if axis.attribute in ("STD_AXIS", "FIX_AXIS"):
            return self._fixed(source, axis, direction, places, count)
        readers = {"COM_AXIS": self._common, "RES_AXIS": self._rescaled, "CURVE_AXIS": self._by_curve}
        return readers[axis.attribute](axis, count)

    def _own(self, source: Characteristic, axis: AxisDescr, direction: str, places: PartOffsets) -> AxisInMemory:
        key = f"AXIS_PTS_{direction}"
        storage = self._axis_storage(axis, places.components[key], source.byte_order)
        part = self.part(source.address, places, key, storage)
        points, falling = sort_points(part.physical)
        result = Axis(points, _input_quantity(axis.input_quantity), self.unit(axis), falling=falling)
        return AxisInMemory(result, part, read_only=axis.read_only)

    def _fixed(
        self, source: Characteristic, axis: AxisDescr, direction: str, places: PartOffsets, count: int
    ) -> AxisInMemory:
        raw = self._stored_spacing(source, direction, places, count)
        raw = fixed_points(axis, count) if raw is None else raw
        conversion = conversion_of(self.a2l, axis.conversion, axis.lower, axis.upper)
        points, falling = sort_points(conversion.physical(raw))
        return AxisInMemory(Axis(points, _input_quantity(axis.input_quantity), self.unit(axis), falling=falling))

    def _stored_spacing(self, source: Characteristic, direction: str, places: PartOffsets, count: int) -> Float | None:
        """Compute the points of a fixed axis whose offset and distance are stored in the record itself."""
        stored = {}
        for kind in ("OFFSET", "DIST_OP", "SHIFT_OP"):
            key = f"{kind}_{direction}"
            if key in places.offsets:
                storage = StorageFormat(places.components[key].data_type, self.order(source), IDENTITY)
                stored[kind] = float(self.part(source.address, places, key, storage).raw)
        if not stored:
            return None
        shift = stored.get("SHIFT_OP")
        if "DIST_OP" not in stored and (shift is None or abs(shift) > 64):
            raise A2lError(f"has an offset of its {direction} axis in the memory, but no distance")
        return space_points(stored.get("OFFSET", 0.0), stored.get("DIST_OP", 2.0 ** (shift or 0.0)), count)

    def _common(self, axis: AxisDescr, count: int) -> AxisInMemory:
        shared = self.shared(axis.axis_pts_ref)
        if shared.axis is None or len(shared.axis) != count:
            size = 0 if shared.axis is None else len(shared.axis)
            raise A2lError(f"has {count} values along the axis {axis.axis_pts_ref}, which has {size} points")
        return AxisInMemory(shared.axis, shared=axis.axis_pts_ref)

    def _rescaled(self, axis: AxisDescr, count: int) -> AxisInMemory:
        shared = self.shared(axis.axis_pts_ref)
        if shared.pairs is None:
            raise A2lError(f"refers to {axis.axis_pts_ref} as a rescale axis, which has no pairs")
        unit, quantity = self.unit(shared.source), _input_quantity(axis.input_quantity)
        inputs, positions = shared.pairs.T
        return AxisInMemory(resolve_axis(inputs, positions, count, axis.axis_pts_ref, unit, quantity))

    def _by_curve(self, axis: AxisDescr, count: int) -> AxisInMemory:
        name = axis.curve_axis_ref
        self._depth += 1
        try:
            if name in self.a2l.characteristics and self._depth > _MAX_NESTING:
                raise A2lError(f"has an axis that depends on more than {_MAX_NESTING} curves")
            curve = self.label(name) if name in self.a2l.characteristics else None
        finally:
            self._depth -= 1
        if curve is None or curve.member is None or len(curve.axes) != 1:
            raise A2lError(f"refers to {name[:80]} for its axis, which is not a readable curve")
        if curve.axes[0].axis.falling:
            raise A2lError(f"has positions along the curve {name}, whose breakpoints are descending")
        inputs = curve.axes[0].axis
        result = resolve_axis(inputs.breakpoints, curve.member.values, count, name, inputs.unit, inputs.input)
        return AxisInMemory(result)


def _ascii_text(source: Characteristic, part: ObjectPart) -> Text:
    data_type = part.storage.data_type
    if SIZES[data_type] != 1 or source.encoding not in ENCODINGS:
        raise A2lError(f"is text of {data_type} {source.encoding}, not of bytes")
    content = part.stored.astype(np.uint8).tobytes().partition(b"\0")[0]
    text = content.decode(ENCODINGS[source.encoding], errors="replace")
    if holds_control_characters(text):
        raise A2lError("contains bytes that are not text")
    return Text(source.name, text, source.description)


def _read_once(known: dict[str, Stored | Exception], name: str, read: Callable[[], Stored]) -> Stored:
    """Return or raise what was read before; a label that refers to itself raises an error."""
    if name not in known:
        # stands here while the label is read, so that a circle of references ends
        known[name] = A2lError(f"refers to {name[:80]}, which refers to itself")
        try:
            known[name] = read()
        except (A2lError, AbsentError) as error:
            known[name] = error
    result = known[name]
    if isinstance(result, Exception):
        raise result
    return result


def hard_limits(source: Characteristic | AxisPts | AxisDescr) -> tuple[float, float]:
    """Return the hard limits, if they say anything."""
    lower, upper = source.extended_limits or (source.lower, source.upper)
    return (lower, upper) if lower < upper else (-inf, inf)


def _value_sizes(source: Characteristic) -> tuple[int, ...]:
    if source.type in ("VAL_BLK", "ASCII") and not source.shape:
        raise A2lError(f"is a {source.type} that states no size")
    sizes = source.shape
    if source.type == "ASCII":
        return (prod(sizes),)
    return () if source.type == "VALUE" and prod(sizes) == 1 else sizes


def _input_quantity(name: str) -> str:
    return "" if name == "NO_INPUT_QUANTITY" else name

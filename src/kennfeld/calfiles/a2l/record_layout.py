"""Byte offsets of the parts of an object, by its record layout.

The parts follow each other in the order of their positions, each aligned to a multiple of its alignment. Values of
a map are stored by rows (ROW_DIR, x fastest) or columns (COLUMN_DIR, y fastest), layers of a cube one after the
other, or interleaved with the points of an axis (ALTERNATE_WITH_X, ALTERNATE_WITH_Y). A value block is stored like a
table with the sizes of MATRIX_DIM. Unless the layout is static, parts directly follow tables that use fewer points
than their maximum.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from math import prod

import numpy as np

from kennfeld.base.arrays import Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.a2l.objects import Component, RecordLayout
from kennfeld.calfiles.a2l.storage import NUMBERS, SIZES, alignment_of
from kennfeld.calfiles.a2l.syntax import A2lError

_ROWS, _COLUMNS = "ROW_DIR", "COLUMN_DIR"
_ALTERNATING = {"ALTERNATE_WITH_X": "X", "ALTERNATE_WITH_Y": "Y"}
_COUNTS = {"NO_AXIS_PTS": "AXIS_PTS", "NO_RESCALE": "AXIS_RESCALE"}


class AbsentError(Exception):
    """The memory of an object is not in the image."""


@dataclass
class PartOffsets:
    """Byte offsets of the parts from the address of the object, by their keywords, and the numbers of axis points.

    Offsets of FNC_VALUES have a dimension for each axis, x first; those of AXIS_RESCALE one row a pair.
    """

    offsets: dict[str, Int] = field(default_factory=dict)
    components: dict[str, Component] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class LayoutRequest:
    """The directions of an object's axes and the maximum number of points of each.

    An object without axes has the sizes of its block instead.
    """

    most: Mapping[str, int]
    sizes: tuple[int, ...] = ()
    values: bool = True  # false for breakpoints on their own


def place_parts(
    layout: RecordLayout,
    address: int,
    request: LayoutRequest,
    alignments: Mapping[str, int],
    count_at: Callable[[Component, int], int],
    holds: Callable[[int, int], bool],
) -> PartOffsets:
    """Compute the byte offsets of all parts of an object.

    Args:
        layout: The record layout.
        address: The address of the object, which alignment refers to.
        request: The axes and sizes of the object.
        alignments: Defaults of the module, in bytes by data type.
        count_at: Returns the number of points stored at a byte offset of a component.
        holds: Returns True if the image has a number of bytes at an address.

    Returns:
        Offsets relative to `address`, in bytes.

    Raises:
        A2lError: The layout is not supported.
        AbsentError: The memory is not in the image.
    """
    _check_layout(layout, request)
    return _Walk(layout, address, request, alignments, count_at, holds).run()


def _check_layout(layout: RecordLayout, request: LayoutRequest) -> None:
    name = layout.name
    if layout.unknown:
        raise A2lError(f"has the record layout {name} with the unknown keyword {layout.unknown[0]!r}")
    keys = [component.key for component in layout.components if component.kind not in ("RESERVED", "IDENTIFICATION")]
    for key in keys:
        if keys.count(key) > 1:
            raise A2lError(f"has the record layout {name} with two {key}")
    if request.values and "FNC_VALUES" not in keys:
        raise A2lError(f"has the record layout {name}, which has no FNC_VALUES")
    for component in layout.components:
        if component.data_type not in (SIZES if component.kind == "RESERVED" else NUMBERS):
            raise A2lError(f"has the record layout {name} with the data type {component.data_type[:40]!r}")
        if component.addressing != "DIRECT":
            raise A2lError(f"has the record layout {name}, whose {component.key} is a pointer")
        if component.mode == "ALTERNATE_CURVES":
            fault = "ALTERNATE_CURVES does not state how many curves share the memory"
            raise A2lError(f"has the record layout {name}: {fault}")


@dataclass
class _Walk:
    layout: RecordLayout
    address: int
    request: LayoutRequest
    alignments: Mapping[str, int]
    count_at: Callable[[Component, int], int]
    holds: Callable[[int, int], bool]
    spaces_only: bool = False  # look for the room of each part alone
    places: PartOffsets = field(default_factory=PartOffsets)
    count_offsets: dict[str, int] = field(default_factory=dict)  # of stored numbers of points
    at: int = 0

    def run(self) -> PartOffsets:
        for direction, count in self.layout.fixed_counts.items():
            # a layout may fix counts of axes that only other objects have
            if direction in self.request.most:
                self._count(f"AXIS_PTS_{direction}", count)
        if self._is_static():
            self._counts_first()
        done: set[str] = set()
        for component in self.layout.components:
            if component.key not in done:
                done |= self._place(component)
        return self.places

    def _count(self, key: str, count: int) -> None:
        """Keep a number of points, of the points named by `key`."""
        direction = key[-1]
        most = self.request.most.get(direction)
        if count < 1 or (most is not None and count > most and not key.startswith("AXIS_RESCALE")):
            raise A2lError(f"states {count} axis points in direction {direction}, but at most {most} are allowed")
        self.places.counts[key] = count

    def _counts_first(self) -> None:
        """Read the point counts of a static layout, where they may be stored after the points."""
        # a walk with the maximum sizes, which a static layout reserves, finds where the counts are
        start = replace(self, holds=lambda *_: True, spaces_only=True, places=PartOffsets(), count_offsets={})
        for component in self.layout.components:
            start._place(component)
        for key, offset in start.count_offsets.items():
            component = start.places.components[key]
            self._count(f"{_COUNTS[component.kind]}_{component.direction}", self.count_at(component, offset))

    def _place(self, component: Component) -> set[str]:
        """Place one part; return the keys of what was placed."""
        alternating = self._alternating(component)
        if alternating:
            self._interleave(*alternating)
            return {component.key for component in alternating}
        self.at = self._aligned(self.at, component)
        self.places.components[component.key] = component
        if component.kind in _COUNTS:
            self._stored_count(component)
        elif component.kind == "FNC_VALUES":
            numbers, rooms = self._shape()
            # STATIC_RECORD_LAYOUT spreads the values by the maximum sizes, STATIC_ADDRESS_OFFSETS only keeps that room
            spread = rooms if self.layout.static_layout else numbers
            self._keep(component, numbers, _strides(spread, SIZES[component.data_type], component.mode), prod(rooms))
        elif component.kind == "AXIS_PTS":
            number, most = self._number(component.direction)
            self._keep(component, (number,), (SIZES[component.data_type],), most)
        elif component.kind == "AXIS_RESCALE":
            self._pairs(component)
        else:
            self._single(component)
        # reserved parts have no key, so each of them takes its room
        return {component.key} if component.kind not in ("RESERVED", "IDENTIFICATION") else set()

    def _single(self, component: Component) -> None:
        size = SIZES[component.data_type]
        self._span(component, self.at, size)
        self.places.offsets[component.key] = np.array(self.at)
        self.at += size

    def _stored_count(self, component: Component) -> None:
        offset, key = self.at, f"{_COUNTS[component.kind]}_{component.direction}"
        self._single(component)
        if self.spaces_only:
            self.count_offsets[component.key] = offset
        elif key not in self.places.counts:
            self._count(key, self.count_at(component, offset))

    def _number(self, direction: str) -> tuple[int, int]:
        """Return the number of points of a direction, and its maximum."""
        key = f"AXIS_PTS_{direction}"
        most = self.request.most.get(direction)
        if most is None:
            raise A2lError(f"has the record layout {self.layout.name} with {key}, but no such axis")
        if self.spaces_only:
            return most, most
        stored = any(component.key == f"NO_{key}" for component in self.layout.components)
        # in other layouts, the place of the count depends on the count
        if key not in self.places.counts and stored:
            name = self.layout.name
            raise A2lError(f"has the record layout {name}, which stores the number of points after the points")
        return self.places.counts.setdefault(key, most), most

    def _pairs(self, component: Component) -> None:
        number = self.places.counts.setdefault(component.key, component.pairs)
        if number < 1:
            raise A2lError(f"has {number} rescale pairs")
        size = SIZES[component.data_type]
        # input and position of each pair follow each other
        self._keep(component, (number, 2), (2 * size, size), 2 * max(number, component.pairs))

    def _shape(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        if not self.request.most:
            return self.request.sizes, self.request.sizes
        both = [self._number(direction) for direction in self.request.most]
        return tuple(number for number, _ in both), tuple(most for _, most in both)

    def _is_static(self) -> bool:
        return self.layout.static_layout or self.layout.static_offsets

    def _alternating(self, component: Component) -> tuple[Component, Component] | None:
        """Return the axis and the values that lie together, if this is one of them."""
        by_key = {component.key: component for component in self.layout.components}
        values = by_key.get("FNC_VALUES")
        direction = _ALTERNATING.get(values.mode, "") if values else ""
        axis = by_key.get(f"AXIS_PTS_{direction}")
        if values is None or not direction or component not in (values, axis):
            return None
        if axis is None or direction not in self.request.most or self._is_static():
            raise A2lError(f"has the record layout {self.layout.name} with {values.mode}, which is not supported here")
        return axis, values

    def _interleave(self, axis: Component, values: Component) -> None:
        """Place a point, then the values that belong to it, or the other way round, by their positions."""
        numbers, _ = self._shape()
        along = list(self.request.most).index(axis.direction)
        if len(numbers) > 2:
            raise A2lError(f"has the record layout {self.layout.name}: {values.mode} in a cube")
        # values that belong to one point of the axis
        others = prod(numbers) // numbers[along]
        value_size = SIZES[values.data_type]
        # before arrays of this size are made: a damaged count may be any number
        if prod(numbers) > 2**32 or not self.holds(self.address, prod(numbers) * value_size):
            raise AbsentError
        sizes = {axis.key: SIZES[axis.data_type], values.key: value_size * others}
        starts: dict[str, list[int]] = {axis.key: [], values.key: []}
        for _ in range(numbers[along]):
            for component in sorted((axis, values), key=lambda component: component.position):
                self.at = self._aligned(self.at, component)
                starts[component.key].append(self.at)
                self.at += sizes[component.key]
        points = np.array(starts[axis.key])
        if not points.size:
            raise AbsentError
        self._span(values, int(points[0]), self.at - int(points[0]))
        # Int[points, others], one row for each point of the axis; transposed if the axis is y, so that x comes first
        grid = np.array(starts[values.key])[:, None] + value_size * np.arange(others)
        grid = grid.reshape(numbers) if along == 0 else grid.T.reshape(numbers)
        self.places.components |= {axis.key: axis, values.key: values}
        self.places.offsets |= {axis.key: points, values.key: grid}

    def _keep(self, component: Component, numbers: Sequence[int], strides: Sequence[int], room: int) -> None:
        """Keep the offsets of an array; a static layout reserves `room` numbers for it."""
        size, start = SIZES[component.data_type], self.at
        self.at += size * (room if self._is_static() else prod(numbers))
        if self.spaces_only:
            return
        if any(number < 1 for number in numbers):
            raise A2lError(f"has {' x '.join(map(str, numbers))} values")
        last = sum((number - 1) * stride for number, stride in zip(numbers, strides, strict=True))
        self._span(component, start, last + size)
        offsets = np.array(start)
        # offset = start + the sum of index * stride over the directions
        for number, stride in zip(numbers, strides, strict=True):
            offsets = offsets[..., None] + stride * np.arange(number)
        self.places.offsets[component.key] = offsets

    def _span(self, component: Component, start: int, size: int) -> None:
        if component.kind not in ("RESERVED", "IDENTIFICATION") and not self.holds(self.address + start, size):
            raise AbsentError

    def _aligned(self, at: int, component: Component) -> int:
        # an object begins at its address, whatever its alignment
        if at == 0:
            return 0
        border = alignment_of(component.data_type, self.layout.alignments, self.alignments)
        return -(-(self.address + at) // border) * border - self.address


def _strides(numbers: Sequence[int], size: int, mode: str) -> list[int]:
    """Return the distance in bytes between neighbouring values, by direction."""
    order = list(range(len(numbers)))
    # x and y change places; layers follow each other in both modes
    if mode == _COLUMNS and len(numbers) > 1:
        order[:2] = [1, 0]
    elif mode not in (_ROWS, _COLUMNS) and len(numbers) > 1:
        raise A2lError(f"has the unknown index mode {mode[:40]!r}")
    strides, step = [0] * len(numbers), size
    for direction in order:
        strides[direction] = step
        step *= numbers[direction]
    return strides

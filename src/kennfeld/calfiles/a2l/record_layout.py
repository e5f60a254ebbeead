"""Byte offsets of the parts of an object, by its record layout.

The parts follow each other in the order of their positions, each aligned to a multiple of its alignment. Values of
a map are stored by rows (ROW_DIR, x fastest) or columns (COLUMN_DIR, y fastest), layers of a cube one after the
other, or interleaved with the points of an axis (ALTERNATE_WITH_X, ALTERNATE_WITH_Y). A value block is stored like a
table with the sizes of MATRIX_DIM. Unless the layout is static, parts directly follow tables that use fewer points
than their maximum.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import prod

import numpy as np

from kennfeld.arrays import Int
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
    size: int = 0


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
    wanted: LayoutRequest,
    alignments: Mapping[str, int],
    count_at: Callable[[Component, int], int],
    holds: Callable[[int, int], bool],
) -> PartOffsets:
    """Compute the byte offsets of all parts of an object.

    Args:
        layout: The record layout.
        address: The address of the object, which alignment refers to.
        wanted: The axes and sizes of the object.
        alignments: Defaults of the module, in bytes by data type.
        count_at: Returns the number of points stored at a byte offset of a component.
        holds: Returns True if the image has a number of bytes at an address.

    Returns:
        Offsets relative to `address`, in bytes.

    Raises:
        A2lError: The layout is not supported.
        AbsentError: The memory is not in the image.
    """
    _check_layout(layout, wanted)
    return _Walk(layout, address, wanted, alignments, count_at, holds).run()


def _check_layout(layout: RecordLayout, wanted: LayoutRequest) -> None:
    name = layout.name
    if layout.unknown:
        raise A2lError(f"has the record layout {name} with the unknown keyword {layout.unknown[0]!r}")
    keys = [component.key for component in layout.components if component.kind not in ("RESERVED", "IDENTIFICATION")]
    twice = next((key for key in keys if keys.count(key) > 1), "")
    if twice:
        raise A2lError(f"has the record layout {name} with two {twice}")
    if wanted.values and "FNC_VALUES" not in keys:
        raise A2lError(f"has the record layout {name}, which has no FNC_VALUES")
    for component in layout.components:
        if component.data_type not in (SIZES if component.kind == "RESERVED" else NUMBERS):
            raise A2lError(f"has the record layout {name} with the data type {component.data_type[:40]!r}")
        if component.addressing != "DIRECT":
            raise A2lError(f"has the record layout {name}, whose {component.key} is a pointer")
        if component.mode == "ALTERNATE_CURVES":
            message = f"has the record layout {name}: ALTERNATE_CURVES does not state how many curves share the memory"
            raise A2lError(message)


@dataclass
class _Walk:
    layout: RecordLayout
    address: int
    wanted: LayoutRequest
    alignments: Mapping[str, int]
    count_at: Callable[[Component, int], int]
    holds: Callable[[int, int], bool]
    spaces_only: bool = False  # look for the room of each part alone
    places: PartOffsets = field(default_factory=PartOffsets)
    found: dict[str, int] = field(default_factory=dict)  # offsets of stored numbers of points
    at: int = 0

    def run(self) -> PartOffsets:
        self._fixed_counts()
        if self.layout.static_layout or self.layout.static_offsets:
            self._counts_first()
        done: set[str] = set()
        for component in self.layout.components:
            if component.key not in done:
                done |= self._place(component)
        self.places.size = self.at
        return self.places

    def _fixed_counts(self) -> None:
        for direction, count in self.layout.fixed_counts.items():
            if direction in self.wanted.most:
                self._count(f"AXIS_PTS_{direction}", count)

    def _count(self, key: str, count: int) -> None:
        """Keep a number of points, of the points named by `key`."""
        direction = key[-1]
        most = self.wanted.most.get(direction)
        if count < 1 or (most is not None and count > most and not key.startswith("AXIS_RESCALE")):
            raise A2lError(f"states {count} axis points in direction {direction}, but at most {most} are allowed")
        self.places.counts[key] = count

    def _counts_first(self) -> None:
        """Read the point counts of a static layout, where they may be stored after the points."""
        start = replace(self, holds=lambda *_: True, spaces_only=True, places=PartOffsets(), found={})
        for component in self.layout.components:
            start._place(component)
        for key, offset in start.found.items():
            component = start.places.components[key]
            self._count(f"{_COUNTS[component.kind]}_{component.direction}", self.count_at(component, offset))

    def _place(self, component: Component) -> set[str]:
        """Place one part; gives the keys of what was placed."""
        key = component.key
        alternating = self._alternating(component)
        if alternating:
            self._interleaved(*alternating)
            return {one.key for one in alternating}
        self.at = self._aligned(self.at, component)
        self.places.components[key] = component
        if component.kind in _COUNTS:
            self._stored_count(component)
        elif component.kind == "FNC_VALUES":
            self._values(component)
        elif component.kind == "AXIS_PTS":
            self._points(component)
        elif component.kind == "AXIS_RESCALE":
            self._pairs(component)
        else:
            self._span(component, self.at, SIZES[component.data_type])
            self.places.offsets[key] = np.array(self.at)
            self.at += SIZES[component.data_type]
        return {key} if component.kind not in ("RESERVED", "IDENTIFICATION") else set()

    def _stored_count(self, component: Component) -> None:
        size = SIZES[component.data_type]
        self._span(component, self.at, size)
        self.places.offsets[component.key] = np.array(self.at)
        key = f"{_COUNTS[component.kind]}_{component.direction}"
        if self.spaces_only:
            self.found[component.key] = self.at
        elif key not in self.places.counts:
            self._count(key, self.count_at(component, self.at))
        self.at += size

    def _number(self, direction: str) -> tuple[int, int]:
        """Return the number of points of a direction, and its maximum."""
        key = f"AXIS_PTS_{direction}"
        most = self.wanted.most.get(direction)
        if most is None:
            raise A2lError(f"has the record layout {self.layout.name} with {key}, but no such axis")
        if key not in self.places.counts and self._counted_later(key):
            raise A2lError(
                f"has the record layout {self.layout.name}, which stores the number of points after the points"
            )
        number = self.places.counts.setdefault(key, most) if not self.spaces_only else most
        return number, most

    def _counted_later(self, key: str) -> bool:
        stored = any(f"NO_{key}" == component.key for component in self.layout.components)
        return stored and not self.spaces_only

    def _points(self, component: Component) -> None:
        number, most = self._number(component.direction)
        size = SIZES[component.data_type]
        room = most if self._is_static() else number
        self._keep(component, self.at, (number,), (size,))
        self.at += room * size

    def _pairs(self, component: Component) -> None:
        number = self.places.counts.setdefault(component.key, component.pairs)
        if number < 1:
            raise A2lError(f"has {number} rescale pairs")
        size = SIZES[component.data_type]
        self._keep(component, self.at, (number, 2), (2 * size, size))
        self.at += 2 * size * (max(number, component.pairs) if self._is_static() else number)

    def _values(self, component: Component) -> None:
        size = SIZES[component.data_type]
        numbers, rooms = self._shape()
        spread = rooms if self.layout.static_layout else numbers
        strides = _strides(spread, size, component.mode)
        self._keep(component, self.at, numbers, strides)
        self.at += size * prod(rooms if self._is_static() else numbers)

    def _shape(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        if not self.wanted.most:
            return self.wanted.sizes, self.wanted.sizes
        both = [self._number(direction) for direction in self.wanted.most]
        return tuple(number for number, _ in both), tuple(most for _, most in both)

    def _is_static(self) -> bool:
        return self.layout.static_layout or self.layout.static_offsets

    def _alternating(self, component: Component) -> tuple[Component, Component] | None:
        """Return the axis and the values that lie together, where this is one of them."""
        values = next((one for one in self.layout.components if one.kind == "FNC_VALUES"), None)
        direction = _ALTERNATING.get(values.mode, "") if values else ""
        axis = next((one for one in self.layout.components if one.key == f"AXIS_PTS_{direction}"), None)
        if values is None or not direction or component not in (values, axis):
            return None
        if axis is None or direction not in self.wanted.most or self._is_static():
            raise A2lError(f"has the record layout {self.layout.name} with {values.mode}, which is not supported here")
        return axis, values

    def _interleaved(self, axis: Component, values: Component) -> None:
        """Return a point, then the values that belong to it, or the other way round, by their positions."""
        numbers, _ = self._shape()
        along = list(self.wanted.most).index(axis.direction)
        if len(numbers) > 2:
            raise A2lError(f"has the record layout {self.layout.name}: {values.mode} in a cube")
        others = prod(numbers) // numbers[along]
        point, value = SIZES[axis.data_type], SIZES[values.data_type]
        if prod(numbers) > 2**32:
            raise AbsentError
        points: list[int] = []
        firsts: list[int] = []
        for _ in range(numbers[along] if self.holds(self.address, prod(numbers) * value) else 0):
            for component in sorted((axis, values), key=lambda one: one.position):
                self.at = self._aligned(self.at, component)
                (points if component is axis else firsts).append(self.at)
                self.at += point if component is axis else value * others
        if not points:
            raise AbsentError
        self._span(values, points[0], self.at - points[0])
        grid = np.array(firsts)[:, None] + value * np.arange(others)
        grid = grid.reshape(numbers) if along == 0 else grid.T.reshape(numbers)
        for component, offsets in ((axis, np.array(points)), (values, grid)):
            self.places.components[component.key] = component
            self.places.offsets[component.key] = offsets

    def _keep(self, component: Component, start: int, numbers: Sequence[int], strides: Sequence[int]) -> None:
        last = sum((number - 1) * stride for number, stride in zip(numbers, strides, strict=True))
        if self.spaces_only:
            return
        if any(number < 1 for number in numbers):
            raise A2lError(f"has {' x '.join(map(str, numbers))} values")
        self._span(component, start, last + SIZES[component.data_type])
        offsets = np.array(start)
        for number, stride in zip(numbers, strides, strict=True):
            offsets = offsets[..., None] + stride * np.arange(number)
        self.places.offsets[component.key] = offsets

    def _span(self, component: Component, start: int, size: int) -> None:
        if component.kind not in ("RESERVED", "IDENTIFICATION") and not self.holds(self.address + start, size):
            raise AbsentError

    def _aligned(self, at: int, component: Component) -> int:
        if at == 0:
            return 0
        border = alignment_of(component.data_type, self.layout.alignments, self.alignments)
        return -(-(self.address + at) // border) * border - self.address


def _strides(numbers: Sequence[int], size: int, mode: str) -> list[int]:
    """Return the distance in bytes between neighbouring values, by direction."""
    order = list(range(len(numbers)))
    if mode == _COLUMNS and len(numbers) > 1:
        order[:2] = [1, 0]
    elif mode not in (_ROWS, _COLUMNS) and len(numbers) > 1:
        raise A2lError(f"has the unknown index mode {mode[:40]!r}")
    strides, step = [0] * len(numbers), size
    for direction in order:
        strides[direction] = step
        step *= numbers[direction]
    return strides

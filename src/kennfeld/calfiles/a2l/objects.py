"""The objects of an A2L file, with the names of ASAM MCD-2 MC (ASAP2), and a summary of its labels."""

from collections.abc import Mapping
from dataclasses import field
from math import inf

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import drop_trailing_ones

DIRECTIONS = ("X", "Y", "Z", "4", "5")  # as keywords of record layouts name the axes

_KINDS = {"VALUE": "scalar", "CURVE": "curve", "MAP": "map", "CUBOID": "cube", "CUBE_4": "cube", "CUBE_5": "cube"}
_KINDS |= {"VAL_BLK": "block", "ASCII": "text"}


@dataclass(frozen=True, kw_only=True)
class StoredNumbers:
    """Numbers in the memory: conversion, limits and storage."""

    conversion: str
    lower: float = -inf
    upper: float = inf
    byte_order: str = ""
    deposit: str = ""
    phys_unit: str = ""
    display_identifier: str = ""
    extended_limits: tuple[float, float] | None = None
    read_only: bool = False


@dataclass(frozen=True, kw_only=True)
class AxisDescr(StoredNumbers):
    """One axis of a characteristic. Points of a fixed axis are raw numbers: the control unit counts in them."""

    attribute: str  # STD_AXIS, COM_AXIS, FIX_AXIS, RES_AXIS or CURVE_AXIS
    input_quantity: str
    max_axis_points: int
    axis_pts_ref: str = ""
    curve_axis_ref: str = ""
    fixed_spacing: tuple[float, float, int] | None = None  # FIX_AXIS_PAR(_DIST): offset, distance, number
    fixed_points: tuple[float, ...] = ()  # FIX_AXIS_PAR_LIST


@dataclass(frozen=True, kw_only=True)
class StoredLabel(StoredNumbers):
    """Numbers with a name and an address."""

    name: str
    description: str
    address: int
    record_layout: str
    functions: tuple[str, ...] = ()
    line: int = 0


@dataclass(frozen=True, kw_only=True)
class AxisPts(StoredLabel):
    """Breakpoints in the memory that several tables share."""

    input_quantity: str
    max_axis_points: int


@dataclass(frozen=True, kw_only=True)
class Characteristic(StoredLabel):
    """A scalar, block, text, curve, map or cube in the memory."""

    type: str  # VALUE, CURVE, MAP, CUBOID, CUBE_4, CUBE_5, VAL_BLK or ASCII
    axes: tuple[AxisDescr, ...] = ()
    number: int = 0
    matrix_dim: tuple[int, ...] = ()
    bit_mask: int | None = None
    encoding: str = ""
    dependent_on: tuple[str, ...] = ()  # labels by whose values a formula gives this one
    virtual: bool = False  # without a place in the memory

    @property
    def shape(self) -> tuple[int, ...]:
        """The maximum number of values per axis, x first."""
        if self.axes:
            return tuple(axis.max_axis_points for axis in self.axes)
        return drop_trailing_ones(self.matrix_dim) or ((self.number,) if self.number else ())


@dataclass(frozen=True)
class CompuMethod:
    """A conversion between raw and physical values."""

    name: str
    kind: str  # IDENTICAL, LINEAR, RAT_FUNC, TAB_INTP, TAB_NOINTP, TAB_VERB or FORM
    unit: str = ""
    coeffs: tuple[float, ...] = ()  # six of RAT_FUNC, two of LINEAR
    table: str = ""  # COMPU_TAB_REF
    formula: str = ""
    formula_inverse: str = ""


@dataclass(frozen=True)
class CompuTab:
    """Pairs of a raw and a physical number."""

    name: str
    raw: tuple[float, ...]
    physical: tuple[float, ...]
    default: float | None = None


@dataclass(frozen=True)
class CompuVtab:
    """Words for raw numbers, each from a least to a largest one."""

    name: str
    ranges: tuple[tuple[float, float, str], ...]
    default: str | None = None


@dataclass(frozen=True)
class Component:
    """One entry of a record layout, such as AXIS_PTS_X: its `kind` is AXIS_PTS, its `direction` X."""

    kind: str
    direction: str
    position: int
    data_type: str
    mode: str = ""  # index mode of the values, index order of axis points
    addressing: str = "DIRECT"
    pairs: int = 0  # most pairs of AXIS_RESCALE

    @property
    def key(self) -> str:
        return f"{self.kind}_{self.direction}" if self.direction else self.kind


@dataclass(frozen=True)
class RecordLayout:
    """The order in which the parts of an object are stored."""

    name: str
    components: tuple[Component, ...]  # in the order of their positions
    fixed_counts: Mapping[str, int] = field(default_factory=dict)  # FIX_NO_AXIS_PTS by direction
    alignments: Mapping[str, int] = field(default_factory=dict)
    static_layout: bool = False
    static_offsets: bool = False
    unknown: tuple[str, ...] = ()  # keywords that no version has


@dataclass(frozen=True)
class A2lFunction:
    """A function, and the labels that it defines."""

    name: str
    description: str
    labels: tuple[str, ...] = ()


@dataclass(frozen=True)
class ModCommon:
    """Defaults of a module, used unless an object states otherwise."""

    byte_order: str = ""
    deposit: str = ""
    alignments: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class A2l:
    """A description of a control unit, as far as calibration goes; everything by its name."""

    file: str
    version: str = ""
    project: str = ""
    module: str = ""
    common: ModCommon = field(default_factory=ModCommon)
    characteristics: Mapping[str, Characteristic] = field(default_factory=dict)
    axis_pts: Mapping[str, AxisPts] = field(default_factory=dict)
    compu_methods: Mapping[str, CompuMethod] = field(default_factory=dict)
    compu_tabs: Mapping[str, CompuTab] = field(default_factory=dict)
    compu_vtabs: Mapping[str, CompuVtab] = field(default_factory=dict)
    record_layouts: Mapping[str, RecordLayout] = field(default_factory=dict)
    functions: Mapping[str, A2lFunction] = field(default_factory=dict)
    measurements: int = 0
    variant_coded: frozenset[str] = frozenset()  # labels with a place in the memory for each variant
    epk: str = ""  # identifier of the program that this describes
    epk_addresses: tuple[int, ...] = ()


@dataclass(frozen=True)
class Described:
    """One label: what it is, how large at most (x first), and where it lies."""

    name: str
    kind: str  # scalar, block, curve, map, cube, text or group axis
    shape: tuple[int, ...]
    unit: str
    lower: float
    upper: float
    address: int
    functions: tuple[str, ...]
    description: str
    read_only: bool


def summarise_labels(a2l: A2l) -> tuple[Described, ...]:
    """Return every characteristic and every group axis of an A2L file."""
    sources: tuple[AxisPts | Characteristic, ...] = (*a2l.characteristics.values(), *a2l.axis_pts.values())
    return tuple(_describe(a2l, source) for source in sources)


def _describe(a2l: A2l, source: AxisPts | Characteristic) -> Described:
    method = a2l.compu_methods.get(source.conversion)
    is_text = method is not None and method.table in a2l.compu_vtabs
    if isinstance(source, AxisPts):
        kind = "group axis"
    else:
        kind = "text" if is_text and source.type == "VALUE" else _KINDS[source.type]
    return Described(
        source.name,
        kind,
        (source.max_axis_points,) if isinstance(source, AxisPts) else source.shape,
        source.phys_unit or (method.unit if method else ""),
        open_limit(source.lower),
        open_limit(source.upper),
        source.address,
        source.functions,
        source.description,
        source.read_only,
    )


def open_limit(value: float) -> float:
    """Return a limit, infinite if it is the range of a floating-point type."""
    return value if abs(value) < 1e300 else (inf if value > 0 else -inf)

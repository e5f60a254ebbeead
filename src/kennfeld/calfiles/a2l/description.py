"""What an A2L file says about its labels, without an image."""

from dataclasses import dataclass
from math import inf

from kennfeld.calfiles.a2l.objects import A2l, AxisPts, Characteristic

__all__ = ["Described", "described"]

_KINDS = {
    "VALUE": "scalar",
    "CURVE": "curve",
    "MAP": "map",
    "CUBOID": "cube",
    "CUBE_4": "cube",
    "CUBE_5": "cube",
    "VAL_BLK": "block",
    "ASCII": "text",
}


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


def described(a2l: A2l) -> tuple[Described, ...]:
    """Every characteristic and every group axis of an A2L file."""
    found = [_described(a2l, one) for one in a2l.characteristics.values()]
    return (*found, *(_described(a2l, axis) for axis in a2l.axis_pts.values()))


def _described(a2l: A2l, source: AxisPts | Characteristic) -> Described:
    shape = (source.max_axis_points,) if isinstance(source, AxisPts) else source.shape
    return Described(
        source.name,
        "group axis" if isinstance(source, AxisPts) else _kind(a2l, source),
        shape,
        _unit(a2l, source),
        _limit(source.lower),
        _limit(source.upper),
        source.address,
        source.functions,
        source.description,
        source.read_only,
    )


def _kind(a2l: A2l, source: Characteristic) -> str:
    method = a2l.compu_methods.get(source.conversion)
    worded = method is not None and method.table in a2l.compu_vtabs
    return "text" if worded and source.type == "VALUE" else _KINDS[source.type]


def _unit(a2l: A2l, source: AxisPts | Characteristic) -> str:
    method = a2l.compu_methods.get(source.conversion)
    return source.phys_unit or (method.unit if method else "")


def _limit(value: float) -> float:
    """A limit, infinite where it is that of a data type that knows no other."""
    return value if abs(value) < 1e300 else (inf if value > 0 else -inf)

"""Rotations and flight parameters of the Aerospace Blockset: quaternions, direction cosine matrices, rotation angles.

Quaternions have their scalar part first; a direction cosine matrix transforms a vector into the rotated axes. Formulas
as in the reference pages of the blocks and in Stevens and Lewis, Aircraft Control and Simulation, 1992, section 1.3.
"""

from collections.abc import Sequence
from typing import TypeAlias

from kennfeld.importers.simulink.lowering import BlockContext, UnsupportedError, block
from kennfeld.importers.simulink.signals import Signal, SignalOrBus, apply, clip, period_of, select

Scalars: TypeAlias = list[Signal]  # one signal for each element
Matrix: TypeAlias = list[list[Signal]]  # rows of 3

_AXES = {"X": 0, "Y": 1, "Z": 2}


def _vector(block: BlockContext, index: int, size: int) -> Scalars:
    """Return the elements of an input."""
    u = block.input(index)
    if u.size != size:
        raise UnsupportedError(f"its input {index + 1} must have {size} elements, got {u.size}")
    return u.elements


def _matrix(block: BlockContext, index: int = 0) -> Matrix:
    """Return the rows of an input of 3 x 3 elements."""
    u = block.input(index)
    if u.shape != (3, 3):
        raise UnsupportedError(f"its input {index + 1} must be a matrix of 3 x 3 elements")
    return [[block.signal([int(node)], u.period) for node in row] for row in u.matrix]


def _joined(block: BlockContext, parts: Sequence[Signal], shape: tuple[int, ...] | None = None) -> Signal:
    return block.signal([part.flat[0] for part in parts], period_of(parts), shape)


def _of_rows(block: BlockContext, rows: Matrix) -> Signal:
    return _joined(block, [rows[i][j] for j in range(3) for i in range(3)], (3, 3))


def _total(block: BlockContext, parts: Sequence[Signal]) -> Signal:
    return block.reduce("add", parts)


def _norm(block: BlockContext, x: Scalars) -> Signal:
    """Return the sum of the squares, which Simulink calls the norm of a quaternion."""
    return _total(block, [part * part for part in x])


def _unit(block: BlockContext, q: Scalars) -> Scalars:
    modulus = apply("sqrt", _norm(block, q))
    return [part / modulus for part in q]


def _conjugate(q: Scalars) -> Scalars:
    return [q[0], -q[1], -q[2], -q[3]]


def hamilton_product(block: BlockContext, q: Scalars, r: Scalars) -> Scalars:
    """Compute q r."""
    terms = (
        (q[0] * r[0], -(q[1] * r[1]), -(q[2] * r[2]), -(q[3] * r[3])),
        (q[0] * r[1], q[1] * r[0], q[2] * r[3], -(q[3] * r[2])),
        (q[0] * r[2], -(q[1] * r[3]), q[2] * r[0], q[3] * r[1]),
        (q[0] * r[3], q[1] * r[2], -(q[2] * r[1]), q[3] * r[0]),
    )
    return [_total(block, each) for each in terms]


@block("aerolibutil/Quaternion Multiplication", "sharedutil/Quaternion Multiplication", linked=True)
def quaternion_product(block: BlockContext) -> SignalOrBus:
    """Compute the product q r of two quaternions."""
    return _joined(block, hamilton_product(block, _vector(block, 0, 4), _vector(block, 1, 4)))


@block("aerolibutil/Quaternion Division", "sharedutil/Quaternion Division", linked=True)
def quaternion_quotient(block: BlockContext) -> SignalOrBus:
    """Compute r^-1 q, which Simulink calls q / r."""
    q, r = _vector(block, 0, 4), _vector(block, 1, 4)
    norm = _norm(block, r)
    return _joined(block, [part / norm for part in hamilton_product(block, _conjugate(r), q)])


@block("aerolibutil/Quaternion Conjugate", "sharedutil/Quaternion Conjugate", linked=True)
def quaternion_conjugate(block: BlockContext) -> SignalOrBus:
    """Negate the vector part."""
    return _joined(block, _conjugate(_vector(block, 0, 4)))


@block("aerolibutil/Quaternion Inverse", "sharedutil/Quaternion Inverse", linked=True)
def quaternion_inverse(block: BlockContext) -> SignalOrBus:
    """Divide the conjugate by the norm."""
    q = _vector(block, 0, 4)
    norm = _norm(block, q)
    return _joined(block, [part / norm for part in _conjugate(q)])


@block("aerolibutil/Quaternion Norm", "sharedutil/Quaternion Norm", linked=True)
def quaternion_norm(block: BlockContext) -> SignalOrBus:
    """Return the sum of the squares of the elements."""
    return _norm(block, _vector(block, 0, 4))


@block("aerolibutil/Quaternion Modulus", "sharedutil/Quaternion Modulus", linked=True)
def quaternion_modulus(block: BlockContext) -> SignalOrBus:
    """Return the square root of the norm."""
    return apply("sqrt", _norm(block, _vector(block, 0, 4)))


@block("aerolibutil/Quaternion Normalize", "sharedutil/Quaternion Normalize", linked=True)
def unit_quaternion(block: BlockContext) -> SignalOrBus:
    """Divide by the modulus."""
    return _joined(block, _unit(block, _vector(block, 0, 4)))


@block("aerolibutil/Quaternion Rotation", "sharedutil/Quaternion Rotation", linked=True)
def quaternion_rotation(block: BlockContext) -> SignalOrBus:
    """Transform a vector by the direction cosine matrix of a quaternion."""
    rows, v = _cosines(_unit(block, _vector(block, 0, 4))), _vector(block, 1, 3)
    return _joined(block, [_total(block, [a * b for a, b in zip(row, v, strict=True)]) for row in rows])


def _cosines(q: Scalars) -> Matrix:
    """Return the direction cosine matrix of a unit quaternion."""
    squares = [part * part for part in q]
    return [
        [
            squares[0] + squares[1] - squares[2] - squares[3],
            2.0 * (q[1] * q[2] + q[0] * q[3]),
            2.0 * (q[1] * q[3] - q[0] * q[2]),
        ],
        [
            2.0 * (q[1] * q[2] - q[0] * q[3]),
            squares[0] - squares[1] + squares[2] - squares[3],
            2.0 * (q[2] * q[3] + q[0] * q[1]),
        ],
        [
            2.0 * (q[1] * q[3] + q[0] * q[2]),
            2.0 * (q[2] * q[3] - q[0] * q[1]),
            squares[0] - squares[1] - squares[2] + squares[3],
        ],
    ]


@block("sharedtransform/Quaternions to Direction Cosine Matrix", linked=True)
def quaternion_to_cosines(block: BlockContext) -> SignalOrBus:
    """Return the direction cosine matrix of a quaternion."""
    return _of_rows(block, _cosines(_unit(block, _vector(block, 0, 4))))


def _order(block: BlockContext) -> str:
    """Return the axes of the three rotations."""
    order = block.field_text("rotationOrder").strip().upper()
    if len(order) != 3 or not set(order) <= set(_AXES) or order[0] == order[1] or order[1] == order[2]:
        raise UnsupportedError(f"its rotation order {order[:20]!r} is not supported")
    return order


@block("Angle2Dcm", "sharedtransform/Rotation Angles to Direction Cosine Matrix", rotationOrder="ZYX")
def angles_to_cosines(block: BlockContext) -> SignalOrBus:
    """Multiply the matrices of three rotations about axes, the first one on the right."""
    rows: Matrix = [[block.constant(float(i == j)) for j in range(3)] for i in range(3)]
    for axis, angle in zip(_order(block), _vector(block, 0, 3), strict=True):
        cosine, sine = apply("cos", angle), apply("sin", angle)
        # a rotation about one axis mixes the two others, in cyclic order
        i, j = (_AXES[axis] + 1) % 3, (_AXES[axis] + 2) % 3
        rows[i], rows[j] = (
            [cosine * a + sine * b for a, b in zip(rows[i], rows[j], strict=True)],
            [cosine * b - sine * a for a, b in zip(rows[i], rows[j], strict=True)],
        )
    return _of_rows(block, rows)


@block("sharedtransform/Rotation Angles to Quaternions", linked=True, rotationOrder="ZYX")
def angles_to_quaternion(block: BlockContext) -> SignalOrBus:
    """Multiply the quaternions of three rotations about axes."""
    q: Scalars = [block.constant(value) for value in (1.0, 0.0, 0.0, 0.0)]
    for axis, angle in zip(_order(block), _vector(block, 0, 3), strict=True):
        turn: Scalars = [apply("cos", 0.5 * angle), *(block.constant(0.0) for _ in range(3))]
        turn[1 + _AXES[axis]] = apply("sin", 0.5 * angle)
        q = hamilton_product(block, q, turn)
    return _joined(block, q)


def _angles(block: BlockContext, rows: Matrix) -> SignalOrBus:
    """Return the angles of rotations about the axes Z, Y and X."""
    if _order(block) != "ZYX":
        raise UnsupportedError(f"its rotation order {_order(block)} is not supported, only ZYX")
    # rounding may carry the cosine of a right angle beyond 1
    tilt = clip(-rows[0][2], block.constant(-1.0), block.constant(1.0))
    yaw, roll = apply("atan2", rows[0][1], rows[0][0]), apply("atan2", rows[1][2], rows[2][2])
    return _joined(block, [yaw, apply("asin", tilt), roll])


@block("sharedtransform/Quaternions to Rotation Angles", linked=True, rotationOrder="ZYX")
def quaternion_to_angles(block: BlockContext) -> SignalOrBus:
    """Return the rotation angles of a quaternion."""
    return _angles(block, _cosines(_unit(block, _vector(block, 0, 4))))


@block("sharedtransform/Direction Cosine Matrix to Rotation Angles", linked=True, rotationOrder="ZYX")
def cosines_to_angles(block: BlockContext) -> SignalOrBus:
    """Return the rotation angles of a direction cosine matrix."""
    return _angles(block, _matrix(block))


@block("sharedtransform/Direction Cosine Matrix to Quaternions", linked=True)
def cosines_to_quaternion(block: BlockContext) -> SignalOrBus:
    """Return the quaternion of a direction cosine matrix, from its trace or its largest diagonal element."""
    d = _matrix(block)
    trace = d[0][0] + d[1][1] + d[2][2]
    differences = [d[1][2] - d[2][1], d[2][0] - d[0][2], d[0][1] - d[1][0]]
    root = apply("sqrt", apply("max", trace + 1.0, 0.0))
    by_trace = [0.5 * root, *(part / (2.0 * root) for part in differences)]
    by_axis = [_about(block, d, differences, axis) for axis in range(3)]
    y_first = (d[1][1] > d[0][0]) & (d[1][1] > d[2][2])
    z_first = d[2][2] > d[0][0]
    return _joined(
        block,
        [
            select(trace > 0.0, first, select(y_first, y, select(z_first, z, x)))
            for first, x, y, z in zip(by_trace, *by_axis, strict=True)
        ],
    )


def _about(block: BlockContext, d: Matrix, differences: Scalars, axis: int) -> Scalars:
    """Return the quaternion whose element of an axis, the largest one, follows from the diagonal."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    root = apply("sqrt", apply("max", d[axis][axis] - d[j][j] - d[k][k] + 1.0, 0.0))
    q: Scalars = [differences[axis] / (2.0 * root)] * 4
    q[1 + axis] = 0.5 * root
    q[1 + j], q[1 + k] = ((d[axis][other] + d[other][axis]) / (2.0 * root) for other in (j, k))
    return q


@block("aerolibtransform2/Direction Cosine Matrix Body to Wind", linked=True)
def body_to_wind(block: BlockContext) -> SignalOrBus:
    """Return the direction cosine matrix of the angles of attack and sideslip, which are one vector or two inputs."""
    if block.input_count == 1:
        attack, slip = _vector(block, 0, 2)
    else:
        (attack,), (slip,) = _vector(block, 0, 1), _vector(block, 1, 1)
    ca, sa, cb, sb = apply("cos", attack), apply("sin", attack), apply("cos", slip), apply("sin", slip)
    return _of_rows(block, [[ca * cb, sb, sa * cb], [-(ca * sb), cb, -(sa * sb)], [-sa, block.constant(0.0), ca]])


@block("aerolibasang/Incidence, Sideslip, & Airspeed", linked=True)
def incidence(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the angle of attack, that of sideslip and the airspeed of a velocity in body axes."""
    u, v, w = _vector(block, 0, 3)
    airspeed = apply("sqrt", _norm(block, [u, v, w]))
    return apply("atan2", w, u), apply("asin", v / airspeed), airspeed


@block("aerolibasang/Dynamic Pressure", linked=True)
def dynamic_pressure(block: BlockContext) -> SignalOrBus:
    """Compute rho V^2 / 2 from a velocity vector and the density."""
    return 0.5 * (_norm(block, _vector(block, 0, 3)) * block.input(1))


@block("aerolibasang/Mach Number", linked=True)
def mach_number(block: BlockContext) -> SignalOrBus:
    """Divide the length of a velocity vector by the speed of sound."""
    return apply("sqrt", _norm(block, _vector(block, 0, 3))) / block.input(1)

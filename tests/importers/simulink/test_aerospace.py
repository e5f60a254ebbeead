"""Rotations and flight parameters of the Aerospace Blockset, against SciPy's rotations and NumPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kennfeld.base.errors import InputError
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import imported, run

RANDOM = np.random.default_rng(11)
COUNT = 12
ANGLES = RANDOM.uniform(-1.4, 1.4, (COUNT, 3))
Q, R = RANDOM.normal(size=(2, COUNT, 4))
V = RANDOM.normal(size=(COUNT, 3))


def unit(q):
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def rotation(q):
    """The rotation of quaternions with their scalar part first."""
    return Rotation.from_quat(np.roll(q, -1, axis=1))


def scalar_first(rotations):
    return np.roll(rotations.as_quat(), 1, axis=1)


def cosines(rotations):
    """Direction cosine matrices, which turn the axes instead of the vector."""
    return np.transpose(rotations.as_matrix(), (0, 2, 1))


def result(tmp_path, source, *columns, kind="", outputs=1, **fields):
    """The outputs of a block for inputs, each Float[samples, ...] in the shape of its signal; elements by columns."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    if kind:
        drawn.block(kind, "B", ports=(len(columns), outputs), **fields)
    else:
        drawn.link("B", source, "", ports=(len(columns), outputs), **fields)
    values = {}
    for at, column in enumerate(columns, 1):
        size = column.shape[1:] or (1,)
        drawn.inport(f"u{at}", PortDimensions=f"[{' '.join(map(str, size))}]")
        drawn.line(f"u{at}", f"B:{at}")
        flat = np.array([np.ravel(sample, order="F") for sample in column])
        parts = flat.shape[1]
        values |= {f"u{at}[{k + 1}]" if parts > 1 else f"u{at}": flat[:, k] for k in range(parts)}
    for at in range(1, outputs + 1):
        drawn.outport(f"y{at}")
        drawn.line(f"B:{at}", f"y{at}")
    model = imported(drawn, tmp_path)
    recorded = run(model, values)
    return np.transpose([recorded[name] for name in model.graph.outputs])


def by_columns(matrices):
    return np.array([np.ravel(matrix, order="F") for matrix in matrices])


def close(actual, expected):
    np.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("order", ["ZYX", "XYZ", "ZXZ", "YZY"])
def test_rotation_angles_give_matrices_and_quaternions(order, tmp_path):
    there = Rotation.from_euler(order, ANGLES)
    kind = {"kind": "Angle2Dcm"} if order == "ZYX" else {"rotationOrder": order}
    source = "sharedtransform/Rotation Angles to Direction Cosine Matrix"
    close(result(tmp_path, source, ANGLES, **kind), by_columns(cosines(there)))
    quaternions = result(tmp_path, "sharedtransform/Rotation Angles to Quaternions", ANGLES, rotationOrder=order)
    close(quaternions * np.sign(quaternions[:, :1]), scalar_first(there) * np.sign(scalar_first(there)[:, :1]))


def test_quaternions_and_matrices_give_rotation_angles(tmp_path):
    there = Rotation.from_euler("ZYX", ANGLES)
    quaternions = 2.5 * scalar_first(there)  # need not be of unit length
    close(result(tmp_path, "sharedtransform/Quaternions to Rotation Angles", quaternions), ANGLES)
    close(result(tmp_path, "sharedtransform/Direction Cosine Matrix to Rotation Angles", cosines(there)), ANGLES)


def test_quaternions_and_matrices_give_each_other(tmp_path):
    matrices = cosines(rotation(Q))
    close(result(tmp_path, "sharedtransform/Quaternions to Direction Cosine Matrix", Q), by_columns(matrices))
    back = result(tmp_path, "sharedtransform/Direction Cosine Matrix to Quaternions", matrices)
    close(back * np.sign(np.sum(back * Q, axis=1, keepdims=True)), unit(Q))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_turns_have_quaternions_by_their_axis(axis, tmp_path):
    matrices = cosines(Rotation.from_rotvec(np.pi * np.eye(3)[[axis] * 2]))
    back = result(tmp_path, "sharedtransform/Direction Cosine Matrix to Quaternions", matrices)
    close(np.abs(back), np.eye(4)[[axis + 1] * 2])


@pytest.mark.parametrize("library", ["aerolibutil", "sharedutil"])
def test_quaternions_are_multiplied_divided_and_inverted(library, tmp_path):
    q, r = rotation(Q), rotation(R)
    lengths = np.linalg.norm(Q, axis=1, keepdims=True), np.linalg.norm(R, axis=1, keepdims=True)

    def same(actual, expected):
        close(actual * np.sign(np.sum(actual * expected, axis=1, keepdims=True)), expected)

    same(result(tmp_path, f"{library}/Quaternion Multiplication", Q, R), lengths[0] * lengths[1] * scalar_first(q * r))
    same(result(tmp_path, f"{library}/Quaternion Division", Q, R), lengths[0] / lengths[1] * scalar_first(r.inv() * q))
    close(result(tmp_path, f"{library}/Quaternion Conjugate", Q), Q * [1, -1, -1, -1])
    close(result(tmp_path, f"{library}/Quaternion Inverse", Q), Q * [1, -1, -1, -1] / lengths[0] ** 2)
    close(result(tmp_path, f"{library}/Quaternion Norm", Q), lengths[0] ** 2)
    close(result(tmp_path, f"{library}/Quaternion Modulus", Q), lengths[0])
    close(result(tmp_path, f"{library}/Quaternion Normalize", Q), unit(Q))
    turned = np.einsum("kij,kj->ki", cosines(q), V)
    close(result(tmp_path, f"{library}/Quaternion Rotation", Q, V), turned)


def test_the_wind_axes_follow_from_attack_and_sideslip(tmp_path):
    attack, slip = ANGLES[:, 0], ANGLES[:, 1]
    # a rotation about y by the angle of attack, the other way round, and one about z by that of sideslip
    there = Rotation.from_euler("YZ", np.transpose([-attack, slip]))
    source = "aerolibtransform2/Direction Cosine Matrix Body to Wind"
    close(result(tmp_path, source, ANGLES[:, :2]), by_columns(cosines(there)))


def test_flight_parameters_follow_from_the_velocity(tmp_path):
    speed, density = np.linalg.norm(V, axis=1), 1.0 + np.arange(COUNT) / 10
    expected = np.transpose([np.arctan2(V[:, 2], V[:, 0]), np.arcsin(V[:, 1] / speed), speed])
    close(result(tmp_path, "aerolibasang/Incidence, Sideslip, & Airspeed", V, outputs=3), expected)
    close(result(tmp_path, "aerolibasang/Dynamic Pressure", V, density)[:, 0], 0.5 * density * speed**2)
    close(result(tmp_path, "aerolibasang/Mach Number", V, 340.0 + density)[:, 0], speed / (340.0 + density))


@pytest.mark.parametrize("source", ["matrix_library/Cross Product", "vrlib/Utilities/Cross Product"])
def test_cross_products_of_other_libraries(source, tmp_path):
    close(result(tmp_path, source, V, ANGLES), np.cross(V, ANGLES))


@pytest.mark.parametrize(
    ("source", "column", "fields", "why"),
    [
        ("sharedtransform/Rotation Angles to Quaternions", ANGLES, {"rotationOrder": "ZZX"}, "rotation order 'ZZX'"),
        ("sharedtransform/Quaternions to Rotation Angles", Q, {"rotationOrder": "XYZ"}, "only ZYX"),
        ("aerolibutil/Quaternion Norm", V, {}, "must have 4 elements, got 3"),
    ],
)
def test_other_orders_and_sizes_are_refused(source, column, fields, why, tmp_path):
    with pytest.raises(InputError, match=why):
        result(tmp_path, source, column, **fields)

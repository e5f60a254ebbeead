import re
from pathlib import Path

import numpy as np
import pytest

from kennfeld import native
from kennfeld.base.errors import ArgumentError
from kennfeld.native.accumulator import Accumulator
from kennfeld.native.addresses import INT64, address, strided
from kennfeld.native.cholesky import Cholesky
from kennfeld.native.samples import Piece, Samples
from tests.native.models import MODELS, case
from tests.native.reference import compiled


def misaligned(count):
    return np.frombuffer(bytes(8 * count + 1), dtype=np.uint8)[1:].view(np.float64)


def test_doubles_in_a_row_have_an_address():
    array = np.zeros(4)
    assert address(array, 4) == array.ctypes.data
    assert address(array[1:]) == array.ctypes.data + 8


@pytest.mark.parametrize(
    ("array", "described"),
    [
        (np.zeros(4, dtype=np.int64), "int64 of shape (4,), contiguous"),
        (np.zeros(4, dtype=np.float32), "float32 of shape (4,), contiguous"),
        (np.zeros(4, dtype=bool), "bool of shape (4,), contiguous"),
        (np.zeros(4, dtype=">f8"), ">f8 in foreign byte order of shape (4,), contiguous"),
        (np.zeros(8)[::2], "float64 of shape (4,), not contiguous"),
        (np.zeros((2, 2), order="F"), "float64 of shape (2, 2), not contiguous"),
        (misaligned(4), "float64 of shape (4,), contiguous, not aligned"),
        (np.zeros(3), "float64 of shape (3,), contiguous"),
    ],
)
def test_arrays_that_compiled_code_would_misread_are_refused(array, described):
    with pytest.raises(ArgumentError) as error:
        address(array, 4)
    assert str(error.value) == f"compiled code needs at least 4 contiguous float64, got {described}"


def test_whole_numbers_are_asked_for_by_their_type():
    assert address(np.arange(3), 3, INT64)
    with pytest.raises(ArgumentError, match="needs an array of contiguous int64, got int32"):
        address(np.zeros(3, dtype=np.int32), kind=INT64)


def test_the_rows_of_a_matrix_may_lie_apart():
    room = np.zeros((3, 8))
    assert strided(room[:, :5], 3) == (room.ctypes.data, 8)


@pytest.mark.parametrize(
    "matrix", [np.zeros((3, 3)).T[::2], np.zeros((4, 4), dtype=int), np.zeros((2, 9)), np.zeros(9)]
)
def test_other_matrices_have_no_rows_to_read(matrix):
    with pytest.raises(ArgumentError, match="needs a matrix of float64, at least 3 x 3, with contiguous rows"):
        strided(matrix, 3)


def test_addresses_are_taken_in_one_place():
    """Except for the alignment of fresh memory, every pointer is one that was checked."""
    folder = Path(native.__file__).parent
    pointers = re.compile(r"ctypes\.data|data_as|ctypeslib|__array_interface__|addressof")
    users = [path.name for path in folder.glob("*.py") if pointers.search(path.read_text("utf-8"))]
    assert users == ["addresses.py"]


def variants(values):
    """The same integers as arrays other than contiguous native doubles."""
    wide = np.repeat(values, 2, axis=-1)
    frozen = values.copy()
    frozen.setflags(write=False)
    return {
        "int64": values.astype(np.int64),
        "int32": values.astype(np.int32),
        "float32": values.astype(np.float32),
        "big-endian": values.astype(">f8"),
        "every other": wide[..., ::2],
        "backwards": values[..., ::-1].copy()[..., ::-1],
        "fortran": np.asfortranarray(values),
        "read-only": frozen,
    }


KINDS = list(variants(np.zeros(2)))


def sums(code, data, targets, scores, values):
    pieces = [Piece(0, data.shape[1], scores)]
    summed = Accumulator(code.kernel, Samples(list(data), list(targets), pieces))
    normal = summed.normal(values)
    return [summed.costs(values), normal.gradient.copy(), normal.matrix.copy()]


@pytest.mark.parametrize("kind", KINDS)
def test_arrays_of_any_type_give_the_sums_of_doubles(kind):
    code = compiled(case(MODELS["static"](), 40))
    data = np.round(10 * np.array([code.case.columns[name] for name in code.kernel.layout.inputs]))
    targets = np.round(10 * np.nan_to_num([c.target for c in code.case.criteria]))
    scores, values = np.full(len(targets), 2.0), np.round(code.values)
    expected = sums(code, data, targets, scores, values)
    arrays = [variants(array)[kind] for array in (data, targets, scores, values)]
    for got, wanted in zip(sums(code, *arrays), expected, strict=True):
        np.testing.assert_array_equal(got, wanted)


@pytest.mark.parametrize("kind", KINDS)
def test_a_matrix_of_any_type_is_factored(kind):
    matrix = np.array([[9.0, 3.0, 1.0], [3.0, 9.0, 2.0], [1.0, 2.0, 9.0]])
    diagonal, right = np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 3.0])
    factor = Cholesky(3).factor(variants(matrix)[kind], variants(diagonal)[kind])
    np.testing.assert_allclose(factor.solve(variants(right)[kind]), np.linalg.solve(matrix + np.diag(diagonal), right))


def test_arrays_of_another_length_are_refused():
    code = compiled(case(MODELS["static"](), 40))
    columns = [code.case.columns[name] for name in code.kernel.layout.inputs]
    targets = [c.target for c in code.case.criteria]
    pieces = [Piece(0, 40, np.ones(len(targets)))]
    with pytest.raises(ArgumentError, match="the kernel reads"):
        Accumulator(code.kernel, Samples(columns[1:], targets, pieces))
    with pytest.raises(ArgumentError, match="scores must have shape"):
        Samples(columns, targets, [Piece(0, 40, np.ones(len(targets) + 1))])
    with pytest.raises(ArgumentError, match="piece from 0 to 41 exceeds the 40 samples"):
        Samples(columns, targets, [Piece(0, 41, np.ones(len(targets)))])
    with pytest.raises(ArgumentError, match="the order visits sample 40, but there are 40"):
        Samples(columns, targets, pieces, np.arange(1, 41, dtype=np.uint32))
    summed = Accumulator(code.kernel, Samples(columns, targets, pieces))
    with pytest.raises(ArgumentError, match=f"needs at least {code.values.size} contiguous float64"):
        summed.costs(code.values[:-1])
    with pytest.raises(ArgumentError, match="at least 3 x 3"):
        Cholesky(3).factor(np.eye(2), np.ones(3))
    with pytest.raises(ArgumentError, match="at least 3 contiguous"):
        Cholesky(3).factor(np.eye(3), np.ones(2))

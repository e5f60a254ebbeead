"""Library functions of linear algebra."""

from functools import partial, reduce

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.matlab.values import is_vector
from kennfeld.models.imperative.evaluation_context import SymbolicEvaluator
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function
from kennfeld.models.imperative.linear_systems import inverse_matrix, matrix_determinant
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, format_sizes, matrix_product, reduce_slices
from kennfeld.models.imperative.symbolic_values import SymbolicValue, constants


def sum_along(apply: Elementwise, array: Nodes, axis: int = 0) -> Nodes:
    """Return the sums along a dimension."""
    return reduce_slices(apply, "add", array, axis, 0.0)


def transpose(array: Nodes) -> Nodes:
    """Return the transposed matrix."""
    if array.ndim > 2:
        raise ProgramError(f"an array of {array.ndim} dimensions cannot be transposed", "Use permute.")
    return array.T


def checked_matrix_product(builder: GraphBuilder, left: Nodes, right: Nodes) -> Nodes:
    if left.ndim != 2 or right.ndim != 2 or left.shape[1] != right.shape[0]:
        raise EvaluationError(f"matrices of {format_sizes(left, right)} cannot be multiplied")
    return matrix_product(builder, left, right)


def matrix_power(evaluator: SymbolicEvaluator, left: Nodes, right: Nodes) -> Nodes:
    """Raise a square matrix to a constant integer power."""
    exponent = evaluator.context.numbers(right, "the power of a matrix")
    if exponent is None or exponent.size != 1 or left.ndim != 2 or left.shape[0] != left.shape[1]:
        raise ProgramError(
            "a matrix power requires a square matrix and a constant exponent", "Use .^ element by element."
        )
    if not float(exponent.item()).is_integer() or not -64 <= exponent.item() <= 64:
        raise ProgramError(f"the exponent {exponent.item():g} of a matrix is not supported")
    times = int(exponent.item())
    # a power of 0 is the unit matrix whatever the matrix, even a singular one
    if not times:
        return constants(evaluator.builder, np.eye(left.shape[0]))
    base = left if times > 0 else inverse_matrix(evaluator.builder, left)
    return reduce(partial(checked_matrix_product, evaluator.builder), [base] * abs(times))


@function("mtimes", "mldivide", "mrdivide", "mpower", least=2, most=2)
def apply_operator(args: SymbolicArguments) -> SymbolicValue:
    signs = {"mtimes": "*", "mldivide": "\\", "mrdivide": "/", "mpower": "^"}
    return args.evaluator.operation(signs[args.name], *args.arrays)


@function("inv", "pinv")
def inverse(args: SymbolicArguments) -> SymbolicValue:
    """Return the inverse of a matrix, or the pseudoinverse of a constant one."""
    matrix = args.matrix(0)
    if args.name == "pinv" and all(args.builder.value(int(node)) is not None for node in matrix.ravel()):
        if not np.isfinite(args.numbers(0)).all():
            raise args.refuse("its numbers are not finite")
        return constants(args.builder, np.linalg.pinv(args.numbers(0)))
    return inverse_matrix(args.builder, matrix)


@function("det")
def determinant(args: SymbolicArguments) -> SymbolicValue:
    matrix = args.matrix(0)
    if matrix.shape[0] != matrix.shape[1]:
        raise args.refuse("its matrix is not square")
    return np.array([[matrix_determinant(args.builder, matrix)]], dtype=np.int64)


@function("norm", least=1, most=2)
def norm(args: SymbolicArguments) -> SymbolicValue:
    """Return the norm of a vector of order 1, 2 or inf, or of a matrix of order 1, inf or 'fro'."""
    apply, array = args.apply, args.array(0)
    order: object = 2.0
    if len(args) > 1:
        order = args.values[1] if isinstance(args.values[1], str) else float(args.numbers(1).item())
    vector = is_vector(args.matrix(0))
    if order == "fro" or (vector and order == 2.0):
        return apply("sqrt", sum_along(apply, apply("mul", array, array).reshape(-1, 1)))
    size = apply("abs", array)
    if order not in (1.0, np.inf, "inf", "Inf"):
        raise args.refuse(f"of order {order} is not supported")
    if vector and order == 1.0:
        return sum_along(apply, size.reshape(-1, 1))
    sums = size if vector else sum_along(apply, size, int(order != 1.0))
    return reduce_slices(apply, "max", sums.reshape(-1, 1), 0, 0.0)

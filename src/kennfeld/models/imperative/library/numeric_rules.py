"""Library functions without arithmetic on nodes, run by the evaluator of MATLAB numbers.

Functions of constants, sizes and classes run on constants of the same size and class. Functions that arrange elements
run on the numbers of the elements, counted from 1; 0 is a new element.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from kennfeld.matlab import values as v
from kennfeld.matlab.errors import Budget, LimitError, MatlabError
from kennfeld.matlab.evaluator import NumericEvaluator
from kennfeld.matlab.functions.numeric_registry import MANY, NUMERIC_FUNCTIONS
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import MAX_NODES, SymbolicEvaluator
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function, matlab_word
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.program import tree as m

_FILLED: Final = ("zeros", "ones", "inf", "Inf", "nan", "NaN", "true", "false", "eye", "cell")
# functions by the number of leading arguments of which only size and class matter; the others are constants
_QUERIES: Final = {
    **dict.fromkeys(("pi", "realmax", "realmin", "eps", "intmax", "intmin", "flintmax", "colon"), 0),
    **dict.fromkeys(("size", "numel", "length", "ndims", "isempty", "isscalar", "isvector", "isrow", "iscolumn"), 1),
    **dict.fromkeys(("ismatrix", "issquare", "iscell", "isstruct", "ischar", "isstring", "isnumeric", "islogical"), 1),
    **dict.fromkeys(("isreal", "isfloat", "isinteger", "isa", "class", "isfield", "fieldnames"), 1),
    **dict.fromkeys(("strcmp", "strcmpi", "strncmp", "strncmpi"), 2),
}
_ARRANGED: Final = (
    "reshape", "repmat", "transpose", "ctranspose", "permute", "squeeze", "fliplr", "flipud", "flip", "circshift",
    "diag", "tril", "triu",
)  # fmt: skip


@function(*_QUERIES, least=0, most=MANY)
def query(args: SymbolicArguments) -> s.SymbolicValue | tuple[s.SymbolicValue, ...]:
    """Compute a function of constants, sizes and classes."""
    count = _QUERIES[args.name]
    values = [_same_class(s.force(value)) for value in args.values[:count]]
    return _results(args, [*values, *_constants(args, count)])


@function(*_FILLED, least=0, most=MANY)
def filled_array(args: SymbolicArguments) -> s.SymbolicValue | tuple[s.SymbolicValue, ...]:
    """Create an array of equal elements, or the identity matrix."""
    values = _constants(args, 0, "a size")
    numbers = [v.numbers(value).ravel() for value in values if v.class_name(value) == "double"]
    sizes = np.concatenate([np.zeros(0), *numbers])
    if not np.isfinite(sizes).all():
        raise EvaluationError(f"{args.name}: a size must be an integer, got {sizes[~np.isfinite(sizes)][0]:g}")
    with np.errstate(over="ignore"):
        args.context.room(float(np.prod(np.maximum(sizes, 0.0)) ** (2 if sizes.size == 1 else 1)))
    return _results(args, values)


@function(*_ARRANGED, least=1, most=MANY)
def arrange(args: SymbolicArguments) -> s.SymbolicValue:
    """Arrange the elements of an array; the other arguments are constants."""
    array = args.array(0)
    return _arranged(args, [array], [_numbered(array, 1), *_constants(args, 1)])


@function("horzcat", "vertcat", "cat", least=1, most=MANY)
def concatenate(args: SymbolicArguments) -> s.SymbolicValue:
    """Concatenate arrays; for `cat`, along a constant dimension."""
    first = int(args.name == "cat")
    arrays = [args.array(at) for at in range(first, len(args))]
    begins = np.cumsum([1, *(array.size for array in arrays)])
    numbered = [_numbered(array, begin) for array, begin in zip(arrays, begins, strict=False)]
    return _arranged(args, arrays, [*_constants(args, 0, end=first), *numbered])


def _numbered(array: Nodes, begin: int) -> v.Array:
    return np.arange(begin, begin + array.size, dtype=np.float64).reshape(array.shape, order="F")


def _arranged(args: SymbolicArguments, arrays: Sequence[Nodes], values: Sequence[v.Value]) -> Nodes:
    nodes = np.concatenate([[args.builder.const(0.0)], *(np.asarray(array).ravel(order="F") for array in arrays)])
    result = nodes[v.numbers(call_numerically(args, values)[0]).astype(np.int64)]
    is_logical = bool(arrays) and all(isinstance(array, s.LogicalNodes) for array in arrays)
    return s.as_logical(result) if is_logical else result


def _constants(args: SymbolicArguments, begin: int, message: str = "", end: int = MANY) -> list[v.Value]:
    """Return arguments as numbers and texts; behind `'like'` only the class matters."""
    values: list[v.Value] = []
    for at, value in list(enumerate(args.values))[begin:end]:
        if not isinstance(value, np.ndarray):
            values.append(_same_class(value))
        elif at > 0 and isinstance(name := args.values[at - 1], str) and name == "like":
            values.append(_typed(value, np.zeros(value.shape)))
        else:
            values.append(_typed(value, args.numbers(at, message)))
    return values


def _typed(nodes: s.SymbolicValue, numbers: v.Array) -> v.Array:
    """Return numbers in the class of nodes."""
    if isinstance(nodes, s.Integers) and nodes.word is not None:
        return numbers.astype(f"{'int' if nodes.word.signed else 'uint'}{nodes.word.bits}")
    return numbers.astype(bool) if isinstance(nodes, s.LogicalNodes) else numbers


def _same_class(value: s.SymbolicValue) -> v.Value:
    """Return a constant of the size and class of a value; texts stay."""
    match value:
        case s.String():
            return v.strings([str(value)])
        case str():
            return v.characters(value)
        case s.SymbolicStruct():
            return v.MatlabStruct.of(dict.fromkeys(value.fields, v.EMPTY))
        case s.SymbolicCell():
            return v.MatlabCell(v.object_array([_same_class(s.force(cell)) for cell in value.cells], value.shape))
        case s.FunctionHandleValue():
            return v.MatlabFunctionHandle()
    nodes = s.as_array(value)
    return np.zeros(nodes.shape, dtype=bool if isinstance(nodes, s.LogicalNodes) else np.float64)


def evaluate_constant_call(
    evaluator: SymbolicEvaluator, name: str, values: Sequence[s.SymbolicValue]
) -> tuple[s.SymbolicValue, ...]:
    """Return the result of a function of constants; none if an argument is not constant or the function is unknown."""
    args = SymbolicArguments(name, evaluator, [s.force(value) for value in values])
    if name not in NUMERIC_FUNCTIONS or not all(isinstance(value, np.ndarray | str) for value in args.values):
        return ()
    try:
        results = call_numerically(args, _constants(args, 0))
    except ProgramError:
        return ()
    is_number = isinstance(results[0], np.ndarray) and results[0].dtype.kind in "fiub"
    return (_symbolic(args, results[0]),) if is_number else ()


def call_numerically(args: SymbolicArguments, values: Sequence[v.Value]) -> list[v.Value]:
    """Return the results of the function of numbers; raises `EvaluationError` if it has none."""
    evaluator = NumericEvaluator({}, {}, Budget(elements=MAX_NODES), "")
    try:
        with np.errstate(all="ignore"):
            return evaluator.call(args.name, values, args.wanted, m.TextPosition())
    except MatlabError as error:
        raise EvaluationError(error.findings[0].message) from None
    except LimitError:
        raise EvaluationError(f"{args.name}: it creates an array of more than {MAX_NODES} elements") from None


def _results(args: SymbolicArguments, values: Sequence[v.Value]) -> s.SymbolicValue | tuple[s.SymbolicValue, ...]:
    return tuple(_symbolic(args, value) for value in call_numerically(args, values))


def _symbolic(args: SymbolicArguments, value: v.Value) -> s.SymbolicValue:
    """Return a constant value of the evaluator of numbers as nodes."""
    if isinstance(value, v.MatlabCell):
        return s.SymbolicCell(
            tuple(_symbolic(args, cell) for cell in value.values.ravel(order="F")), value.values.shape
        )
    array = v.array_value(value)
    if array.dtype.kind == "U":
        return v.text(array)
    if array.dtype.kind == "O":
        return s.String(v.text(array))
    nodes = s.constants(args.builder, array)
    return s.integers(nodes, matlab_word(array.dtype.name)) if array.dtype.kind in "iu" else nodes

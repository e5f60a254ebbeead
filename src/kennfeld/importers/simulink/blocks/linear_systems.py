"""LTI System of the Control System Toolbox: expressions of tf, zpk and ss with parameters of the model."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.blocks.continuous import (
    Matrices,
    linear_output,
    multiply_out,
    rational_output,
)
from kennfeld.importers.simulink.lowering import ARITHMETIC, BlockContext, UnsupportedError, block, evaluating
from kennfeld.importers.simulink.signals import SignalOrBus
from kennfeld.matlab.parser import parse_expression
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.program import tree as m

_MAX_POWER = 20
_VARIABLES = ("s", "p")  # of Laplace


class Rational(NamedTuple):
    """A rational function of s; coefficients have the highest power first."""

    numerator: list[int]
    denominator: list[int]


def _feedthrough(block: BlockContext) -> Iterable[int]:
    system = _system(block)
    if not isinstance(system, Rational):
        return () if all(block.builder.value(int(node)) == 0 for node in system[3].ravel()) else (0,)
    return (0,) if len(system.numerator) >= len(system.denominator) else ()


@block("cstblocks/LTI System", linked=True, continuous=True, output=ARITHMETIC, needs=_feedthrough, sys="tf(1,[1 1])",
       IC="[]")  # fmt: skip
def lti_system(block: BlockContext) -> SignalOrBus:
    """Lower a continuous linear system that its field states as an expression."""
    system, written = _system(block), block.field_text("IC").strip()
    if not isinstance(system, Rational):
        count = system[0].shape[0]
        init = block.parameter("IC") if written not in ("", "[]") else block.constant(*[0.0] * count)
        if init.size not in (1, count):
            raise UnsupportedError(f"it has {init.size} initial values for {count} states")
        first = block.signal(np.full((count,), init.flat[0])) if init.size == 1 else init
        return linear_output(block, system, lambda slope: block.continuous_state(first, slope))
    # the states of a transfer function depend on how it is converted to a state space
    if written not in ("", "[]") and block.numeric_array("IC").any():
        raise UnsupportedError("its transfer function has initial states, which only state spaces have")
    return rational_output(block, system.numerator, system.denominator)


def _system(block: BlockContext) -> Rational | Matrices:
    text = block.field_text("sys")
    try:
        tree = parse_expression(text)
    except InputError as error:
        raise UnsupportedError(f"its sys ({text[:60]}) has no value: {error.findings[0].message}") from None
    if _function(tree) == "ss":
        return _state_space(block, tree)
    with evaluating(f"its sys ({text[:60]}) has no value"):
        return _trimmed(block, _rational(block, tree))


def _function(tree: m.Expression) -> str:
    """Return the name of a called function, "" for other expressions."""
    return tree.of.name if isinstance(tree, m.Call) and isinstance(tree.of, m.Name) else ""


def _array(block: BlockContext, tree: m.Expression) -> Nodes:
    return block.compiler.expressions.tree_array(tree, block.flat.scope)


def _state_space(block: BlockContext, tree: m.Expression) -> Matrices:
    assert isinstance(tree, m.Call)
    if len(tree.arguments) != 4:
        raise UnsupportedError(f"its ss has {len(tree.arguments)} arguments; only ss(A, B, C, D) is supported")
    with evaluating("its sys has no value"):
        A, B, C, D = (_array(block, argument) for argument in tree.arguments)
    rows, inputs, outputs = A.shape[0], B.shape[1], C.shape[0]
    if D.size == 1 and block.builder.value(int(D.flat[0])) == 0:
        D = np.full((outputs, inputs), int(D.flat[0]), dtype=np.int64)
    if (A.shape, B.shape, C.shape, D.shape) != ((rows, rows), (rows, inputs), (outputs, rows), (outputs, inputs)):
        raise UnsupportedError("the sizes of its A, B, C and D do not match")
    return A, B, C, D


def _rational(block: BlockContext, tree: m.Expression) -> Rational:
    """Return the rational function of an expression with tf, zpk, the variable s and parameters."""
    name = _function(tree)
    if name in ("tf", "zpk") and isinstance(tree, m.Call):
        return _of_call(block, name, tree.arguments)
    if _is_variable(block, tree):
        return Rational([block.builder.const(1.0), block.builder.const(0.0)], [block.builder.const(1.0)])
    if isinstance(tree, m.Unary) and tree.operator in ("+", "-"):
        inner = _rational(block, tree.operand)
        minus = [block.builder.call("neg", node) for node in inner.numerator]
        return inner if tree.operator == "+" else inner._replace(numerator=minus)
    if isinstance(tree, m.Binary) and tree.operator in ("+", "-", "*", ".*", "/", "./", "^", ".^"):
        return _of_operator(block, tree)
    nodes = _array(block, tree)
    if nodes.size != 1:
        raise UnsupportedError(f"its sys contains an array of {nodes.size} numbers outside of tf, zpk and ss")
    return Rational([int(nodes.flat[0])], [block.builder.const(1.0)])


def _is_variable(block: BlockContext, tree: m.Expression) -> bool:
    """Return True for `s`, which scripts define by s = tf('s'), unless it is a number of the model."""
    return isinstance(tree, m.Name) and tree.name in _VARIABLES and block.flat.scope.find(tree.name) is None


def _of_call(block: BlockContext, name: str, arguments: tuple[m.Expression, ...]) -> Rational:
    if name == "tf" and len(arguments) == 1:
        (only,) = arguments
        if isinstance(only, m.Text) and only.value in _VARIABLES:
            return Rational([block.builder.const(1.0), block.builder.const(0.0)], [block.builder.const(1.0)])
        return _rational(block, only)
    if len(arguments) != (2 if name == "tf" else 3):
        raise UnsupportedError(f"its {name} has {len(arguments)} arguments: only continuous systems are supported")
    parts = [_array(block, argument) for argument in arguments]
    if any(min(part.shape, default=0) > 1 for part in parts):
        raise UnsupportedError(f"its {name} has several inputs or outputs, which is not supported")
    lists = [[int(node) for node in part.ravel()] for part in parts]
    if name == "tf":
        return Rational(*lists)
    zeros, poles, gain = lists
    if len(gain) != 1:
        raise UnsupportedError("its zpk has several gains, which is not supported")
    numerator = [block.builder.call("mul", gain[0], node) for node in multiply_out(block, zeros)]
    return Rational(numerator, multiply_out(block, poles))


def _of_operator(block: BlockContext, tree: m.Binary) -> Rational:
    left = _rational(block, tree.left)
    operator = tree.operator.lstrip(".")
    if operator == "^":
        power = block.compiler.expressions.tree_numbers(tree.right, block.flat.scope)
        if power.size != 1 or not float(power.item()).is_integer() or not 0 <= power.item() <= _MAX_POWER:
            raise UnsupportedError(f"its sys has a power that is not an integer from 0 to {_MAX_POWER}")
        result = Rational([block.builder.const(1.0)], [block.builder.const(1.0)])
        for _ in range(int(power.item())):
            result = Rational(
                _product(block, result.numerator, left.numerator), _product(block, result.denominator, left.denominator)
            )
        return result
    right = _rational(block, tree.right)
    if operator in ("*", "/"):
        up, down = right if operator == "*" else (right.denominator, right.numerator)
        return Rational(_product(block, left.numerator, up), _product(block, left.denominator, down))
    # a/b + c/d = (a d + c b) / (b d), without cancelling
    first = _product(block, left.numerator, right.denominator)
    second = _product(block, right.numerator, left.denominator)
    operation = "add" if operator == "+" else "sub"
    return Rational(_combined(block, operation, first, second), _product(block, left.denominator, right.denominator))


def _product(block: BlockContext, p: list[int], q: list[int]) -> list[int]:
    """Multiply two polynomials."""
    call = block.builder.call
    result = [block.builder.const(0.0)] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for j, b in enumerate(q):
            result[i + j] = call("add", result[i + j], call("mul", a, b))
    return result


def _combined(block: BlockContext, operation: str, p: list[int], q: list[int]) -> list[int]:
    """Add or subtract two polynomials."""
    zero, size = block.builder.const(0.0), max(len(p), len(q))
    padded = ([zero] * (size - len(part)) + part for part in (p, q))
    return [block.builder.call(operation, a, b) for a, b in zip(*padded, strict=True)]


def _trimmed(block: BlockContext, system: Rational) -> Rational:
    """Return a rational function without leading coefficients that are 0."""

    def trimmed(nodes: list[int]) -> list[int]:
        first = next((at for at, node in enumerate(nodes) if block.builder.value(node) != 0), len(nodes) - 1)
        return nodes[first:]

    numerator, denominator = trimmed(system.numerator), trimmed(system.denominator)
    if block.builder.value(denominator[0]) == 0:
        raise UnsupportedError("the denominator of its sys is 0")
    if len(numerator) > len(denominator):
        raise UnsupportedError("its sys is not proper: the numerator has a higher order than the denominator")
    return Rational(numerator, denominator)

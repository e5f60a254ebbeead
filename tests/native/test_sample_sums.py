"""Sums of models without states: batches of samples, wide rows, and matrices in blocks."""

from functools import cache

import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Map
from kennfeld.graph import GraphBuilder
from kennfeld.native import workspace
from kennfeld.native.symmetric import as_array
from tests.native.models import X, Y, case, static
from tests.native.reference import compiled, sums

TABLES = 30


def tables() -> ParameterSet:
    random = np.random.default_rng(3)
    return ParameterSet([Map(f"M{i}", X, Y, random.standard_normal((4, 3))) for i in range(TABLES)])


def selected() -> "tuple[GraphBuilder, list[int]]":
    """Tables of which a condition selects one."""
    b = GraphBuilder()
    u, v = b.input("u"), b.input("v")
    mode = b.call("floor", b.call("mul", b.const(6.0), b.call("add", b.input("w"), b.const(2.5))))
    terms = []
    for i in range(TABLES):
        active = b.call("eq", mode, b.const(float(i)))
        terms.append(b.call("select", active, b.lookup(f"M{i}", u, v), b.const(0.0)))
    return b, terms


def added() -> "tuple[GraphBuilder, list[int]]":
    """Tables at the same place, each with its own factor."""
    b = GraphBuilder()
    u, v, w = (b.input(name) for name in "uvw")
    factors = (b.call("sin", b.call("mul", w, b.const(float(i)))) for i in range(1, TABLES + 1))
    return b, [b.call("mul", factor, b.lookup(f"M{i}", u, v)) for i, factor in enumerate(factors)]


def scattered() -> "tuple[GraphBuilder, list[int]]":
    """Tables at places of their own."""
    b = GraphBuilder()
    u, v, w = (b.input(name) for name in "uvw")
    terms = []
    for i in range(TABLES):
        x, y = (b.call("sin", b.call("mul", axis, b.const(3.0 * i + 1))) for axis in (u, b.call("add", v, w)))
        terms.append(b.lookup(f"M{i}", x, y))
    return b, terms


@cache
def wide(model):
    """A compiled model of many tables, and its sums by the interpreter."""
    b, terms = model()
    total = terms[0]
    for term in terms[1:]:
        total = b.call("add", total, term)
    second = b.call("mul", total, b.input("u"))
    graph = b.finish({"y": total, "z": second})
    return with_expected_sums(case(graph, 250, values=tables(), free=tuple(f"M{i}" for i in range(TABLES))))


def with_expected_sums(model):
    code = compiled(model)
    return code, sums(model, code.run(code.interpreter()))


MODELS = {"selected": selected, "added": added, "scattered": scattered}


@pytest.fixture
def in_blocks(monkeypatch):
    monkeypatch.setattr(workspace, "LARGE", 0)


def check_against_interpreter(code, direct):
    summed = code.accumulator()
    for _ in range(3):  # the second and third meet the blocks of the first
        normal = summed.normal(code.values)
        scale = np.abs(direct.matrix).max()
        np.testing.assert_allclose(as_array(normal.matrix), direct.matrix, rtol=0, atol=1e-12 * scale)
        np.testing.assert_allclose(normal.gradient, direct.gradient, rtol=0, atol=1e-12 * np.abs(direct.gradient).max())
    return normal.matrix


@pytest.mark.parametrize("model", sorted(MODELS))
def test_wide_rows_are_those_of_the_interpreter(model):
    check_against_interpreter(*wide(MODELS[model]))


@pytest.mark.parametrize("model", sorted(MODELS))
def test_wide_rows_in_blocks_are_those_of_the_interpreter(model, in_blocks):
    matrix = check_against_interpreter(*wide(MODELS[model]))
    assert matrix.storage.full == (model != "selected")


@pytest.mark.parametrize("loss", ["square", "huber"])
def test_a_small_model_in_blocks_is_that_of_the_interpreter(loss, in_blocks):
    check_against_interpreter(*with_expected_sums(case(static(), 120, (0, 1, 50), loss=loss)))


def test_tables_that_are_never_selected_together_share_no_block(in_blocks):
    matrix = check_against_interpreter(*wide(selected))
    own = np.kron(np.eye(TABLES), np.ones((12, 12)))
    assert not as_array(matrix)[own == 0].any()
    assert matrix.storage.count < 0.3 * matrix.storage.across**2

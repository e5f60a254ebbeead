import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.graph import GraphBuilder, derivative
from kennfeld.graph.adjoints import AdjointProgram
from kennfeld.graph.derivative import Written
from kennfeld.native.adjoint_loop import PullProgram
from tests.draws import mostly_slow
from tests.native.models import MODELS, case, coupled
from tests.native.reference import compiled, sums
from tests.native.segments import cut_code


@pytest.fixture
def share(monkeypatch):
    """Makes rows share a pull-back, however small the model."""

    def now():
        monkeypatch.setattr(derivative, "MAX_VISITS", -1)
        monkeypatch.setattr(derivative, "SHARED", 0.0)

    return now


def results(code, **options):
    summed = code.accumulator(**options)
    costs = summed.costs(code.values)
    normal = summed.normal(code.values)
    return [costs, normal.gradient.copy(), normal.matrix.copy(), *summed.rows(code.values)]


def assert_equal(got, expected):
    for a, b in zip(got, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-13 * np.max(np.abs(b)))


def both(model, share):
    """A case with rows written out, and with a pull-back."""
    written = compiled(model)
    share()
    pulled = compiled(model)
    assert isinstance(written.kernel.line.slopes, Written)
    assert isinstance(pulled.kernel.line.slopes, AdjointProgram)
    return written, pulled


@pytest.mark.parametrize("model", sorted(MODELS))
def test_sums_of_a_pull_back_equal_rows_written_out(model, share):
    written, pulled = both(case(MODELS[model](), 120, (0, 1, 50)), share)
    assert_equal(results(pulled), results(written))


@pytest.mark.parametrize("states", [2, 3, 4, 5])  # rows of one block and of two that overlap by 3, 2 and 1
def test_any_number_of_rows_is_shared_among_the_lanes(states, share):
    written, pulled = both(case(coupled(states), 40, (0, 30)), share)
    assert_equal(results(pulled, sparse=False), results(written, sparse=False))


@pytest.mark.slow
@pytest.mark.parametrize("segment", mostly_slow([1, 5, 30], 1))
def test_the_code_around_a_pull_back_may_be_cut(segment, share, monkeypatch):
    share()
    model = case(coupled(3), 60, (0, 20))
    whole = results(compiled(model))
    cut_code(monkeypatch, segment)
    assert_equal(results(compiled(model)), whole)


def test_smoothed_lookups_have_as_many_entries_as_they_need(share):
    model = case(MODELS["static"](), 80)
    written = compiled(model, smooth=("C", "M"))
    share()
    pulled = compiled(model, smooth=("C", "M"))
    widths = np.full(len(written.lowered.axes), 0.4)
    assert not pulled.kernel.entries.fixed
    assert_equal(results(pulled, widths=widths), results(written, widths=widths))


def test_a_slope_that_is_not_finite_stays_in_its_own_row(share):
    b = GraphBuilder()
    k = b.lookup("K")
    root = b.call("sqrt", b.call("sub", k, k))  # of slope infinity
    names = {
        "plain": b.call("mul", k, b.input("u")),
        "taken": b.call("add", root, b.lookup("C", b.input("v"))),
        "not_taken": b.call("select", b.call("lt", b.input("u"), b.const(9.0)), k, root),
    }
    written, pulled = both(case(b.finish(names), 30), share)
    expected, got = (code.accumulator().rows(code.values)[1].reshape(30, 3, -1) for code in (written, pulled))
    np.testing.assert_allclose(got[:, [0, 2]], expected[:, [0, 2]], rtol=1e-14)
    scored = ~np.isnan(written.case.criteria[1].target)
    at = written.kernel.values.offsets["K"]
    assert not np.isfinite(got[scored, 1, at]).any()
    assert np.isfinite(np.delete(got[:, 1], at, axis=1)).all()


def test_factors_take_no_memory_of_adjoints(share):
    _, pulled = both(case(MODELS["static"](), 5), share)
    back = pulled.kernel.line.slopes
    program = PullProgram("rows", back, [() for _ in back.roots], 1)
    leaves = {leaf for row in back.reach for leaf in row}
    assert set(program.source) == {
        *back.roots,
        *leaves,
        *(node for pull in back.pulls for node in (pull.of, pull.onto)),
    }
    assert any(pull.factor not in program.source for pull in back.pulls)


def test_saturated_quantities_have_slope_zero_in_all_forms(share):
    b = GraphBuilder()
    k, u, one = b.lookup("K"), b.input("u"), b.const(1.0)
    cut = b.call(
        "max", b.call("sub", b.call("floor", u), b.call("sub", k, k)), b.const(0.0)
    )  # 0 in half of the samples
    steep = b.call("exp", b.call("mul", b.call("add", k, b.const(1000.0)), u))  # infinite in half of the samples
    state = b.state()
    b.close(state, k, b.call("div", one, b.call("add", one, b.call("mul", steep, b.call("exp", state)))))
    names = {
        "root": b.call("sqrt", b.call("mul", cut, k)),
        "logistic": b.call("div", one, b.call("add", one, steep)),
        "memory": b.call("mul", state, u),
    }
    written, pulled = both(case(b.finish(names), 60, values=ParameterSet([Scalar("K", 0.7)])), share)
    expected = written.run(written.interpreter())
    assert np.isfinite(expected).all()
    for code in (written, pulled):
        np.testing.assert_allclose(code.run(code.interpreter()), expected, rtol=1e-13)
        _, jacobian = code.accumulator().rows(code.values)
        assert np.isfinite(jacobian).all()
    assert_equal(results(pulled), results(written))
    assert_equal([written.accumulator().normal(written.values).gradient], [sums(written.case, expected).gradient])

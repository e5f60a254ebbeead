import dataclasses

import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.graph import GraphBuilder
from kennfeld.native import accumulator as module
from tests.graph.noise import assert_close, spread
from tests.graph.random_graphs import LOSSES
from tests.native.models import MODELS, case, coupled, lag, parameters, static
from tests.native.reference import compiled, sums

STARTS = (0, 1, 170, 171, 400)
both = pytest.mark.parametrize("model", sorted(MODELS))


def results(code, **options):
    summed = code.accumulator(**options)
    costs = summed.costs(code.values)
    normal = summed.normal(code.values)
    residual, jacobian = summed.rows(code.values)
    return [costs, normal.gradient.copy(), normal.matrix.copy(), residual, jacobian]


def close(got, expected, tolerance):
    for a, b in zip(got, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * np.max(np.abs(b)))


@pytest.mark.parametrize(
    ("model", "loss"),
    [  # each model once, and each loss
        pytest.param(model, loss, marks=() if number % len(LOSSES) == at else pytest.mark.slow)
        for number, model in enumerate(sorted(MODELS))
        for at, loss in enumerate(LOSSES)
    ],
)
def test_sums_are_those_of_the_interpreters_rows(model, loss):
    code = compiled(case(MODELS[model](), 50, (0, 1, 20), loss=loss))
    direct = sums(code.case, code.run(code.interpreter()))
    costs, gradient, matrix, *_ = results(code)
    close((costs, gradient, matrix), (direct.costs, direct.gradient, direct.matrix), 1e-12)


@both
def test_the_gradient_is_that_of_finite_differences(model):
    code = compiled(case(MODELS[model](), 80, (0, 30), loss="soft_l1"))
    summed, values, h = code.accumulator(), code.values, 1e-6
    gradient = 2 * summed.normal(values).gradient.copy()
    for j in range(code.kernel.values.free):
        up, down = values.copy(), values.copy()
        up[j], down[j] = values[j] + h, values[j] - h
        slope = (summed.cost(up) - summed.cost(down)) / (2 * h)
        assert gradient[j] == pytest.approx(slope, rel=2e-6, abs=1e-6 * np.max(np.abs(gradient))), j


@both
def test_the_cost_is_the_sum_of_the_costs_of_each_output(model):
    code = compiled(case(MODELS[model](), 100))
    summed = code.accumulator()
    assert summed.cost(code.values) == pytest.approx(summed.costs(code.values).sum(), rel=1e-15)


@both
def test_results_do_not_depend_on_the_number_of_threads(model, monkeypatch):
    code = compiled(case(MODELS[model](), 4000, (0, 900, 901, 2500)))
    all_results = []
    for threads in (1, 2, 8):
        monkeypatch.setattr("kennfeld.native.accumulator.available_cores", lambda threads=threads: threads)
        all_results.append(results(code))
    for other in all_results[1:]:
        for a, b in zip(all_results[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


def test_threads_are_put_to_work_in_this_file(monkeypatch):
    monkeypatch.setattr("kennfeld.native.accumulator.available_cores", lambda: 8)
    code = compiled(case(static(), 4000))
    assert code.accumulator()._pool is not None


@both
@pytest.mark.parametrize("sparse", [True, False])
def test_results_do_not_depend_on_the_length_of_chunks(model, sparse, monkeypatch):
    code = compiled(case(MODELS[model](), 500, STARTS))
    if sparse and code.kernel.pattern.carried and not code.kernel.pattern.accumulates:
        pytest.skip("delays have rows alone")
    options = {"sparse": sparse} if code.kernel.pattern.carried else {}
    whole = results(code, **options)
    monkeypatch.setattr(module, "TAPE_BYTES", 1)
    cut = code.accumulator(**options)
    assert max(sum(c.piece == i for c in cut.chunks) for i in range(len(STARTS))) > 2
    close(results(code, **options), whole, 1e-13)


@pytest.mark.parametrize("model", ["lag", "coupled2", "coupled3"])
def test_backward_and_forward_sweeps_equal_the_rows(model):
    code = compiled(case(MODELS[model](), 500, STARTS))
    close(results(code, sparse=True), results(code, sparse=False), 1e-12)


@pytest.mark.parametrize("count", [2, 3])
def test_coupled_states_with_two_outputs_are_summed_exactly(count):
    code = compiled(case(coupled(count), 100, (0, 35)))
    direct = sums(code.case, code.run(code.interpreter()))
    normal = code.accumulator(sparse=True).normal(code.values)
    close((normal.gradient, normal.matrix), (direct.gradient, direct.matrix), 1e-12)


def test_pieces_run_by_themselves_and_add_up():
    whole = case(lag(), 60, (0, 25))
    parts = []
    for number, (first, last) in enumerate(zip(whole.starts, whole.ends, strict=True)):
        columns = {name: c[first:last] for name, c in whole.columns.items()}
        criteria = tuple(
            dataclasses.replace(c, target=c.target[first:last], scores=c.scores[[number]]) for c in whole.criteria
        )
        parts.append(dataclasses.replace(whole, columns=columns, starts=(0,), criteria=criteria))
    separate = [results(compiled(part)) for part in parts]
    together = results(compiled(whole))
    for i in range(3):
        np.testing.assert_allclose(together[i], separate[0][i] + separate[1][i], rtol=1e-12, atol=1e-13)


def test_a_score_multiplies_the_square():
    single = case(static(), 50)
    double = dataclasses.replace(
        single, criteria=tuple(dataclasses.replace(c, scores=2 * c.scores) for c in single.criteria)
    )
    for a, b in zip(results(compiled(double))[:3], results(compiled(single))[:3], strict=True):
        np.testing.assert_allclose(a, 2 * b, rtol=1e-14)


def test_a_sample_without_a_target_counts_for_nothing_even_where_the_model_is_not_finite():
    model = case(static(), 40)
    model.columns["u"][[3, 9]] = np.nan
    model.columns["v"][5] = np.inf
    model.criteria[0].target[[3, 5, 9]] = np.nan
    code = compiled(model)
    assert all(np.isfinite(a).all() for a in results(code))
    kept = np.isfinite(model.criteria[0].target)
    columns = {name: c[kept] for name, c in model.columns.items()}
    criteria = (dataclasses.replace(model.criteria[0], target=model.criteria[0].target[kept]),)
    less = results(compiled(dataclasses.replace(model, columns=columns, criteria=criteria)))
    close(results(code)[:3], less[:3], 1e-13)


def test_a_nan_input_makes_the_cost_nan():
    model = case(static(), 40)
    model.columns["u"][4] = np.nan
    model.criteria[0].target[4] = 1.0
    assert np.isnan(compiled(model).accumulator().cost(compiled(model).values))


def test_a_score_of_zero_switches_off_even_where_the_model_is_not_finite():
    model = case(static(), 40, (0, 20))
    model.columns["u"][4] = np.nan
    model.criteria[0].target[4] = 1.0
    model.criteria[0].scores[0] = 0.0
    code = compiled(model)
    costs, gradient, *_ = results(code)
    assert np.isfinite(costs).all()
    assert np.isfinite(gradient).all()


@pytest.mark.parametrize("loss", LOSSES)
def test_an_infinite_residual_gives_an_infinite_cost_and_no_warning(loss):
    b = GraphBuilder()
    graph = b.finish({"y": b.call("div", b.lookup("K"), b.input("u"))})
    model = case(graph, 10, loss=loss)
    model.columns["u"][4] = 0.0
    model.criteria[0].target[4] = 1.0
    code = compiled(model)
    assert not np.isfinite(code.accumulator().cost(code.values))
    code.accumulator().normal(code.values)
    code.accumulator().rows(code.values)


@pytest.mark.parametrize("size", [1e-3, 1e-6, 1e-9])
def test_soft_l1_is_the_square_for_small_residuals(size):
    b = GraphBuilder()
    model = case(b.finish({"y": b.lookup("K")}), 3, loss="soft_l1", values=ParameterSet([Scalar("K", 1.0 + size)]))
    criterion = dataclasses.replace(model.criteria[0], target=np.ones(3), scores=np.ones(1), scale=1.0, delta=1.0)
    code = compiled(dataclasses.replace(model, criteria=(criterion,)))
    assert code.accumulator().cost(code.values) == pytest.approx(3 * (code.values[0] - 1.0) ** 2, rel=1e-6, abs=0)


def test_a_branch_not_taken_leaks_nothing_into_the_sums():
    b = GraphBuilder()
    x = b.call("add", b.input("u"), b.lookup("K"))
    root = b.call("select", b.call("gt", x, b.const(0.0)), b.call("sqrt", x), b.const(0.0))
    logged = b.call("select", b.call("gt", x, b.const(0.0)), b.call("log", x), b.lookup("C", x))
    code = compiled(case(b.finish({"y": b.call("add", root, logged)}), 100))
    assert (code.case.columns["u"] < -0.37).any()
    direct = sums(code.case, code.run(code.interpreter()))
    costs, gradient, matrix, *_ = results(code)
    close((costs, gradient, matrix), (direct.costs, direct.gradient, direct.matrix), 1e-11)
    assert np.isfinite(gradient).all()


def test_a_branch_not_taken_leaks_nothing_through_states():
    b = GraphBuilder()
    state = b.state()
    x = b.call("add", b.input("u"), b.call("mul", b.lookup("K"), state))
    chosen = b.call("select", b.call("gt", x, b.const(0.0)), b.call("sqrt", x), b.call("mul", state, b.lookup("L")))
    b.close(state, b.const(0.5), chosen)
    code = compiled(case(b.finish({"y": state}), 100))
    direct = sums(code.case, code.run(code.interpreter()))
    for sparse in (True, False):
        costs, gradient, matrix, *_ = results(code, sparse=sparse)
        close((costs, gradient, matrix), (direct.costs, direct.gradient, direct.matrix), 1e-11)


def test_lookups_of_the_same_grid_points_are_merged():
    b = GraphBuilder()
    u = b.input("u")
    other = b.call("add", u, b.const(1e-3))
    product = b.call("mul", b.lookup("C", u), b.lookup("C", other))
    code = compiled(case(b.finish({"y": b.call("add", product, b.lookup("C", b.call("neg", u)))}), 60))
    direct = sums(code.case, code.run(code.interpreter()))
    _, gradient, matrix, *_ = results(code)
    close((gradient, matrix), (direct.gradient, direct.matrix), 1e-13)


def test_two_criteria_may_share_a_node():
    b = GraphBuilder()
    y = b.lookup("C", b.input("u"))
    code = compiled(case(b.finish({"y": y, "same": y}), 60))
    direct = sums(code.case, code.run(code.interpreter()))
    costs, gradient, matrix, *_ = results(code)
    close((costs, gradient, matrix), (direct.costs, direct.gradient, direct.matrix), 1e-13)


def test_fixed_parameters_have_no_columns():
    code = compiled(case(static(), 30, free=("M",)))
    assert code.kernel.values.free == 12
    assert results(code)[2].shape == (12, 12)


def test_nothing_free_leaves_the_cost():
    code = compiled(case(lag(), 30, free=()))
    direct = sums(code.case, code.run(code.interpreter()))
    costs, gradient, matrix, *_ = results(code)
    np.testing.assert_allclose(costs, direct.costs, rtol=1e-13)
    assert gradient.shape == (0,)
    assert matrix.shape == (0, 0)


def test_a_table_that_no_criterion_reaches_has_columns_of_zeros():
    b = GraphBuilder()
    graph = b.finish({"y": b.lookup("K"), "z": b.lookup("C", b.input("u"))})
    model = case(graph, 30)
    code = compiled(dataclasses.replace(model, criteria=model.criteria[:1]))
    _, gradient, matrix, *_ = results(code)
    at = code.kernel.values.offsets["C"]
    assert not gradient[at : at + 4].any()
    assert not matrix[at : at + 4].any()


def test_sums_start_from_nothing_at_each_call():
    code = compiled(case(lag(), 100, (0, 40)))
    summed = code.accumulator()
    first = summed.normal(code.values)
    gradient, matrix = first.gradient.copy(), first.matrix.copy()
    for _ in range(3):
        again = summed.normal(code.values)
        np.testing.assert_array_equal(again.gradient, gradient)
        np.testing.assert_array_equal(again.matrix, matrix)


def test_values_that_the_caller_changes_in_place_are_seen():
    code = compiled(case(lag(), 100, (0, 40)))
    summed, values = code.accumulator(), code.values
    summed.normal(values)
    values += 0.05
    expected = code.accumulator().normal(values.copy()).matrix.copy()
    np.testing.assert_array_equal(summed.normal(values).matrix, expected)


def test_widths_that_change_are_seen_with_states(monkeypatch):
    monkeypatch.setattr(module, "TAPE_BYTES", 1)
    b = GraphBuilder()
    state = b.state()
    b.close(state, b.const(0.2), b.lookup("C", b.call("add", b.lookup("M", b.input("u"), b.input("v")), state)))
    code = compiled(case(b.finish({"y": state}), 300), smooth=["M"])
    wide = np.full(len(code.lowered.axes), 0.4)
    summed = code.accumulator(widths=np.full_like(wide, 0.05))
    summed.normal(code.values)
    summed.widths[:] = wide
    np.testing.assert_array_equal(
        summed.normal(code.values).matrix.copy(), code.accumulator(widths=wide).normal(code.values).matrix
    )


@pytest.mark.parametrize("extrapolation", ["clip", "linear"])
@pytest.mark.parametrize("width", [0.02, 0.2, 3.0])
def test_smoothed_sums_are_those_of_the_interpreter_and_of_finite_differences(extrapolation, width):
    tables = parameters()
    tables = tables.with_parameters(*(p.changed(extrapolation=extrapolation) for p in tables.values() if p.axes))
    code = compiled(case(static(), 60, values=tables), smooth=["C", "M", "K"])
    widths = np.full(len(code.lowered.axes), width)
    summed = code.accumulator(widths=widths)
    plain = code.interpreter(tuple(widths))
    direct = sums(code.case, code.run(plain))
    costs, gradient, matrix, *_ = results(code, widths=widths)
    close((costs, gradient, matrix), (direct.costs, direct.gradient, direct.matrix), 1e-11)
    values, h = code.values, 1e-6
    for j in range(code.kernel.values.free):
        up, down = values.copy(), values.copy()
        up[j], down[j] = values[j] + h, values[j] - h
        slope = (summed.cost(up) - summed.cost(down)) / (2 * h)
        assert 2 * gradient[j] == pytest.approx(slope, rel=1e-4, abs=1e-5 * np.max(np.abs(gradient))), j


def test_a_smoothed_lookup_of_what_is_far_outside_is_clipped():
    b = GraphBuilder()
    y = b.lookup("Outer", b.call("mul", b.lookup("K"), b.input("u")))
    start = ParameterSet([Scalar("K", 100.0), Curve("Outer", [0.0, 1.0, 3.0], [2.0, 5.0, 7.0])])
    model = case(b.finish({"y": y}), 10, free=("K", "Outer"), values=start)
    code = compiled(model, smooth=["K"])
    expected = np.where(model.columns["u"] > 0, 7.0, 2.0)
    residual, _ = code.accumulator(widths=np.array([0.2])).rows(code.values)
    root = np.sqrt(model.criteria[0].scores[0])
    scored = ~np.isnan(model.criteria[0].target)
    wanted = root * (expected - model.criteria[0].target) / model.criteria[0].scale
    np.testing.assert_allclose(residual[scored], wanted[scored], rtol=1e-12)


def test_rows_have_the_weight_of_the_loss():
    code = compiled(case(static(), 50, loss="huber"))
    residual, jacobian = code.accumulator().rows(code.values)
    normal = code.accumulator().normal(code.values)
    close((jacobian.T @ residual, jacobian.T @ jacobian), (normal.gradient, normal.matrix), 1e-13)


def test_states_that_no_free_value_reaches_are_simulated_all_the_same():
    b = GraphBuilder()
    late = b.prev(b.call("sin", b.input("u")), b.input("v"), 2)
    code = compiled(case(b.finish({"y": b.call("mul", late, b.lookup("K"))}), 200, STARTS[:3]))
    assert code.kernel.pattern.carried == 0
    plain = code.interpreter()
    exact = code.run(plain)
    direct = sums(code.case, exact)
    costs, gradient, matrix, *_ = results(code)
    close((costs, gradient, matrix), (direct.costs, direct.gradient, direct.matrix), 1e-13)
    assert_close(exact, exact, spread(plain, code.run), np.ones(exact.shape, bool))


@pytest.mark.parametrize("model", sorted(name for name in MODELS if not MODELS[name]().states))
def test_samples_that_touch_a_value_are_those_with_a_slope(model, monkeypatch):
    code = compiled(case(MODELS[model](), 400, STARTS))
    summed = code.accumulator()
    _, jacobian = summed.rows(code.values)
    per_sample = (jacobian.reshape(summed.samples.count, -1, jacobian.shape[1]) != 0).any(axis=1)
    assert summed.touched(code.values).tolist() == per_sample.sum(axis=0).tolist()
    monkeypatch.setattr(module, "TAPE_BYTES", 1)
    assert code.accumulator().touched(code.values).tolist() == per_sample.sum(axis=0).tolist()


@pytest.mark.parametrize("model", ["static", "lag", "coupled2"])
@pytest.mark.parametrize("order", ["runs", "mixed"])
def test_squares_are_those_of_the_rows_by_group(model, order):
    code = compiled(case(MODELS[model](), 400, STARTS))
    summed = code.accumulator()
    _, jacobian = summed.rows(code.values)
    count = summed.samples.count
    groups = np.arange(count) // 60 - 1 if order == "runs" else np.random.default_rng(0).integers(-1, 4, count)
    each = np.square(jacobian).reshape(count, -1, jacobian.shape[1]).sum(axis=1)
    expected = np.array([each[groups == group].sum(axis=0) for group in range(6)])
    np.testing.assert_allclose(summed.squares(code.values, groups, 6), expected, rtol=1e-12, atol=1e-300)

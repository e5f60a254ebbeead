import tracemalloc

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.graph.interpreter import Interpreter
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.optimize.problem.problem import Problem, difference
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective

GRID = np.linspace(-2, 2, 6)
TEXT = """
base = M(u, v)
m = base * C(w + K) + exp(sin(u)) * K
"""
LAG = TEXT + "lag = PT1(m, abs(K))"


def parameters(seed=0):
    random = np.random.default_rng(seed)
    return kf.ParameterSet(
        [
            kf.Map("M", GRID, GRID[:4], random.standard_normal((6, 4))),
            kf.Curve("C", GRID, random.standard_normal(6)),
            kf.Scalar("K", 0.3),
        ]
    )


def columns(samples, seed=1):
    random = np.random.default_rng(seed)
    channels = {name: random.uniform(-2.5, 2.5, samples) for name in ("u", "v", "w", "y")}
    channels["y"][::11] = np.nan
    return channels


def problem(*datasets, text=TEXT, node="m", **arguments):
    model = kf.formula(text, parameters=list(parameters()))
    return Problem(model, datasets, parameters(), (kf.Criterion(node, "y"),), **arguments)


def reference(posed):
    """The cost by the interpreter, dataset by dataset, in the order of the samples."""
    low = lower_lookups(posed.graph, posed.parameters)
    total = 0.0
    for bound in posed.training:
        run = Interpreter(low, posed.parameters).run(low.graph.nodes, low.graph.states, bound.columns, bound.starts)
        for i, criterion in enumerate(posed.criteria):
            error = run[low.graph.names[difference(i)]] - posed.target(criterion, bound)
            total += criterion.weight * bound.dataset.weight * np.nansum(error**2)
    return total


def cost(posed):
    compiled = CompiledProblem(posed)
    return LeastSquaresObjective(compiled).cost(compiled.start[: compiled.values.free])


@pytest.mark.parametrize("free", [("*",), ("K",), ("C", "K"), ("M",)])
def test_sorting_and_folding_of_data_do_not_change_the_cost(free):
    posed = problem(kf.Dataset.of("d", columns(3000)), free=free)
    assert cost(posed) == pytest.approx(reference(posed), rel=1e-12)


def test_costs_of_datasets_add_up_with_their_weights():
    data = [kf.Dataset.of(f"d{i}", columns(100 + 50 * i, i), weight=0.5 + i) for i in range(3)]
    together = problem(*data)
    assert cost(together) == pytest.approx(sum(cost(problem(one)) for one in data), rel=1e-12)
    assert cost(together) == pytest.approx(reference(together), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "uneven",
    [pytest.param(False, id="even steps", marks=pytest.mark.slow), pytest.param(True, id="uneven steps")],
)
def test_datasets_with_memory_in_several_pieces_have_the_cost_of_the_interpreter(uneven):
    random = np.random.default_rng(5)
    data = []
    for i in range(2):
        channels = columns(200, i)
        channels["u"][[20, 21, 90]] = np.nan
        steps = random.uniform(0.05, 0.2, 200) if uneven else np.full(200, 0.1)
        data.append(
            kf.Dataset.of(f"d{i}", channels, time=np.cumsum(steps), piece_starts=[0, 55], weight=1.0 + i, max_gap=0.25)
        )
    posed = problem(*data, text=LAG, node="lag")
    assert cost(posed) == pytest.approx(reference(posed), rel=1e-11)


def test_an_even_step_is_folded_into_the_function():
    def reads_the_step(time):
        data = kf.Dataset.of("d", columns(50), time=time)
        return "dt" in CompiledProblem(problem(data, text=LAG, node="lag")).kernel.layout.inputs

    assert not reads_the_step(0.1 * np.arange(50))
    assert reads_the_step(np.cumsum(np.random.default_rng(0).uniform(0.1, 0.2, 50)))


def test_samples_that_are_not_scored_do_not_count():
    channels = columns(60)
    scored = np.arange(60) % 3 > 0
    masked = kf.Dataset.of("d", channels, scored=scored)
    remaining = kf.Dataset.of("d", {name: values[scored] for name, values in channels.items()})
    assert cost(problem(masked)) == pytest.approx(cost(problem(remaining)), rel=1e-12)


def test_samples_that_are_not_scored_still_drive_memory():
    channels, time = columns(60), 0.1 * np.arange(60)
    masked = problem(kf.Dataset.of("d", channels, time=time, scored=np.arange(60) > 30), text=LAG, node="lag")
    assert cost(masked) == pytest.approx(reference(masked), rel=1e-12)


def test_points_without_an_input_are_left_out():
    channels = columns(200)
    channels["u"][::7] = channels["v"][5::70] = np.nan
    for text in (TEXT, "m = M(u, v) * prev(C(w), 0) + C(u + K)"):
        posed = problem(kf.Dataset.of("d", channels), kf.Dataset.of("e", columns(100, 2)), text=text, free=("M", "K"))
        assert cost(posed) == pytest.approx(reference(posed), rel=1e-12)


def test_points_whose_target_is_infinite_are_left_out():
    channels = columns(100)
    channels["y"][[4, 7]] = np.inf, -np.inf
    posed = problem(kf.Dataset.of("d", channels))
    assert np.isfinite(reference(posed))
    assert cost(posed) == pytest.approx(reference(posed), rel=1e-12)


def test_data_sorted_by_cell_are_visited_in_their_order():
    text = "m = C(u) + K"
    channels = columns(2000)
    channels["y"][:] = 1.0
    mixed = CompiledProblem(problem(kf.Dataset.of("d", channels), text=text)).samples
    tidy = {name: values[np.argsort(channels["u"])] for name, values in channels.items()}
    assert mixed.order is not None
    assert CompiledProblem(problem(kf.Dataset.of("d", tidy), text=text)).samples.order is None


@pytest.mark.parametrize("time", [None, 0.1 * np.arange(300_000)], ids=["steady", "with memory"])
def test_data_are_not_copied(time):
    text, node = (TEXT, "m") if time is None else (LAG, "lag")
    text = text.replace("exp(sin(u))", "u")

    def most(count):
        dataset = kf.Dataset.of("d", columns(count), time=None if time is None else time[:count])
        return _most(lambda: CompiledProblem(problem(dataset, text=text, node=node)))

    most(10)
    assert most(300_000) - most(10) < 0.6 * sum(values.nbytes for values in columns(300_000).values())


def _most(work):
    """The most memory allocated on the way, in bytes."""
    tracemalloc.start()
    work()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most


def test_test_data_do_not_count_as_training_data():
    training, test = kf.Dataset.of("a", columns(30)), kf.Dataset.of("b", columns(40, 2), use="test")
    assert [bound.dataset.name for bound in problem(training, test).training] == ["a"]


def test_a_position_that_is_undefined_at_some_samples_does_not_warn():
    channels = columns(200)
    posed = problem(kf.Dataset.of("d", channels), text="m = if(u > 0, C(log(u)) + K, K)")
    assert np.isfinite(cost(posed))


def test_thinned_data_weigh_as_much_as_all_data():
    posed = problem(kf.Dataset.of("d", columns(60_000)))
    exact = CompiledProblem(posed)
    smooth = CompiledProblem(posed, smooth_like=exact)
    smooth.set_width(1e-6)
    assert smooth.samples.count < exact.samples.count
    at = exact.start[: exact.values.free]
    assert LeastSquaresObjective(smooth).cost(at) == pytest.approx(LeastSquaresObjective(exact).cost(at), rel=0.1)


def test_gradient_and_matrix_of_both_paths_agree():
    posed = problem(kf.Dataset.of("d", columns(500)), smoothness={"M": (0.3, 0.1), "C": 2.0})
    compiled = CompiledProblem(posed)
    objective, at = LeastSquaresObjective(compiled), compiled.start[: compiled.values.free]
    residual, jacobian = objective.rows(at)
    gradient, matrix = (part.copy() for part in objective.normal(at))
    assert residual @ residual == pytest.approx(objective.cost(at), rel=1e-12)
    np.testing.assert_allclose(jacobian.T @ residual, gradient, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(jacobian.T @ jacobian, matrix, rtol=1e-9, atol=1e-9)

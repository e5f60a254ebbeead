import numpy as np
import pytest
from hypothesis import assume

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.free_axes import free_axes, with_breakpoints
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Cube, Curve, Map, Scalar
from kennfeld.graph import OPERATIONS, GraphBuilder
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.interpreter import Interpreter
from kennfeld.graph.lookup_lowering import lower_lookups
from tests.draws import few_or_many
from tests.graph.noise import assert_close, spread, steady
from tests.graph.random_graphs import cases, sizes_of


def offsets_of(names, parameters):
    sizes = np.cumsum([0, *sizes_of(names, parameters)])
    return dict(zip(names, sizes.tolist(), strict=False))


def rows(graph, parameters, columns, starts=(0,), free=None, smooth=(), widths=()):
    """Values (samples, outputs) and Jacobian of all named nodes."""
    free = tuple(graph.parameters) if free is None else free
    low = lower_lookups(graph, parameters, smooth)
    line = differentiate(low.graph, list(low.graph.names.values()), free)
    arrays = {name: np.asarray(c, dtype=np.float64) for name, c in columns.items()}
    return Interpreter(low, parameters, widths).rows(line, offsets_of(free, parameters), arrays, starts)


def slopes(expression, columns=None, **values):
    """Value and slopes of one expression of scalars, at one sample; `expression(builder, *scalars)`."""
    b = GraphBuilder()
    y = expression(b, *(b.lookup(name) for name in values))
    parameters = ParameterSet([Scalar(name, value) for name, value in values.items()])
    sensitivities = rows(b.finish({"y": y}), parameters, columns or {"x": [0.0]}, free=tuple(values))
    return sensitivities.values[0, 0], sensitivities.jacobian[0, 0].tolist()


def by_differences(graph, parameters, columns, starts, free, h=1e-6):
    """The Jacobian by central differences of the interpreter."""
    low = lower_lookups(graph, parameters)
    outputs = list(low.graph.names.values())
    columns_found = []
    for name in free:
        for i in np.ndindex(parameters[name].values.shape):
            sides = []
            for sign in (1, -1):
                values = parameters[name].values.copy()
                values[i] += sign * h
                moved = parameters.with_parameters(parameters[name].with_values(values))
                run = Interpreter(low, moved).run(low.graph.nodes, low.graph.states, columns, starts)
                sides.append(np.array([run[at] for at in outputs]).T)
            columns_found.append((sides[0] - sides[1]) / (2 * h))
    return np.stack(columns_found, axis=2)


# `single` moves in steps of 1e-8 of its argument, which differences over 1e-6 see; its slope is that of the argument
CONTINUOUS = [op for op in sorted(OPERATIONS) if op != "single"]
POINTS = {1: [(0.35,), (0.8,)], 2: [(0.7, 0.4), (0.3, 1.7)], 3: [(1.0, 0.4, 2.0), (0.0, 0.4, 2.0)]}


@pytest.mark.parametrize("op", CONTINUOUS)
def test_every_operation_on_parameters_has_the_slopes_of_finite_differences(op):
    names = "abc"[: OPERATIONS[op].arity]
    for point in POINTS[len(names)]:
        values = dict(zip(names, point, strict=True))
        value, gradient = slopes(lambda b, *args: b.call(op, *args), **values)
        assert value == pytest.approx(float(OPERATIONS[op].evaluate(*point)), rel=1e-14)
        for i, slope in enumerate(gradient):
            if op == "select" and i == 0:
                assert slope == 0.0
                continue
            up, down = ([v + s * 1e-6 * (i == j) for j, v in enumerate(point)] for s in (1, -1))
            expected = float(OPERATIONS[op].evaluate(*up) - OPERATIONS[op].evaluate(*down)) / 2e-6
            assert slope == pytest.approx(expected, rel=1e-7, abs=1e-8), point


@pytest.mark.parametrize("op", [op for op in CONTINUOUS if OPERATIONS[op].arity < 3])
def test_operations_chain(op):
    def expression(b, k, m):
        inner = b.call("add", b.call("mul", k, m), b.const(0.1))
        return b.call("mul", b.call(op, *[inner, m][: OPERATIONS[op].arity]), k)

    def value(k, m):
        return k * float(OPERATIONS[op].evaluate(*[k * m + 0.1, m][: OPERATIONS[op].arity]))

    _, gradient = slopes(expression, k=0.7, m=0.9)
    h = 1e-6
    expected = [
        (value(0.7 + h, 0.9) - value(0.7 - h, 0.9)) / (2 * h),
        (value(0.7, 0.9 + h) - value(0.7, 0.9 - h)) / (2 * h),
    ]
    assert gradient == pytest.approx(expected, rel=1e-7, abs=1e-8)


@pytest.mark.parametrize("op", ["exp", "sin", "cos", "sinh", "cosh", "tanh", "atan", "log", "sqrt", "tan", "asin"])
def test_elementary_functions_have_the_slopes_of_complex_steps(op):
    function = {"asin": np.arcsin, "atan": np.arctan}.get(op) or getattr(np, op)
    for x in (0.2, 0.55, 0.9):
        _, (slope,) = slopes(lambda b, a: b.call(op, a), a=x)
        assert slope == pytest.approx(np.imag(function(x + 1e-30j)) / 1e-30, rel=1e-14)


def test_the_slope_of_abs_at_zero_is_zero():
    assert slopes(lambda b, a: b.call("abs", a), a=0.0)[1] == [0.0]


@pytest.mark.parametrize("op", ["min", "max"])
def test_a_tie_takes_the_first_argument(op):
    assert slopes(lambda b, c, d: b.call(op, c, d), c=2.0, d=2.0)[1] == [1.0, 0.0]


@pytest.mark.parametrize("op", ["floor", "ceil", "round", "sign", "not"])
def test_a_step_has_slope_zero(op):
    assert slopes(lambda b, a: b.call(op, a), a=0.7)[1] == [0.0]


def test_a_number_rounded_to_single_precision_has_the_slope_of_the_number():
    rounded = float(np.float32(0.7))
    assert slopes(lambda b, a: b.call("single", a), a=0.7) == (rounded, [1.0])

    def chain(b, a):
        return b.call("mul", b.call("single", b.call("mul", a, b.const(3.0))), a)

    value, gradient = slopes(chain, a=0.7)
    tripled = float(np.float32(3.0 * 0.7))
    assert (value, gradient) == (tripled * 0.7, pytest.approx([tripled + 3.0 * 0.7], rel=1e-15))


def test_an_infinite_slope_of_a_rounded_number_beside_a_factor_zero_is_zero():
    def expression(b, a):
        infinite = b.call("single", b.call("exp", b.call("mul", a, b.const(1000.0))))
        return b.call("exp", b.call("neg", b.call("mul", a, infinite)))

    assert slopes(expression, a=2.0) == (0.0, [0.0])


def test_a_condition_alone_has_slope_zero():
    def expression(b, a):
        return b.call("select", b.call("gt", a, b.const(0.5)), b.const(1.0), b.const(2.0))

    assert slopes(expression, a=0.7) == (1.0, [0.0])


def test_a_parameter_in_a_condition_and_in_a_branch_has_the_slope_of_the_branch():
    def expression(b, a):
        return b.call("select", b.call("gt", a, b.const(0.5)), b.call("mul", a, b.const(3.0)), a)

    assert slopes(expression, a=0.7)[1] == [3.0]
    assert slopes(expression, a=0.2)[1] == [1.0]


@pytest.mark.parametrize(
    ("op", "at"), [("sqrt", 0.0), ("sqrt", -1.0), ("log", 0.0), ("log", -1.0), ("log10", -1.0), ("asin", -3.0)]
)
def test_a_branch_not_taken_leaks_nothing(op, at):
    def expression(b, x):
        return b.call("select", b.call("gt", x, b.const(0.0)), b.call(op, x), b.call("mul", x, b.const(2.0)))

    assert slopes(expression, x=at) == (2 * at, [2.0])


def test_a_division_by_zero_in_a_branch_not_taken_leaks_nothing():
    def expression(b, x, k):
        return b.call("select", b.call("ne", x, b.const(0.0)), b.call("div", k, x), k)

    assert slopes(expression, x=0.0, k=3.0) == (3.0, [0.0, 1.0])
    assert slopes(expression, x=2.0, k=3.0) == (1.5, [-0.75, 0.5])


def test_nothing_leaks_through_a_chain_behind_a_branch():
    def expression(b, x, k):
        deep = b.call("mul", b.call("exp", b.call("div", k, b.call("sqrt", x))), b.call("log", x))
        return b.call("select", b.call("gt", x, b.const(0.0)), deep, k)

    assert slopes(expression, x=-1.0, k=3.0) == (3.0, [0.0, 1.0])
    assert slopes(expression, x=0.0, k=3.0) == (3.0, [0.0, 1.0])


def test_nothing_leaks_through_nested_branches():
    def expression(b, x, k):
        inner = b.call("select", b.call("gt", x, b.const(-0.5)), b.call("log", x), b.call("sqrt", x))
        return b.call("select", b.call("gt", x, b.const(0.0)), b.call("mul", inner, k), b.call("mul", k, k))

    assert slopes(expression, x=-1.0, k=3.0) == (9.0, [0.0, 6.0])
    assert slopes(expression, x=-0.2, k=3.0) == (9.0, [0.0, 6.0])


def test_nothing_leaks_from_the_losing_side_of_an_extreme():
    def expression(b, x, k):
        return b.call("max", b.call("neg", b.call("exp", b.call("div", b.const(1.0), x))), k)

    value, gradient = slopes(expression, x=1e-4, k=3.0)
    assert value == 3.0
    assert gradient == [0.0, 1.0]


def test_a_value_used_in_both_branches_and_outside_sums_its_slopes():
    def expression(b, x):
        y = b.call("mul", x, x)
        chosen = b.call("select", b.call("gt", x, b.const(0.0)), b.call("sqrt", y), b.call("neg", y))
        return b.call("add", chosen, y)

    assert slopes(expression, x=2.0)[1] == pytest.approx([5.0])
    assert slopes(expression, x=-2.0)[1] == pytest.approx([0.0])


def test_a_power_of_exponent_zero_has_slope_zero_even_at_zero():
    assert slopes(lambda b, a: b.call("pow", a, b.const(0.0)), a=0.0) == (1.0, [0.0])


def logistic(b, k, x):
    return b.call("div", b.const(1.0), b.call("add", b.const(1.0), b.call("exp", b.call("neg", b.call("mul", k, x)))))


@pytest.mark.parametrize("x", [-300.0, -5.0, -0.5, 0.0, 0.4, 300.0])
def test_a_logistic_function_saturates_without_leaving_its_range(x):
    value, gradient = slopes(lambda b, k: logistic(b, k, b.const(x)), k=4.0)
    half = 1 / np.cosh(np.clip(2 * x, -350, 350)) ** 2 / 4  # y (1 - y)
    assert value == pytest.approx((1 + np.tanh(2 * x)) / 2, abs=1e-15)
    assert gradient == pytest.approx([x * half], rel=1e-12, abs=1e-100)


def nozzle(b, k, p0, p):
    ratio = b.call("pow", b.call("div", p0, b.call("max", p, p0)), k)
    return b.call("sqrt", b.call("max", b.call("sub", b.const(1.0), ratio), b.const(0.0)))


@pytest.mark.parametrize("p", [0.5, 1.0])
def test_a_nozzle_without_flow_has_slope_zero(p):
    assert slopes(lambda b, k, p0: nozzle(b, k, p0, b.const(p)), k=0.3, p0=1.0) == (0.0, [0.0, 0.0])


def test_a_nozzle_with_flow_has_the_slopes_of_its_formula():
    value, gradient = slopes(lambda b, k, p0: nozzle(b, k, p0, b.const(2.0)), k=0.3, p0=1.0)
    ratio = 0.5**0.3
    assert value == pytest.approx((1 - ratio) ** 0.5)
    assert gradient == pytest.approx([-ratio * np.log(0.5) / (2 * value), -0.3 * ratio / (2 * value)])


SATURATED = {
    "root of a quantity cut at 0": lambda b, k: b.call(
        "sqrt", b.call("max", b.call("sub", k, b.const(1.0)), b.const(0.0))
    ),
    "power of one": lambda b, k: b.call(
        "pow", b.call("max", b.const(0.0), b.call("sub", k, b.const(1.0))), b.const(0.5)
    ),
    "arc sine of a quantity cut at 1": lambda b, k: b.call("asin", b.call("min", k, b.const(1.0))),
    "arc cosine of one": lambda b, k: b.call("acos", b.call("max", b.call("neg", k), b.const(-1.0))),
    "root of what a cut ratio leaves": lambda b, k: b.call(
        "sqrt", b.call("sub", b.const(1.0), b.call("pow", b.call("min", k, b.const(1.0)), b.const(2.0)))
    ),
    "root of an absolute value": lambda b, k: b.call("sqrt", b.call("abs", b.call("sub", k, b.const(1.0)))),
    "root of a rounded quantity cut at 0": lambda b, k: b.call(
        "sqrt", b.call("single", b.call("max", b.call("sub", k, b.const(1.0)), b.const(0.0)))
    ),
    "root of a condition": lambda b, k: b.call(
        "sqrt", b.call("select", b.call("ge", k, b.const(1.0)), b.call("sub", k, b.const(1.0)), b.const(0.0))
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SATURATED)
def test_at_an_edge_with_one_finite_slope_a_saturated_quantity_has_that_one(name):
    assert slopes(SATURATED[name], k=1.0)[1] == [0.0]


def test_a_root_that_is_not_saturated_has_an_infinite_slope_at_zero():
    assert slopes(lambda b, k: b.call("sqrt", b.call("sub", k, b.const(1.0))), k=1.0)[1] == [np.inf]


@pytest.mark.parametrize("op", ["max", "min"])
def test_a_tie_off_an_edge_has_the_slope_of_the_first_argument(op):
    root = slopes(lambda b, k: b.call("sqrt", b.call(op, k, b.const(4.0))), k=4.0)
    assert root == (2.0, [0.25])


def test_an_infinite_slope_of_a_factor_zero_is_zero():
    assert slopes(lambda b, k: b.call("sqrt", b.call("mul", k, b.input("x"))), {"x": [0.0]}, k=2.0) == (0.0, [0.0])
    inverse = slopes(lambda b, k: b.call("exp", b.call("neg", b.call("div", k, b.input("x")))), {"x": [0.0]}, k=2.0)
    assert inverse == (0.0, [0.0])


def test_a_value_that_is_not_finite_shows():
    assert np.isnan(slopes(lambda b, x: b.call("log", x), x=-1.0)[0])
    assert slopes(lambda b, x: b.call("div", b.const(1.0), x), x=0.0)[0] == np.inf


def test_a_nan_input_affects_only_the_branch_that_uses_it():
    b = GraphBuilder()
    x, k = b.input("x"), b.lookup("K")
    y = b.call("select", b.call("eq", x, x), b.call("mul", x, k), k)
    sensitivities = rows(b.finish({"y": y}), ParameterSet([Scalar("K", 2.0)]), {"x": [3.0, np.nan]})
    assert sensitivities.values[:, 0].tolist() == [6.0, 2.0]
    assert sensitivities.jacobian[:, 0, 0].tolist() == [3.0, 1.0]


def test_the_slopes_of_a_table_are_its_weights():
    b = GraphBuilder()
    y = b.lookup("M", b.input("x"), b.input("z"))
    table = Map("M", [0, 1, 3], [0, 10], [[0, 1], [2, 3], [4, 5]])
    sensitivities = rows(b.finish({"y": y}), ParameterSet([table]), {"x": [1.5, -1.0], "z": [2.0, 20.0]})
    assert sensitivities.jacobian[0, 0] == pytest.approx([0, 0, 0.6, 0.15, 0.2, 0.05])
    assert sensitivities.jacobian[1, 0] == pytest.approx([0, 1, 0, 0, 0, 0])


@pytest.mark.parametrize(("extrapolation", "slope"), [("clip", 0.0), ("linear", 2.0)])
@pytest.mark.parametrize("x", [-1.0, 3.5])
def test_a_clipped_lookup_has_slope_zero(extrapolation, slope, x):
    b = GraphBuilder()
    y = b.lookup("C", b.lookup("K"))
    parameters = ParameterSet([Scalar("K", x), Curve("C", [0, 1, 3], [0, 2, 6], extrapolation=extrapolation)])
    assert rows(b.finish({"y": y}), parameters, {"x": [0.0]}, free=("K",)).jacobian[0, 0, 0] == slope


def test_a_lookup_on_a_breakpoint_has_the_slope_of_the_cell_to_its_right():
    b = GraphBuilder()
    y = b.lookup("C", b.lookup("K"))
    for x, slope in ((0.0, 2.0), (1.0, 5.0), (3.0, 5.0)):
        parameters = ParameterSet([Scalar("K", x), Curve("C", [0, 1, 3], [0, 2, 12])])
        assert rows(b.finish({"y": y}), parameters, {"x": [0.0]}, free=("K",)).jacobian[0, 0, 0] == slope


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
def test_a_lookup_of_parameters_has_the_slopes_of_finite_differences(dimensions):
    random = np.random.default_rng(dimensions)
    axes = [np.cumsum(random.uniform(0.3, 1.0, 3)) - 1.0 for _ in range(dimensions)]
    values = random.standard_normal((3,) * dimensions)
    make = [None, Curve, Map][dimensions] if dimensions < 3 else None
    table = make("T", *axes, values) if make else Cube("T", axes, values)
    b = GraphBuilder()
    coordinates = [
        b.call("add", b.input("x"), b.call("mul", b.lookup(f"K{i}"), b.input("z"))) for i in range(dimensions)
    ]
    graph = b.finish({"y": b.lookup("T", *coordinates)})
    parameters = ParameterSet([table, *(Scalar(f"K{i}", 0.3 * i + 0.2) for i in range(dimensions))])
    columns = {"x": random.uniform(-1, 1, 20), "z": random.uniform(-1, 1, 20)}
    free = tuple(parameters)
    jacobian = rows(graph, parameters, columns, free=free).jacobian
    np.testing.assert_allclose(jacobian, by_differences(graph, parameters, columns, (0,), free), atol=1e-7)


def test_two_lookups_of_one_table_sum_their_slopes():
    b = GraphBuilder()
    y = b.call("mul", b.lookup("C", b.input("x")), b.lookup("C", b.input("z")))
    parameters = ParameterSet([Curve("C", [0, 1], [2.0, 3.0])])
    gradient = rows(b.finish({"y": y}), parameters, {"x": [0.25], "z": [0.5]}).jacobian[0, 0]
    assert gradient == pytest.approx([0.75 * 2.5 + 0.5 * 2.25, 0.25 * 2.5 + 0.5 * 2.25])


def test_a_fixed_parameter_has_no_slopes():
    b = GraphBuilder()
    low = lower_lookups(
        b.finish({"y": b.call("mul", b.lookup("K"), b.lookup("L"))}), ParameterSet([Scalar("K", 2), Scalar("L", 3)])
    )
    line = differentiate(low.graph, [low.graph.names["y"]], ["K"])
    assert [line.nodes[at].payload.name for at in line.atoms] == ["K"]


def test_states_that_no_free_parameter_reaches_are_not_carried():
    b = GraphBuilder()
    data, model = b.prev(b.input("x"), b.const(0.0)), b.prev(b.lookup("K"), b.const(0.0))
    low = lower_lookups(b.finish({"y": b.call("add", data, model)}), ParameterSet([Scalar("K", 2.0)]))
    line = differentiate(low.graph, [low.graph.names["y"]], ["K"])
    assert [low.graph.nodes[low.graph.states[i].next].op for i in line.carried] == ["interpolate"]
    assert differentiate(low.graph, [low.graph.names["y"]], []).carried == ()


def test_sensitivities_run_through_feedback():
    b = GraphBuilder()
    state = b.state()
    b.close(state, b.const(1.0), b.call("mul", state, b.lookup("K")))
    sensitivities = rows(b.finish({"y": state}), ParameterSet([Scalar("K", 0.5)]), {"x": np.zeros(5)})
    powers = np.arange(5)
    assert sensitivities.values[:, 0] == pytest.approx(0.5**powers)
    assert sensitivities.jacobian[:, 0, 0] == pytest.approx(powers * 0.5 ** (powers - 1.0))


def test_a_delay_carries_its_sensitivity_for_as_many_steps():
    b = GraphBuilder()
    y = b.prev(b.call("mul", b.lookup("K"), b.input("x")), b.lookup("L"), 3)
    parameters = ParameterSet([Scalar("K", 2.0), Scalar("L", 7.0)])
    sensitivities = rows(
        b.finish({"y": y}), parameters, {"x": [1.0, 2.0, 3.0, 4.0, 5.0]}, starts=(0, 4), free=("K", "L")
    )
    assert sensitivities.values[:, 0].tolist() == [7.0, 7.0, 7.0, 2.0, 7.0]
    assert sensitivities.jacobian[:, 0].tolist() == [[0, 1], [0, 1], [0, 1], [1, 0], [0, 1]]


def test_first_values_may_depend_on_other_states_first_values():
    b = GraphBuilder()
    one = b.prev(b.const(5.0), b.lookup("K"))
    two = b.prev(b.const(6.0), b.call("mul", one, b.lookup("K")), 2)
    sensitivities = rows(b.finish({"y": two}), ParameterSet([Scalar("K", 3.0)]), {"x": np.zeros(4)})
    assert sensitivities.values[:, 0].tolist() == [9.0, 9.0, 6.0, 6.0]
    assert sensitivities.jacobian[:, 0, 0].tolist() == [6.0, 6.0, 0.0, 0.0]


def test_a_first_value_that_depends_on_itself_is_an_error():
    b = GraphBuilder()
    one, two = b.state(), b.state()
    b.close(one, two, b.const(0.0))
    b.close(two, one, b.const(0.0))
    graph = b.finish({"y": one})
    with pytest.raises(ArgumentError, match="first value of a state depends on itself"):
        differentiate(graph, [graph.names["y"]], [])


def test_derivatives_extend_the_nodes_of_the_graph():
    b = GraphBuilder()
    low = lower_lookups(b.finish({"y": b.call("sin", b.lookup("K"))}), ParameterSet([Scalar("K", 2.0)]))
    line = differentiate(low.graph, [low.graph.names["y"]], ["K"])
    assert line.nodes[: len(low.graph.nodes)] == low.graph.nodes
    assert all(a < at for at, node in enumerate(line.nodes) for a in node.args)


@pytest.mark.slow
def test_a_long_chain_needs_no_recursion():
    def expression(b, x):
        for _ in range(1100):
            x = b.call("add", b.call("mul", x, b.const(0.5)), b.const(1.0))
        return x

    assert slopes(expression, x=1.0) == (2.0, [0.0])


@few_or_many(cases(max_outputs=2), few=8, many=40)
def test_random_models_have_the_slopes_of_finite_differences(case):
    low = lower_lookups(case.graph, case.parameters)
    # differences see the steps of `single`
    assume(all(node.op != "single" for node in low.graph.nodes))
    line = differentiate(low.graph, list(low.graph.names.values()), case.fitted)
    plain = Interpreter(low, case.parameters)

    def values(interpreter):
        run = interpreter.run(low.graph.nodes, low.graph.states, case.columns, case.starts)
        return np.array([run[at] for at in low.graph.names.values()]).T

    exact = values(plain)
    change = spread(plain, values, exact)
    usable = steady(exact, change) & np.isfinite(exact) & (change < 1e-10)
    assume(usable.any())
    random = np.random.default_rng(case.seed)
    direction = {n: random.standard_normal(case.parameters[n].values.shape) for n in case.free}
    moves = {key: random.standard_normal(len(free_axes(case.parameters)[key].axis)) for key in case.axes}

    def moved(h):
        changed = [case.parameters[n].with_values(case.parameters[n].values + h * direction[n]) for n in case.free]
        points = {key: free_axes(case.parameters)[key].axis.breakpoints + h * moves[key] for key in case.axes}
        moved_parameters = with_breakpoints(case.parameters.with_parameters(*changed), points)
        return values(Interpreter(low, moved_parameters))

    flat = np.concatenate([move.ravel() for move in (direction | moves).values()])
    sensitivities = plain.rows(line, offsets_of(case.fitted, case.parameters), case.columns, case.starts)
    with np.errstate(all="ignore"):
        slope = sensitivities.jacobian @ flat
        # differences of several widths that agree mean that no kink lies between
        sides = np.array([[moved(h) - exact, exact - moved(-h)] for h in (1e-5, 3e-6)])
        quotients = sides / np.array([1e-5, 3e-6])[:, None, None, None]
        expected = quotients.mean(axis=1)[1]
        gap = np.ptp(quotients, axis=(0, 1)) + change / 3e-6
        smooth = usable & (gap < 1e-3 * (1 + np.abs(expected)))
    np.testing.assert_allclose(sensitivities.values, exact, rtol=1e-14)
    assert_close(slope, expected, gap + 1e-9 * (1 + np.abs(expected)), smooth, "slope")


@pytest.mark.slow
@few_or_many(cases(states=True, kinks=False, nan=False, max_outputs=1), few=2, many=12)
def test_more_free_parameters_do_not_change_the_slopes_of_others(case):
    low = lower_lookups(case.graph, case.parameters)
    roots = list(low.graph.names.values())
    plain = Interpreter(low, case.parameters)
    every = tuple(case.parameters)
    offsets = offsets_of(every, case.parameters)
    whole = plain.rows(differentiate(low.graph, roots, every), offsets, case.columns, case.starts)
    finite = np.isfinite(whole.values).all(axis=1)
    jacobian = whole.jacobian[finite]
    for name in every:
        only = plain.rows(differentiate(low.graph, roots, [name]), {name: 0}, case.columns, case.starts).jacobian[
            finite
        ]
        part = jacobian[:, :, offsets[name] : offsets[name] + case.parameters[name].size]
        size = np.max(np.abs(jacobian[np.isfinite(jacobian)]), initial=1.0)
        np.testing.assert_allclose(part, only, rtol=1e-9, atol=1e-11 * size)

"""Networks as models and functions, against onnxruntime, finite differences, and each other."""

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")

from onnx import TensorProto, helper

import kennfeld as kf
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.importers.onnx.importing import read_function
from kennfeld.models.formula import formula
from kennfeld.models.formula.printer import to_text
from tests.importers.onnx.networks import perceptron, random_layers, save

ACTIVATIONS = {
    "Relu": {}, "LeakyRelu": {"alpha": 0.1}, "Elu": {"alpha": 0.8}, "Tanh": {}, "Sigmoid": {}, "Selu": {},
    "Softplus": {}, "Softsign": {}, "HardSigmoid": {}, "Celu": {"alpha": 0.7}, "Erf": {}, "Mish": {},
}  # fmt: skip


def columns(count, inputs, seed=1, kind=np.float64):
    return np.random.default_rng(seed).standard_normal((count, inputs)).astype(kind)


def simulated(path, x, parameters=None):
    model = kf.onnx(path)
    data = {name: x[:, i].astype(np.float64) for i, name in enumerate(model.graph.inputs)}
    result = kf.simulate(model, data, parameters or model.values)
    return np.stack([result[name].values for name in model.graph.outputs], axis=1)


def runtime(path, x):
    onnxruntime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    return session.run(None, {"x": x})[0].reshape(len(x), -1)


@pytest.mark.parametrize("form", ["Gemm", "MatMul"])
@pytest.mark.parametrize(("kind", "tolerance"), [(np.float64, 1e-12), (np.float32, 1e-6)])
def test_outputs_are_those_of_onnxruntime(tmp_path, form, kind, tolerance):
    path = perceptron(tmp_path / "net.onnx", random_layers([4, 64, 64, 2], kind=kind), form=form, kind=kind)
    x = columns(200, 4, kind=kind)
    np.testing.assert_allclose(simulated(path, x), runtime(path, x), rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("bias", [[[10.0], [20.0]], [[1.0, 2.0], [3.0, 4.0]]], ids=["a column", "a matrix"])
def test_a_bias_of_several_rows_is_added_row_by_row(tmp_path, bias):
    weights = np.array([[1.0, -2.0], [0.5, 3.0], [4.0, -1.0]])
    nodes = [helper.make_node("Gemm", ["x", "w", "b"], ["y"])]
    path = save(tmp_path / "net.onnx", nodes, {"x": [2, 3]}, {"y": [2, 2]}, {"w": weights, "b": np.array(bias)})
    x = columns(5, 6)
    expected = x.reshape(5, 2, 3) @ weights + np.array(bias)
    np.testing.assert_allclose(simulated(path, x), expected.reshape(5, 4), rtol=1e-12)


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_activations_are_those_of_onnxruntime(tmp_path, activation):
    layers = random_layers([3, 9, 2], kind=np.float32)
    path = perceptron(tmp_path / "net.onnx", layers, activation, kind=np.float32, **ACTIVATIONS[activation])
    x = 3 * columns(100, 3, kind=np.float32)
    np.testing.assert_allclose(simulated(path, x), runtime(path, x), rtol=2e-6, atol=2e-6)


@pytest.mark.parametrize("activation", ["Relu", "LeakyRelu", "Elu", "Tanh", "Sigmoid"])
@pytest.mark.parametrize("form", ["Gemm", "MatMul"])
def test_layers_give_the_same_as_the_network_written_out(tmp_path, activation, form):
    layers = random_layers([3, 17, 5, 2])
    x = 2 * columns(100, 3)
    fused = simulated(perceptron(tmp_path / "fused.onnx", layers, activation, form=form), x)
    path = perceptron(tmp_path / "written.onnx", layers, activation, form="written")
    assert not kf.onnx(path).graph.parameters
    np.testing.assert_allclose(fused, simulated(path, x), rtol=1e-12, atol=1e-13)


def test_both_paths_calibrate_a_map_before_the_network_alike(tmp_path):
    layers, x = random_layers([2, 12, 1]), np.linspace(-1, 1, 60)
    results = []
    for form in ("Gemm", "written"):
        net = read_function(perceptron(tmp_path / f"{form}.onnx", layers, form=form), name="net")
        model = formula("y = net(C(u), v)", functions=[net], parameters=["C", *net.values])
        data = {"u": x, "v": np.cos(3 * x), "target": np.sin(2 * x)}
        start = net.values.with_parameters(kf.Curve("C", [-1.0, 0.0, 1.0], [0.1, 0.2, 0.3]))
        results.append(kf.calibrate(model, data, start, "target").parameters["C"].values)
    np.testing.assert_allclose(results[0], results[1], rtol=1e-7)


def test_elements_are_named_by_their_place(tmp_path):
    nodes = [helper.make_node("Add", ["a", "b"], ["sum"]), helper.make_node("ReduceSum", ["sum"], ["total"])]
    path = save(tmp_path / "net.onnx", nodes, {"a": [1, 2], "b": [1]}, {"sum": [1, 2], "total": [1, 1]})
    model = kf.onnx(path)
    assert model.graph.inputs == ("a[0]", "b", "a[1]")
    assert model.graph.outputs == ("sum[0]", "sum[1]", "total")
    function = read_function(path, name="net")
    assert [each.name for each in function.inputs] == ["a.0", "a.1", "b"]
    assert list(function.calls) == ["net.sum.0", "net.sum.1", "net.total"]
    result = kf.simulate(formula("y = net.sum.1(1, u, 5)", functions=[function]), {"u": [2.0, 3.0]}, {})
    assert result["y"].values.tolist() == [7.0, 8.0]


def test_weights_are_blocks_that_stay_unless_they_are_freed(tmp_path):
    (weights, biases), _ = layers = random_layers([2, 3, 1])
    path = perceptron(tmp_path / "net.onnx", layers)
    model = kf.onnx(path)
    np.testing.assert_array_equal(model.values["layer1"].values, np.vstack([weights, biases]))
    x = columns(40, 2)
    data = {"x[0]": x[:, 0], "x[1]": x[:, 1], "target": np.tanh(x[:, 0]) - 0.3 * x[:, 1]}
    with pytest.raises(InputError, match="free"):
        kf.calibrate(model, data, model.values, "target")
    free = kf.onnx(path, fit=True)
    fitted = kf.calibrate(free, data, free.values, "target", free=["layer2"])
    assert fitted.parameters["layer1"] == free.values["layer1"]
    assert not np.array_equal(fitted.parameters["layer2"].values, free.values["layer2"].values)
    whole = kf.calibrate(free, data, free.values, "target")
    assert whole.quality[0].rmse_after < 0.3 * fitted.quality[0].rmse_after


@pytest.mark.slow
def test_a_network_between_maps_is_calibrated_with_them(tmp_path):
    """The maps are found again that made the data, with the network as it is."""
    net = read_function(perceptron(tmp_path / "net.onnx", random_layers([2, 8, 8, 1])), name="net")
    text = "raw = net(Before(u, v), w)\ny[Nm] = After(raw) + K * v"
    model = formula(text, functions=[net], parameters=["Before", "After", "K", *net.values])
    grid = [-1.0, 0.0, 1.0]
    true = [
        kf.Map("Before", grid, grid, [[-1.0, -0.4, 0.2], [-0.6, 0.3, 0.9], [0.1, 0.8, 1.5]]),
        kf.Curve("After", [-2.0, 0.0, 2.0], [-3.0, 0.5, 2.0]),
        kf.Scalar("K", 0.7),
    ]
    random = np.random.default_rng(5)
    data = {name: random.uniform(-1, 1, 300) for name in "uvw"}
    exact = net.values.with_parameters(*true)
    data["target"] = kf.simulate(model, data, exact)["y"].values
    start = exact.with_parameters(
        true[0].with_values(true[0].values * 0.8 + 0.05), true[1].with_values([-2.5, 0.3, 1.5]), kf.Scalar("K", 0.2)
    )
    result = kf.calibrate(model, data, start, "target")
    for parameter in true:
        np.testing.assert_allclose(result.parameters[parameter.name].values, parameter.values, rtol=1e-5, atol=1e-5)
    assert all(result.parameters[name] == block for name, block in net.values.items())


def test_a_network_of_scikit_learn_with_scaling_gives_its_predictions(tmp_path):
    neural = pytest.importorskip("sklearn.neural_network", reason="scikit-learn is not installed")
    skl2onnx = pytest.importorskip("skl2onnx", reason="skl2onnx is not installed")
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    x = columns(300, 3) * [100.0, 5.0, 0.1]
    y = np.sin(x[:, 0] / 100) + x[:, 1] * x[:, 2]
    regressor = neural.MLPRegressor(
        hidden_layer_sizes=(12, 8), activation="tanh", solver="lbfgs", max_iter=100, tol=1.0, random_state=0
    )
    pipeline = make_pipeline(StandardScaler(), regressor).fit(x, y)
    types = [("x", skl2onnx.common.data_types.DoubleTensorType([None, 3]))]
    path = tmp_path / "net.onnx"
    path.write_bytes(skl2onnx.to_onnx(pipeline, initial_types=types, target_opset=18).SerializeToString())
    np.testing.assert_allclose(simulated(path, x)[:, 0], pipeline.predict(x), rtol=1e-6, atol=1e-6)


def test_trees_of_scikit_learn_give_its_predictions_and_a_remark(tmp_path):
    ensemble = pytest.importorskip("sklearn.ensemble", reason="scikit-learn is not installed")
    skl2onnx = pytest.importorskip("skl2onnx", reason="skl2onnx is not installed")
    x = columns(200, 3, kind=np.float32)
    forest = ensemble.RandomForestRegressor(8, max_depth=5, random_state=0).fit(x, x[:, 0] * x[:, 1])
    path = tmp_path / "net.onnx"
    path.write_bytes(skl2onnx.to_onnx(forest, x[:1], target_opset=18).SerializeToString())
    np.testing.assert_allclose(simulated(path, x)[:, 0], forest.predict(x), rtol=1e-5, atol=1e-6)
    assert any("derivative is 0" in str(remark) for remark in kf.onnx(path).remarks)


def test_single_precision_is_remarked(tmp_path):
    path = perceptron(tmp_path / "net.onnx", random_layers([1, 2, 1], kind=np.float32), kind=np.float32)
    (remark,) = kf.onnx(path).remarks
    assert "computed in double" in str(remark)
    assert not kf.onnx(perceptron(tmp_path / "double.onnx", random_layers([1, 2, 1]))).remarks


def kernel_sum(path, points, weights, kind):
    """A Gaussian process as exporters write it: distances to points by a loop, a kernel of each, and their sum."""
    real = helper.np_dtype_to_tensor_dtype(np.dtype(kind))
    size, columns = points.shape
    ports = {"all": [size, columns], "row": [columns], "all_out": [size, columns], "squares": [size]}
    values = {name: helper.make_tensor_value_info(name, real, shape) for name, shape in ports.items()}
    nodes = [
        helper.make_node("Identity", ["all"], ["all_out"]),
        helper.make_node("Sub", ["all", "row"], ["apart"]),
        helper.make_node("ReduceSumSquare", ["apart", "axis"], ["squares"], keepdims=0),
    ]
    axis = helper.make_tensor("axis", TensorProto.INT64, [1], [1])
    body = helper.make_graph(
        nodes, "body", [values["all"], values["row"]], [values["all_out"], values["squares"]], [axis]
    )
    steps = [
        helper.make_node("Scan", ["points", "x"], ["end", "d"], body=body, num_scan_inputs=1),
        helper.make_node("Mul", ["d", "factor"], ["scaled"]),
        helper.make_node("Exp", ["scaled"], ["kernels"]),
        helper.make_node("MatMul", ["kernels", "weights"], ["y"]),
    ]
    constants = {"points": points, "factor": np.array(-0.5), "weights": weights}
    constants = {name: array.astype(kind) for name, array in constants.items()}
    return save(path, steps, {"x": [1, columns]}, {"y": [1, 1]}, constants, kind=kind)


def test_a_gaussian_process_in_single_precision_is_remarked_upon_and_nearer_than_sums_in_single(tmp_path):
    points, x = columns(50, 2), columns(40, 2, seed=2, kind=np.float32).astype(np.float64)
    kernels = [np.exp(-0.5 * ((points[:, None] - each) ** 2).sum(axis=-1)) for each in (points, x)]
    weights = np.linalg.solve(kernels[0] + 1e-6 * np.eye(50), np.sin(points[:, :1]))
    path = kernel_sum(tmp_path / "process.onnx", points, weights, np.float32)
    (remark,) = kf.onnx(path).remarks
    assert f"weights in single precision that amount to {np.abs(weights).sum():.2g} and cancel" in str(remark)
    exact = (kernels[1].T @ weights).ravel()
    single = (kernels[1].T.astype(np.float32) @ weights.astype(np.float32)).ravel()
    error = np.abs(simulated(path, x).ravel() - exact).max()
    assert error < np.abs(single - exact).max()
    double = kernel_sum(tmp_path / "double.onnx", points, weights, np.float64)
    assert not kf.onnx(double).remarks
    np.testing.assert_allclose(simulated(double, x).ravel(), exact, rtol=1e-9, atol=1e-9)


def test_a_network_cannot_be_written_as_formula_text(tmp_path):
    graph = kf.onnx(perceptron(tmp_path / "net.onnx", random_layers([1, 2, 1]))).graph
    with pytest.raises(ArgumentError, match="cannot be written as formula text: layer1, layer2"):
        to_text(graph)

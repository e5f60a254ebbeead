"""Models of scikit-learn, XGBoost and LightGBM, as their converters write them, against these packages."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")
pytest.importorskip("sklearn", reason="scikit-learn is not installed")
pytest.importorskip("skl2onnx", reason="skl2onnx is not installed")

import skl2onnx
from sklearn.ensemble import (
    BaggingRegressor,
    ExtraTreesClassifier,
    ExtraTreesRegressor,
    GradientBoostingClassifier,
    GradientBoostingRegressor,
    RandomForestClassifier,
    RandomForestRegressor,
)
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, RationalQuadratic, WhiteKernel
from sklearn.linear_model import LinearRegression, LogisticRegression, Ridge
from sklearn.neighbors import KNeighborsClassifier, KNeighborsRegressor
from sklearn.neural_network import MLPClassifier, MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MinMaxScaler, PolynomialFeatures, StandardScaler
from sklearn.svm import SVC, SVR, NuSVR

import kennfeld as kf

OPSETS = {"": 18, "ai.onnx.ml": 3}
INPUTS = np.random.default_rng(0).standard_normal((120, 3)).astype(np.float32).astype(np.float64)
TARGET = np.sin(INPUTS[:, 0]) + INPUTS[:, 1] * INPUTS[:, 2]
CLASSES = {2: (TARGET > 0).astype(int), 3: np.digitize(TARGET, [-0.5, 0.5]) + 1}
LAYERS = {"hidden_layer_sizes": (8, 5), "solver": "lbfgs", "max_iter": 60, "tol": 1.0, "random_state": 0}
FEW = {"n_estimators": 5, "random_state": 0}

EXACT = {  # in double precision
    "perceptron": MLPRegressor(**LAYERS),
    "logistic perceptron": MLPRegressor(activation="logistic", **LAYERS),
    "standard scaler": make_pipeline(StandardScaler(), MLPRegressor(activation="tanh", **LAYERS)),
    "range scaler": make_pipeline(MinMaxScaler(clip=True), Ridge()),
    "polynomials": make_pipeline(PolynomialFeatures(3), LinearRegression()),
    "linear regression": LinearRegression(),
    "gaussian process": GaussianProcessRegressor(RBF(1.3), alpha=0.01, optimizer=None),
    "gaussian process of several kernels": GaussianProcessRegressor(
        ConstantKernel(2.0) * RationalQuadratic() + WhiteKernel(0.1), alpha=0.01, optimizer=None
    ),
    "neighbours": KNeighborsRegressor(3),
}
SINGLE = {  # the operators hold single precision
    "random forest": RandomForestRegressor(**FEW),
    "extra trees": ExtraTreesRegressor(**FEW),
    "gradient boosting": GradientBoostingRegressor(**FEW),
    "bagging": BaggingRegressor(**FEW),
}
SUPPORT_VECTORS = {
    "radial": SVR(),
    "linear": SVR(kernel="linear"),
    "cubic": SVR(kernel="poly", coef0=1.0),
    "quadratic": SVR(kernel="poly", degree=2),
    "sigmoid": SVR(kernel="sigmoid"),
    "nu": NuSVR(),
}
EXACT_CLASSIFIERS = {
    "perceptron": MLPClassifier(**LAYERS),
    "logistic regression": LogisticRegression(),
    "neighbours": KNeighborsClassifier(5),
}
SINGLE_CLASSIFIERS = {
    "random forest": RandomForestClassifier(**FEW),
    "extra trees": ExtraTreesClassifier(**FEW),
    "gradient boosting": GradientBoostingClassifier(**FEW),
}


def export(path: Path, model, kind, options=None) -> Path:
    """Write a model with inputs of this kind."""
    types = {
        np.float64: skl2onnx.common.data_types.DoubleTensorType,
        np.float32: skl2onnx.common.data_types.FloatTensorType,
    }
    converted = skl2onnx.to_onnx(
        model, initial_types=[("x", types[kind]([None, 3]))], target_opset=OPSETS, options=options
    )
    path.write_bytes(converted.SerializeToString())
    return path


def simulated(path, x):
    """All outputs of a network, [samples, elements]."""
    model = kf.onnx(path)
    data = {f"x[{number}]": x[:, number].astype(np.float64) for number in range(x.shape[1])}
    result = kf.simulate(model, data, model.values)
    return np.stack([result[name].values for name in model.graph.outputs], axis=1)


def runtime(path, x):
    """All outputs that onnxruntime computes, [samples, elements]."""
    onnxruntime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    outputs = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"]).run(None, {"x": x})
    return np.column_stack([np.asarray(output, dtype=np.float64).reshape(len(x), -1) for output in outputs])


def assert_near(actual, expected, tolerance):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * max(np.abs(expected).max(), 1.0))


@pytest.mark.parametrize("name", EXACT)
def test_regressors_in_double_precision_give_their_predictions(tmp_path, name):
    model = EXACT[name].fit(INPUTS, TARGET)
    path = export(tmp_path / "net.onnx", model, np.float64)
    outputs = simulated(path, INPUTS)
    assert_near(outputs[:, 0], model.predict(INPUTS), 1e-12)
    if name != "polynomials":  # which onnxruntime refuses in double precision
        assert_near(outputs, runtime(path, INPUTS), 1e-12)


@pytest.mark.parametrize("name", [*EXACT, *SINGLE])
def test_regressors_in_single_precision_give_their_predictions(tmp_path, name):
    model = (EXACT | SINGLE)[name].fit(INPUTS, TARGET)
    path = export(tmp_path / "net.onnx", model, np.float32)
    outputs = simulated(path, INPUTS)
    assert_near(outputs[:, 0], model.predict(INPUTS), 1e-6)
    assert_near(outputs, runtime(path, INPUTS.astype(np.float32)), 1e-6)


@pytest.mark.parametrize("name", SUPPORT_VECTORS)
def test_support_vector_regressors_give_their_predictions(tmp_path, name):
    model = SUPPORT_VECTORS[name].fit(INPUTS, TARGET)
    path = export(tmp_path / "net.onnx", model, np.float32)
    outputs = simulated(path, INPUTS)
    assert_near(outputs[:, 0], model.predict(INPUTS), 1e-6)
    assert_near(outputs, runtime(path, INPUTS.astype(np.float32)), 2e-5)  # it sums in single precision


@pytest.mark.parametrize("classes", CLASSES)
@pytest.mark.parametrize("name", [*EXACT_CLASSIFIERS, *SINGLE_CLASSIFIERS])
def test_classifiers_give_their_labels_and_probabilities(tmp_path, name, classes):
    model = (EXACT_CLASSIFIERS | SINGLE_CLASSIFIERS)[name].fit(INPUTS, CLASSES[classes])
    expected = np.column_stack([model.predict(INPUTS), model.predict_proba(INPUTS)])
    for kind, tolerance in ((np.float32, 1e-6), (np.float64, 1e-12)):
        path = export(tmp_path / "net.onnx", model, kind, {id(model): {"zipmap": False}})
        outputs = simulated(path, INPUTS)
        assert_near(outputs, expected, tolerance if name in EXACT_CLASSIFIERS else 1e-6)
        if kind is np.float32:
            assert_near(outputs, runtime(path, INPUTS.astype(kind)), 1e-6)


KERNELS = {"radial": {}, "linear": {"kernel": "linear"}, "quadratic": {"kernel": "poly", "degree": 2, "coef0": 0.5}}


@pytest.mark.parametrize("classes", CLASSES)
@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.filterwarnings("ignore:.* was deprecated in:FutureWarning")
def test_support_vector_classifiers_give_their_labels_decisions_and_probabilities(tmp_path, name, classes):
    for probability in (False, True):
        model = SVC(probability=probability, random_state=0, **KERNELS[name]).fit(INPUTS, CLASSES[classes])
        path = export(tmp_path / "net.onnx", model, np.float32, {id(model): {"zipmap": False}})
        outputs = simulated(path, INPUTS)
        scores = (model.predict_proba if probability else model.decision_function)(INPUTS).reshape(len(INPUTS), -1)
        assert_near(outputs[:, : 1 + scores.shape[1]], np.column_stack([model.predict(INPUTS), scores]), 1e-6)
        assert_near(outputs, runtime(path, INPUTS.astype(np.float32)), 5e-6)  # it sums in single precision


def test_probabilities_by_label_are_those_of_an_array(tmp_path):
    model = LogisticRegression().fit(INPUTS, CLASSES[3])
    outputs = simulated(export(tmp_path / "net.onnx", model, np.float32), INPUTS)
    assert_near(outputs[:, 1:], model.predict_proba(INPUTS), 1e-6)


BOOSTED = {  # package, classes; 0 for a regression
    f"{package}, {classes} classes" if classes else package: (package, classes)
    for package in ("xgboost", "lightgbm")
    for classes in (0, 2, 3)
}


@pytest.mark.parametrize("name", BOOSTED)
def test_boosted_trees_of_other_packages(name, tmp_path):
    package, classes = BOOSTED[name]
    boosted = pytest.importorskip(package, reason=f"{package} is not installed")
    onnxmltools = pytest.importorskip("onnxmltools", reason="onnxmltools is not installed")
    prefix, options = {"xgboost": ("XGB", {}), "lightgbm": ("LGBM", {"verbose": -1})}[package]
    kind = getattr(boosted, f"{prefix}{'Classifier' if classes else 'Regressor'}")
    x = INPUTS.astype(np.float32)
    target = CLASSES[classes] - CLASSES[classes].min() if classes else TARGET
    model = kind(n_estimators=10, **options).fit(x, target)
    convert = getattr(onnxmltools, f"convert_{package}")
    types = [("x", onnxmltools.convert.common.data_types.FloatTensorType([None, 3]))]
    converted = convert(model, initial_types=types, target_opset=15)
    path = tmp_path / "boosted.onnx"
    path.write_bytes(converted.SerializeToString())
    expected = model.predict_proba(x) if classes else model.predict(x)[:, None]
    assert_near(simulated(path, x)[:, -max(classes, 1) :], expected, 1e-6)

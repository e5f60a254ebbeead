import pickle
import sys
from importlib.util import find_spec

import numpy as np
import pytest

import kennfeld as kf

pytestmark = pytest.mark.skipif(find_spec("matplotlib") is None, reason="matplotlib is not installed")


@pytest.fixture(scope="module")
def result():
    x = np.linspace(0, 5, 60)
    data = kf.Dataset.of("drive", {"x": x, "u": x % 1, "z": x**2}, units={"z": "Nm"}, time=x, piece_starts=[0, 30])
    start = kf.ParameterSet(
        [kf.Curve("C", range(6), [1.0] * 6), kf.Map("M", [0, 5], [0, 1], np.zeros((2, 2))), kf.Scalar("k", 1.0)]
    )
    return kf.calibrate("y = C(x) + k * M(x, u)", data, start, target="z", smoothness=1e-3)


def titles(figure):
    return [axes.get_title() for axes in figure.axes if axes.get_visible() and axes.get_title()]


def test_convergence_is_the_default(result):
    (axes,) = result.plot().axes
    x = np.concatenate([line.get_xdata() for line in axes.get_lines()])
    y = np.concatenate([line.get_ydata() for line in axes.get_lines()])
    assert x.tolist() == list(range(len(result.trace) + 1))
    assert y.tolist() == [result.cost_before, *(line.cost for line in result.trace)]


def test_strips_show_measurement_and_model_with_the_error_below(result):
    above, below = result.plot("strips").axes
    assert [line.get_label() for line in above.get_lines()] == ["before", "measured", "after"]
    assert above.get_title() == "y, drive"
    error = below.get_lines()[0].get_ydata()
    assert np.nanmax(np.abs(error)) == pytest.approx(result.quality[0].max_abs_after)
    assert np.isnan(error[30])  # the line is interrupted between two pieces


def test_errors_show_model_over_measurement_and_a_histogram(result):
    left, right = result.plot("errors").axes
    assert left.get_xlabel() == "measured [Nm]"
    assert sum(patch.get_height() for patch in right.patches) == 2 * 60


def test_maps_show_the_fitted_tables_or_those_named(result):
    assert titles(result.plot("maps")) == ["C", "M"]
    assert titles(result.plot("maps", names=["M"])) == ["M"]


def test_a_cell_of_a_map_is_drawn_around_its_breakpoint(result):
    figure = result.plot("maps", names=["M"])
    (mesh,) = figure.axes[0].collections
    np.testing.assert_allclose(mesh.get_array(), result.parameters["M"].values.T)


def test_notebooks_show_a_figure_as_a_picture(result):
    assert result.plot("maps")._repr_png_().startswith(b"\x89PNG")


def test_long_recordings_are_reduced():
    x = np.linspace(0, 5, 30_000)
    long = kf.calibrate("y = a * x", {"x": x, "z": x}, {"a": 0.5}, target="z")
    assert all(len(line.get_xdata()) <= 4002 for axes in long.plot("strips").axes for line in axes.get_lines())
    assert len(long.plot("errors").axes[0].get_lines()[0].get_xdata()) <= 20_000


def test_a_result_of_another_process_needs_the_problem(result):
    copy = pickle.loads(pickle.dumps(result))
    with pytest.raises(kf.ArgumentError, match=r"Pass problem=project\.problem\(\)"):
        copy.plot("strips")
    assert titles(copy.plot("strips", result.inspection.problem)) == ["y, drive"]
    assert titles(copy.plot("maps")) == ["C", "M"]


@pytest.mark.parametrize(
    ("kind", "selection", "message"),
    [
        ("strip", {}, "kind='strip' of a plot must be convergence, strips, errors or maps"),
        ("strips", {"criterion": "Y"}, "criterion='Y' of a plot is unknown. Did you mean y?"),
        ("errors", {"dataset": "driv"}, "dataset='driv' of a plot is unknown. Did you mean drive?"),
        ("maps", {"names": ["k"]}, "names='k' of a plot is unknown"),
    ],
)
def test_unknown_names_are_errors(result, kind, selection, message):
    with pytest.raises(kf.ArgumentError) as error:
        result.plot(kind, **selection)
    assert message in str(error.value)


def test_without_matplotlib_the_message_has_the_command_that_installs_it(result, monkeypatch):
    for name in [name for name in sys.modules if name == "matplotlib" or name.startswith("matplotlib.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(kf.InputError, match=r'matplotlib is not installed\. Run: pip install "kennfeld\[notebook\]"'):
        result.plot("maps")

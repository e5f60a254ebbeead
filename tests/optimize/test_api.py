import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import ArgumentError

X = np.linspace(0.0, 3.0, 31)
LINE = {"x": X, "y": 2 * X + 1}
START = {"a": 0.0, "b": 0.0}
TEXT = "m = a * x + b"


def tables():
    return kf.ParameterSet(
        [kf.Curve("C", [0, 1, 2, 3], np.zeros(4)), kf.Map("M", [0, 1, 2, 3], [0, 1, 2], np.zeros((4, 3)))]
    )


def rough(**arguments):
    data = {"x": X, "y": np.sin(3 * X), "z": X % 2}
    return kf.calibrate("m = C(x) + M(x, z)", data, tables(), target="y", **arguments)


def frame():
    import pandas as pd

    return pd.DataFrame(LINE)


@pytest.mark.parametrize(
    "data",
    [
        LINE,
        frame,
        kf.Dataset.of("bench", LINE),
        [LINE],
        [kf.Dataset.of("a", LINE), {"x": X[:5], "y": 2 * X[:5] + 1}],
        {name: list(values) for name, values in LINE.items()},
    ],
    ids=["dict", "DataFrame", "Dataset", "list", "mixed list", "lists"],
)
def test_data_may_come_in_many_forms(data):
    result = kf.calibrate(TEXT, data() if data is frame else data, START, target="y")
    assert result.parameters["a"].value == pytest.approx(2.0)
    assert result.parameters["b"].value == pytest.approx(1.0)


def test_the_model_may_be_a_model_or_its_text():
    assert kf.calibrate(kf.formula(TEXT), LINE, START, target="y").parameters["a"].value == pytest.approx(2.0)


def test_numbers_and_parameters_mix_in_the_start():
    start = {"a": kf.Scalar("a", 0.0, upper=1.5), "b": 0.0}
    assert kf.calibrate(TEXT, LINE, start, target="y").parameters["a"].value == 1.5


def test_limits_bound_every_value_of_a_parameter():
    result = rough(bounds={"C": (-0.1, 0.2)})
    assert np.all((result.parameters["C"].values >= -0.1) & (result.parameters["C"].values <= 0.2))


@pytest.mark.parametrize("smoothness", [0.5, {"C": 0.5, "M": 0.5}, {"C": (0.5,), "M": (0.5, 0.5)}])
def test_smoothness_may_be_given_for_all_by_parameter_or_by_axis(smoothness):
    assert rough(smoothness=smoothness).cost_after == pytest.approx(rough(smoothness=0.5).cost_after)


@pytest.mark.parametrize(
    "smoothness", [np.float32(0.5), np.float64(0.5), {"C": np.array([0.5]), "M": np.array([0.5, 0.5])}]
)
def test_smoothness_may_come_from_numpy(smoothness):
    assert rough(smoothness=smoothness).cost_after == pytest.approx(rough(smoothness=0.5).cost_after, rel=1e-6)


def test_an_axis_may_stay_rough():
    smooth, half = rough(smoothness={"M": (0.0, 100.0)}), rough(smoothness={"M": (100.0, 0.0)})
    bent = np.abs(np.diff(half.parameters["M"].values, 2, axis=0)).max()
    assert bent < np.abs(np.diff(smooth.parameters["M"].values, 2, axis=0)).max()


@pytest.mark.parametrize(
    ("smoothness", "message"),
    [
        ({"Cc": 1.0}, "Cc"),
        ({"M": (1.0,)}, "M"),
        ({"C": (1.0, 2.0)}, "C"),
        (-1.0, "-1"),
        (float("nan"), "nan"),
        ({"M": (1.0, -2.0)}, "-2"),
        ({"C": {"y": 1.0}}, "it has no axis 'y', but x"),
    ],
    ids=["unknown name", "too few", "too many", "negative", "nan", "negative on an axis", "an unknown axis"],
)
def test_invalid_smoothness_is_refused(smoothness, message):
    with pytest.raises(kf.KennfeldError, match=message):
        rough(smoothness=smoothness)


def test_an_unknown_channel_name_is_refused():
    with pytest.raises(kf.KennfeldError, match="speed"):
        kf.calibrate(TEXT, LINE, START, target="y", channels={"speed": "x"})


def test_free_may_not_be_a_bare_text():
    with pytest.raises(kf.KennfeldError, match="free"):
        kf.calibrate("m = alpha * x", LINE, {"alpha": 0.0}, target="y", free="alpha")


def test_all_missing_names_are_reported_at_once():
    with pytest.raises(kf.InputError) as caught:
        kf.calibrate("m = C(speed) + load", {"sped": X, "y": X}, tables(), target="yy")
    text = str(caught.value)
    assert "no channel named speed. Did you mean sped?" in text
    assert "no channel named load" in text
    assert "yy" in text


def test_a_name_that_is_neither_channel_nor_parameter_may_be_meant_as_either():
    with pytest.raises(kf.InputError, match=r"It has x, y\. If offset is a scalar to fit, give it an initial value\."):
        kf.calibrate("m = a * x + offset", LINE, {"a": 0.0}, target="y")


def test_a_call_without_a_target_names_the_argument():
    with pytest.raises(kf.InputError, match='Give target="channel", or criteria'):
        kf.calibrate(TEXT, LINE, START)


def test_an_unknown_target_lists_the_channels():
    with pytest.raises(kf.InputError, match=r"unknown node or channel torque\. The channels are x, y\."):
        kf.calibrate(TEXT, LINE, START, target="torque")


def test_a_lookup_with_too_many_coordinates_is_named():
    with pytest.raises(kf.InputError, match=r"C is looked up with 2 coordinates, but has 1 axis\. Look it up with 1 "):
        kf.calibrate("m = C(x, x)", LINE, tables(), target="y")


@pytest.mark.parametrize("start", [{}, {"k": 1.0}, {"Gain": 1.0}])
def test_a_table_without_initial_values_is_reported_with_the_class_that_it_needs(start):
    with pytest.raises(kf.InputError, match=r'A table needs initial values: kf\.Map\("Gain", \.\.\.\)\.'):
        kf.calibrate("m = Gain(x, x)", LINE, start, target="y")


def test_an_unknown_limit_is_named_with_the_nearest():
    with pytest.raises(
        kf.InputError, match=r"limit: unknown node or channel Gain \(dataset training\)\. Did you mean gain\?"
    ):
        kf.calibrate("m = gain * x", LINE, {"gain": 1.0}, target="y", limits={"Gain": (0, 1)})


def test_crossed_limits_are_refused():
    with pytest.raises(ArgumentError, match="above its upper bound"):
        kf.calibrate(TEXT, LINE, START, target="y", bounds={"a": (1, 0)})


def test_an_output_must_be_chosen_if_there_are_several():
    with pytest.raises(ArgumentError, match="node="):
        kf.calibrate("m = a * x\nn = b * x", LINE, START, target="y")


def test_a_target_that_is_missing_in_all_data_is_named():
    with pytest.raises(kf.InputError, match="unknown node or channel Torq"):
        kf.calibrate(TEXT, LINE, START, target="Torq")


def test_a_criterion_without_a_sample_is_refused():
    with pytest.raises(kf.InputError, match="target"):
        kf.calibrate(TEXT, {"x": X, "y": np.full(31, np.nan)}, START, target="y")


def test_a_criterion_of_several_that_no_sample_reaches_is_refused():
    data = LINE | {"z": np.full(31, np.nan)}
    with pytest.raises(kf.InputError, match="z"):
        kf.calibrate(TEXT, data, START, criteria=[kf.Criterion("m", "y"), kf.Criterion("m", "z")])


@pytest.mark.parametrize("data", [{"x": [], "y": []}, {"x": [np.nan], "y": [1.0]}], ids=["empty", "all missing"])
def test_training_data_without_a_sample_are_refused(data):
    with pytest.raises(kf.InputError, match="training"):
        kf.calibrate(TEXT, data, START, target="y")


def test_a_calibration_without_a_criterion_is_refused():
    with pytest.raises(kf.InputError, match="criteria"):
        kf.calibrate(TEXT, LINE, START)


def test_a_pattern_that_frees_no_parameter_is_refused():
    with pytest.raises(kf.InputError, match="free"):
        kf.calibrate(TEXT, LINE, START, target="y", free=["q*"])


@pytest.mark.parametrize(
    "pin",
    [kf.Pin("Cc", (0.0,), 1.0), kf.Pin("C", (0.0, 1.0), 1.0), kf.Pin("C", (np.nan,), 1.0), kf.Pin("C", (0.0,), np.nan)],
)
def test_an_invalid_pin_is_refused(pin):
    with pytest.raises(kf.KennfeldError, match="pin"):
        rough(pins=[pin])


def test_memory_without_time_stamps_is_refused_with_a_remedy():
    with pytest.raises(kf.InputError, match="time stamps"):
        kf.calibrate("m = PT1(x, a) + b", LINE, START, target="y")


def test_simulate_gives_the_named_nodes():
    simulation = kf.simulate("half = x / 2\nm = half + k", {"x": [2.0, 4.0]}, {"k": 1.0})
    assert simulation["half"].values.tolist() == [1.0, 2.0]
    assert simulation["m"].values.tolist() == [2.0, 3.0]


def test_a_simulation_without_nodes_is_empty():
    assert kf.simulate("m = x + k", {"x": []}, {"k": 1.0}).samples == 0

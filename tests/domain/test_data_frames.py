import sys
from importlib.util import find_spec

import numpy as np
import pytest

import kennfeld as kf

pytestmark = pytest.mark.skipif(find_spec("pandas") is None, reason="pandas is not installed")


def test_a_curve_is_a_column_over_its_breakpoints():
    frame = kf.Curve("Eta", kf.Axis([0, 10, 20], "dSpark"), [1.0, 0.9, 0.7]).to_frame()
    assert frame.index.name == "dSpark"
    assert frame["Eta"].to_dict() == {0.0: 1.0, 10.0: 0.9, 20.0: 0.7}


def test_a_map_has_x_along_the_rows_and_y_along_the_columns():
    frame = kf.Map("M", kf.Axis([1000, 2000], "Speed"), [0, 50, 100], [[1, 2, 3], [4, 5, 6]]).to_frame()
    assert (frame.index.name, frame.columns.name) == ("Speed", "y")
    assert frame.loc[2000.0, 50.0] == 5.0
    assert frame.shape == (2, 3)


def test_a_cube_is_a_column_with_a_level_per_axis():
    cube = kf.Cube("Q", [[0, 1], [0, 1, 2], [5, 6]], np.arange(12.0).reshape(2, 3, 2))
    frame = cube.to_frame()
    assert frame.index.names == ["x", "y", "z"]
    assert frame.loc[(1.0, 2.0, 5.0), "Q"] == cube.values[1, 2, 0]


def test_a_scalar_is_a_single_number():
    assert kf.Scalar("K", 0.5).to_frame()["K"].tolist() == [0.5]


def test_a_set_has_a_row_for_each_value():
    curve, scalar = kf.Curve("C", [0, 1], [2.0, 3.0], unit="Nm", upper=9), kf.Scalar("K", 0.5, locked=True)
    frame = kf.ParameterSet([curve, scalar]).to_frame()
    assert frame.columns.tolist() == ["parameter", "unit", "x", "value", "lower", "upper", "locked"]
    assert frame[frame.parameter == "C"][["x", "value", "upper"]].values.tolist() == [[0, 2, 9], [1, 3, 9]]
    assert np.isnan(frame.x.iloc[2])
    assert frame.locked.tolist() == [False, False, True]
    assert len(kf.ParameterSet().to_frame()) == 0


def test_a_dataset_has_its_time_as_index():
    frame = kf.Dataset.of("drive", {"u": [1.0, np.nan, 3.0]}, time=np.array([0.0, 0.1, 0.2])).to_frame()
    assert frame.index.name == "time [s]"
    assert frame.index.tolist() == [0.0, 0.1, 0.2]
    assert frame.u.isna().tolist() == [False, True, False]


def test_pieces_are_a_level_of_the_index():
    data = kf.Dataset.of("bench", {"u": [1.0, 2.0, 3.0]}, piece_starts=np.array([0, 2]))
    assert data.to_frame().index.tolist() == [(0, 0), (0, 1), (1, 2)]


def test_a_frame_is_a_copy_and_can_be_read_again():
    data = kf.Dataset.of("drive", {"u": [1.0, 2.0]}, time=np.array([0.0, 0.1]))
    frame = data.to_frame()
    frame.loc[0.0, "u"] = 9.0
    assert data["u"].values.tolist() == [1.0, 2.0]
    again = kf.simulate(kf.formula("y = 2 * u"), kf.Dataset.of("again", frame), {})
    assert again["y"].values.tolist() == [18.0, 4.0]


@pytest.mark.parametrize("value", [kf.Scalar("K", 1.0), kf.ParameterSet(), kf.Dataset.of("d", {"x": [1.0]})])
def test_without_pandas_the_message_has_the_command_that_installs_it(value, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(kf.InputError, match=r'pandas is not installed\. Run: pip install "kennfeld\[notebook\]"'):
        value.to_frame()

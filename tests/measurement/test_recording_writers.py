"""Writers of recordings for other tools, read back by asammdf and scipy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.io import loadmat

from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.measurement import mdf_writer
from kennfeld.measurement.matlab_writer import write_matlab
from kennfeld.measurement.mdf_writer import write_mdf
from kennfeld.measurement.writable_recording import WritableRecording
from tests.measurement.mdf_library import mdf_file

NAMES = [
    "time",
    "piece",
    "sample",
    "end",
    "info",
    "a.b\\c/d[0]",
    "Öl°C",
    "y (error)",
    "y_error",
    "1st",
    "x" * 80,
    "x" * 81,
]


def recording_of(*parts, pieces=None, name="drive"):
    numbers = pieces or [np.ones(part.samples, dtype=np.int64) for part in parts]
    return WritableRecording(name, "fleet", "training", "drive.mf4", None, parts, numbers)


def part(begin, samples, names=("y",), missing=()):
    time = begin + 0.1 * np.arange(samples)
    columns = []
    for number, name in enumerate(names):
        values = np.sqrt(number + time)
        values[list(missing)] = np.nan
        columns.append(Channel(name, values, "°C", f"comment {number}"))
    return Dataset("fleet", tuple(columns), time)


def test_any_name_of_a_channel_is_kept_in_mdf(tmp_path):
    data = part(0.0, 5, NAMES)
    write_mdf([recording_of(data)], tmp_path / "a.mf4", "test")
    with mdf_file(tmp_path / "a.mf4") as file:
        assert file.version == "4.10"
        names = [channel.name for channel in file.groups[0].channels]
        assert names == ["timestamps", *NAMES]
        for index, name in enumerate(NAMES, 1):
            np.testing.assert_array_equal(file.get(group=0, index=index).samples, data[name].values)
        np.testing.assert_array_equal(file.get_master(0), data.time)


def test_any_name_of_a_channel_is_a_field_in_matlab(tmp_path):
    data = part(0.0, 5, NAMES)
    write_matlab([recording_of(data, name="1st: drive (2)")], tmp_path / "a.mat", "a.mat")
    struct = loadmat(tmp_path / "a.mat", simplify_cells=True)["x1st_drive_2"]
    np.testing.assert_array_equal(struct["time"], data.time)
    assert sorted(struct["names"].values()) == sorted(NAMES)
    for field, name in struct["names"].items():
        assert field.isidentifier()
        assert len(field) <= 63
        np.testing.assert_array_equal(struct[field], data[name].values)
        assert struct["units"][field] == "°C"


@pytest.mark.parametrize("at_once", [3, 1 << 18])
def test_parts_follow_each_other_in_one_group(tmp_path, monkeypatch, at_once):
    monkeypatch.setattr(mdf_writer, "_AT_ONCE", at_once)
    first, second = part(0.0, 7, ["y", "z"]), part(1.0, 8, ["y", "z"])
    second = second.with_channels(replace(second["y"], values=np.where(np.arange(8) == 5, np.nan, 1.0)))
    pieces = [np.full(7, 1), np.full(8, 2)]
    write_mdf([recording_of(first, second, pieces=pieces)], tmp_path / "a.mf4", "test")
    with mdf_file(tmp_path / "a.mf4") as file:
        signals = {name: file.get(name, ignore_invalidation_bits=True) for name in ("y", "z", "piece")}
    np.testing.assert_array_equal(signals["y"].timestamps, np.concatenate([first.time, second.time]))
    np.testing.assert_array_equal(signals["z"].samples, np.concatenate([first["z"].values, second["z"].values]))
    assert np.flatnonzero(signals["y"].invalidation_bits).tolist() == [12]
    assert np.flatnonzero(np.isnan(signals["y"].samples)).tolist() == [12]
    assert signals["z"].invalidation_bits is None
    assert signals["piece"].samples.tolist() == [1] * 7 + [2] * 8


@pytest.mark.parametrize("count", [1, 7, 8, 9, 17])
def test_each_channel_has_its_own_invalid_samples(tmp_path, count):
    names = [f"c{number}" for number in range(count)]
    data = part(0.0, 20, names)
    for number, name in enumerate(names):
        data = data.with_channels(replace(data[name], values=np.where(np.arange(20) == number, np.nan, number)))
    write_mdf([recording_of(data)], tmp_path / "a.mf4", "test")
    with mdf_file(tmp_path / "a.mf4") as file:
        for number, name in enumerate(names):
            signal = file.get(name, ignore_invalidation_bits=True)
            assert np.flatnonzero(signal.invalidation_bits).tolist() == [number]
            np.testing.assert_array_equal(signal.samples, data[name].values)


@pytest.mark.parametrize("value", [np.inf, -np.inf, 5e-324, 1e308, -0.0])
def test_numbers_are_kept_bit_for_bit(tmp_path, value):
    data = Dataset("d", (Channel("y", np.array([value, 1 / 3])),), np.array([0.1, 0.30000000000000004]))
    write_mdf([recording_of(data)], tmp_path / "a.mf4", "test")
    write_matlab([recording_of(data)], tmp_path / "a.mat", "a.mat")
    with mdf_file(tmp_path / "a.mf4") as file:
        signal = file.get("y")
    struct = loadmat(tmp_path / "a.mat", simplify_cells=True)["drive"]
    for values, time in ((signal.samples, signal.timestamps), (struct["y"], struct["time"])):
        assert values.tobytes() == data["y"].values.tobytes()
        assert time.tobytes() == data.time.tobytes()


def test_a_file_without_recordings_can_be_opened(tmp_path):
    write_mdf([], tmp_path / "a.mf4", "test")
    write_matlab([], tmp_path / "a.mat", "a.mat")
    with mdf_file(tmp_path / "a.mf4") as file:
        assert not file.groups
    assert not [name for name in loadmat(tmp_path / "a.mat") if not name.startswith("__")]


def test_a_single_sample_is_a_recording(tmp_path):
    data = part(3.0, 1)
    write_mdf([recording_of(data)], tmp_path / "a.mf4", "test")
    write_matlab([recording_of(data)], tmp_path / "a.mat", "a.mat")
    with mdf_file(tmp_path / "a.mf4") as file:
        assert file.get("y").timestamps.tolist() == [3.0]
    assert loadmat(tmp_path / "a.mat")["drive"]["y"][0, 0].shape == (1, 1)

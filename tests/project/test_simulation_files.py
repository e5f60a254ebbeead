"""Simulations as files for other tools, read back by asammdf and scipy, which know nothing of our readers."""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from scipy.io import loadmat

from kennfeld import cli
from kennfeld.base.errors import InputError
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.domain.file_spans import FileSpans
from kennfeld.project import Project
from kennfeld.project.results import results_folder, write
from kennfeld.project.simulated_recordings import simulated_recordings
from kennfeld.project.simulation import SimulatedPart
from tests.measurement.mdf_library import mdf_file, signal

START = datetime(2026, 3, 1, 12, 30, 0, 250_000, tzinfo=timezone(timedelta(hours=1)))
LATER = datetime(2026, 3, 2, 8, 0, tzinfo=UTC)

FORMULA = """\
input Speed[rpm]
scalar k
scalar offset
%big part/1%[Nm] = k * Speed
y[Nm] = %big part/1% + offset
"""
PROJECT = """\
[model]
file = "torque.kf"

[channels]
Speed = "n"

[[dataset]]
name = "drives"
files = ["a.mf4", "b.mf4"]

[[dataset]]
name = "fresh"
files = ["c.mf4"]
use = "test"

[calibration]
results = ["mf4", "mat"]

[parameters.k]
initial = 2.0

[parameters.offset]
initial = 0.5

[[criterion]]
node = "y"
target = "Torque"
"""


def record(path, samples, start, *, gap=None, missing=(), seed=0):
    """Write a recording with uneven time stamps; return its columns."""
    random = np.random.default_rng(seed)
    time = np.cumsum(random.uniform(0.05, 0.15, samples)) + 3.0
    if gap is not None:
        time[gap:] += 60.0
    speed = random.uniform(1.0, 5.0, samples)
    torque = 2.0 * speed + 1.0 + random.normal(0.0, 0.1, samples)
    torque[list(missing)] = np.nan
    with mdf_file(version="4.10") as file:
        file.start_time = start
        signals = [
            signal(speed, time, name="n", unit="rpm", comment="engine speed"),
            signal(torque, time, name="Torque", unit="Nm", comment="shaft torque"),
        ]
        file.append(signals, common_timebase=True)
        file.save(path, overwrite=True)
    return {"time": time, "Speed": speed, "Torque": torque}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "torque.kf").write_text(FORMULA, encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(PROJECT, encoding="utf-8")
    return tmp_path


@pytest.fixture
def recorded(folder):
    return [
        record(folder / "a.mf4", 40, START, gap=25, missing=[3, 4, 5]),
        record(folder / "b.mf4", 30, START, seed=1),
        record(folder / "c.mf4", 20, START, seed=2),
    ]


def read_all(file, group, name):
    """Return a channel with its invalid samples, which asammdf leaves out by default."""
    return file.get(name, group=group, ignore_invalidation_bits=True)


def test_each_recording_is_a_group_with_its_own_time_stamps_and_start(folder, recorded):
    assert cli.run(["simulate", str(folder / "kennfeld.toml"), "-o", str(folder / "out.mf4")]) == 0
    with mdf_file(folder / "out.mf4") as file:
        assert file.start_time == START
        labels = [group.channel_group.acq_name for group in file.groups]
        assert labels == ["drives: a.mf4", "drives: b.mf4", "fresh: c.mf4"]
        assert "test dataset fresh, c.mf4, recorded from 2026-03-01 12:30:00.250000+01:00" in (
            file.groups[2].channel_group.comment
        )
        for number, own in enumerate(recorded):
            np.testing.assert_array_equal(file.get_master(number), own["time"])
            for name in ("Speed", "Torque"):
                np.testing.assert_array_equal(read_all(file, number, name).samples, own[name])


def test_nodes_and_errors_are_those_of_the_simulation(folder, recorded):
    project = Project.read(folder / "kennfeld.toml")
    project.simulation().save(folder / "out.mf4")
    simulated = project.simulate()
    with mdf_file(folder / "out.mf4") as file:
        for name in ("y", "big part/1"):
            parts = [read_all(file, number, name).samples for number in (0, 1)]
            np.testing.assert_array_equal(np.concatenate(parts), simulated[0][name].values)
        expected = read_all(file, 0, "y").samples - recorded[0]["Torque"]
        np.testing.assert_array_equal(read_all(file, 0, "y (error)").samples, expected)


def test_missing_values_are_invalid_samples(folder, recorded):
    Project.read(folder / "kennfeld.toml").simulation().save(folder / "out.mf4")
    with mdf_file(folder / "out.mf4") as file:
        for name in ("Torque", "y (error)"):
            invalid = read_all(file, 0, name).invalidation_bits
            assert np.flatnonzero(invalid).tolist() == [3, 4, 5]
            assert file.get(name, group=0).samples.size == 37
        assert read_all(file, 0, "y").invalidation_bits is None


def test_channels_have_units_and_comments(folder, recorded):
    Project.read(folder / "kennfeld.toml").simulation().save(folder / "out.mf4")
    with mdf_file(folder / "out.mf4") as file:
        described = {c.name: (c.unit, c.comment) for c in file.groups[1].channels}
    assert described == {
        "time": ("s", ""),
        "big part/1": ("Nm", "node of the function, torque.kf line 4"),
        "y": ("Nm", "node of the function, torque.kf line 5"),
        "Torque": ("Nm", "target: shaft torque"),
        "y (error)": ("Nm", "y minus Torque"),
        "Speed": ("rpm", "input, channel n: engine speed"),
    }


def test_pieces_are_numbered_if_a_recording_has_several(folder, recorded):
    Project.read(folder / "kennfeld.toml").simulation().save(folder / "out.mf4")
    with mdf_file(folder / "out.mf4") as file:
        assert read_all(file, 0, "piece").samples.tolist() == [1] * 25 + [2] * 15
        assert "piece" not in file.groups[1].channels


def test_different_start_times_are_reported(folder, recorded, capsys):
    record(folder / "b.mf4", 30, LATER, seed=1)
    assert cli.run(["simulate", str(folder / "kennfeld.toml"), "-o", str(folder / "out.mf4")]) == 0
    assert "out.mf4: the recordings start at different times" in capsys.readouterr().err
    with mdf_file(folder / "out.mf4") as file:
        assert file.start_time == START
        assert "recorded from 2026-03-02 08:00:00+00:00" in file.groups[1].channel_group.comment
        np.testing.assert_array_equal(file.get_master(1), recorded[1]["time"])


def test_matlab_has_a_struct_for_each_recording(folder, recorded):
    assert cli.run(["simulate", str(folder / "kennfeld.toml"), "-o", str(folder / "out.MAT")]) == 0
    variables = loadmat(folder / "out.MAT", simplify_cells=True)
    assert [name for name in variables if not name.startswith("__")] == ["drives_a_mf4", "drives_b_mf4", "fresh_c_mf4"]
    for name, own in zip(("drives_a_mf4", "drives_b_mf4", "fresh_c_mf4"), recorded, strict=True):
        struct = variables[name]
        for channel, values in own.items():
            np.testing.assert_array_equal(struct[channel], values)
    struct = variables["drives_a_mf4"]
    assert struct["info"]["start_time"] == "2026-03-01T12:30:00.250000+01:00"
    assert (struct["info"]["dataset"], struct["info"]["use"], struct["info"]["file"]) == ("drives", "training", "a.mf4")
    assert struct["piece"].tolist() == [1] * 25 + [2] * 15
    assert struct["names"]["big_part_1"] == "big part/1"
    assert (struct["units"]["y_error"], struct["comments"]["y_error"]) == ("Nm", "y minus Torque")
    np.testing.assert_array_equal(struct["y_error"], struct["y"] - struct["Torque"])


def test_matlab_vectors_are_columns(folder, recorded):
    Project.read(folder / "kennfeld.toml").simulation().save(folder / "out.mat")
    assert loadmat(folder / "out.mat")["drives_a_mf4"]["y"][0, 0].shape == (40, 1)


@pytest.mark.parametrize("ending", ["mf4", "mat"])
def test_points_without_time_have_none(folder, ending):
    columns = {"n": [1.0, 2.0, 3.0], "Torque": [3.0, np.nan, 7.0]}
    pyarrow.parquet.write_table(pyarrow.table(columns), folder / "bench.parquet")
    begin, _, end = PROJECT.partition('[[dataset]]\nname = "drives"')
    rest = end[end.index("[calibration]") :]
    text = f'{begin}[[dataset]]\nfiles = ["bench.parquet"]\n\n{rest}'
    (folder / "kennfeld.toml").write_text(text, encoding="utf-8")
    path = Project.read(folder / "kennfeld.toml").simulation().save(folder / f"out.{ending}")
    if ending == "mat":
        struct = loadmat(path, simplify_cells=True)["bench"]
        assert "time" not in struct
        assert struct["info"]["start_time"].size == 0
        np.testing.assert_array_equal(struct["y"], [2.5, 4.5, 6.5])
        return
    with mdf_file(path) as file:
        master = file.groups[0].channels[0]
        assert (master.name, master.sync_type) == ("sample", 4)
        assert file.start_time == datetime(1970, 1, 1, tzinfo=UTC)
        np.testing.assert_array_equal(read_all(file, 0, "y").samples, [2.5, 4.5, 6.5])


def test_a_calibration_writes_simulation_files_among_its_results(folder, recorded):
    project = Project.read(folder / "kennfeld.toml")
    result = project.calibrate()
    names = {path.name for path in write(result, project, results_folder(project.path))}
    assert {"simulation.parquet", "simulation.mf4", "simulation.mat"} <= names
    with mdf_file(folder / "results" / "simulation.mf4") as file:
        fitted = read_all(file, 2, "y").samples
    expected = result.parameters["k"].value * recorded[2]["Speed"] + result.parameters["offset"].value
    np.testing.assert_allclose(fitted, expected, rtol=1e-12)


def test_an_unknown_format_is_named_with_the_nearest(folder):
    text = PROJECT.replace('["mf4", "mat"]', '["mf5"]')
    (folder / "kennfeld.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"results: unknown result format 'mf5'\. Did you mean mf4"):
        Project.read(folder / "kennfeld.toml")


def test_a_missing_library_is_reported_before_the_run(folder, recorded, monkeypatch, capsys):
    monkeypatch.setattr("kennfeld.measurement.mdf_writer.find_spec", lambda name: None)
    assert cli.run(["simulate", str(folder / "kennfeld.toml"), "-o", str(folder / "out.mf4")]) == 2
    assert 'asammdf is not installed. Run: pip install "kennfeld[mdf]"' in capsys.readouterr().err
    assert not (folder / "out.mf4").exists()
    errors = [finding for finding in Project.read(folder / "kennfeld.toml").check() if finding.severity == "error"]
    assert [str(error.location) for error in errors] == ["kennfeld.toml line 17 [calibration] results"]


def test_a_format_that_fails_does_not_affect_the_other_results(folder, recorded, monkeypatch):
    monkeypatch.setattr("kennfeld.measurement.matlab_writer._MOST_BYTES", 100)
    project = Project.read(folder / "kennfeld.toml")
    names = {path.name for path in write(project.calibrate(), project, folder / "results")}
    assert "simulation.mf4" in names
    assert "simulation.mat" not in names
    with pytest.raises(InputError, match=r"out.mat: drives: a.mf4 takes .* holds less than 2.1 GB"):
        project.simulation().save(folder / "out.mat")
    assert not (folder / "out.mat").exists()


def test_simulations_are_not_written_through_a_link_of_the_project(folder, recorded, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "target.mf4"
    (folder / "out.mf4").symlink_to(elsewhere)
    assert cli.run(["simulate", str(folder / "kennfeld.toml"), "-o", str(folder / "out.mf4")]) == 2
    assert not elsewhere.exists()


def test_partitions_write_the_same_file(folder, recorded):
    whole = Project.read(folder / "kennfeld.toml").simulation().save(folder / "whole.mf4")
    (folder / "kennfeld.toml").write_text(f"{PROJECT}\n[cluster]\npartition = 16\n", encoding="utf-8")
    project = Project.read(folder / "kennfeld.toml")
    parts = project.simulation().save(folder / "parts.mf4")
    assert any("data in partitions is not among the results" in str(finding) for finding in project.check())
    with mdf_file(whole) as first, mdf_file(parts) as second:
        assert first.start_time == second.start_time
        for number, group in enumerate(first.groups):
            assert group.channel_group.comment == second.groups[number].channel_group.comment
            for index, channel in enumerate(group.channels):
                signals = [
                    file.get(group=number, index=index, ignore_invalidation_bits=True) for file in (first, second)
                ]
                assert signals[0].samples.tobytes() == signals[1].samples.tobytes(), channel.name


@pytest.mark.parametrize("partition", ["", "\n[cluster]\npartition = 64\n"])
def test_a_finer_step_of_the_model_does_not_change_the_recorded_samples(folder, recorded, partition):
    time = 3.0 + 0.1 * np.arange(40)
    columns = {"n": 2.0 + np.sin(time), "Torque": 4.0 + 0.1 * time}
    for name in ("a.mf4", "b.mf4", "c.mf4"):
        with mdf_file(version="4.10") as file:
            file.append([signal(values, time, name=key) for key, values in columns.items()], common_timebase=True)
            file.save(folder / name, overwrite=True)
    lag = FORMULA.replace("k * Speed", "PT1(k * Speed, 0.5)")
    (folder / "torque.kf").write_text(f"step 0.02\n{lag}", encoding="utf-8")
    masked = PROJECT.replace("[[dataset]]", '[[dataset]]\nwhere = "Torque > 4.5"')
    (folder / "kennfeld.toml").write_text(masked + partition, encoding="utf-8")
    project = Project.read(folder / "kennfeld.toml")
    simulation = project.simulation()
    with mdf_file(simulation.save(folder / "out.mf4")) as file:
        assert len(file.groups) == 3
        for number in range(3):
            np.testing.assert_array_equal(file.get_master(number), time)
            np.testing.assert_array_equal(read_all(file, number, "Torque").samples, columns["Torque"])
            fine = pyarrow.parquet.read_table(simulation.save(folder / "out.parquet")).to_pandas()
            own = fine[fine["file"] == ("a.mf4", "b.mf4", "c.mf4")[number]]
            assert len(own) == 39 * 5 + 1
            np.testing.assert_array_equal(read_all(file, number, "y").samples, own["y"].to_numpy()[::5])
    content = loadmat(simulation.save(folder / "out.mat"), simplify_cells=True)
    assert content["fresh_c_mf4"]["time"].tolist() == time.tolist()


class Parts:
    """A simulation that consists of given parts."""

    files: dict[str, str] = {}  # noqa: RUF012

    def __init__(self, *parts):
        self._parts = parts

    def parts(self):
        return self._parts


def part(time, files=None, piece=0, starts=(0,)):
    count = len(time)
    spans = None if files is None else FileSpans.joined(*files)
    data = Dataset("d", (Channel("y", np.arange(count)),), np.array(time), np.array(starts), files=spans)
    return SimulatedPart(data, piece)


def test_parts_of_one_file_are_one_recording():
    first, second = part([0.0, 1.0], (["a"], [2])), part([2.0, 3.0], (["a"], [2]), piece=1)
    (recording,) = simulated_recordings(Parts(first, second))
    assert recording.time().tolist() == [0.0, 1.0, 2.0, 3.0]
    assert np.concatenate(recording.pieces).tolist() == [1, 1, 2, 2]


def test_a_file_whose_time_starts_again_is_a_recording_for_each_run():
    whole = part([0.0, 1.0, 0.0, 1.0, 5.0], (["a", "b"], [4, 1]), starts=(0, 2, 4))
    names = [(recording.name, recording.time().tolist()) for recording in simulated_recordings(Parts(whole))]
    assert names == [("d: a", [0.0, 1.0]), ("d: a (2)", [0.0, 1.0]), ("d: b", [5.0])]


def test_a_dataset_without_samples_has_no_recording():
    assert list(simulated_recordings(Parts(part([])))) == []

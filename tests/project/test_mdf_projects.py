"""Projects on MDF files: patterns, rasters that meet, names that several groups have."""

import subprocess
import sys
import warnings

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.project import Project


@pytest.fixture
def project(tmp_path):
    """Two benches with a fast speed and a slow torque, torque = 3 + 0.05 speed; the text is added to the project."""

    def write(dataset, twice=False, channels="", names=("Speed", ""), target="Torque"):
        speed, mapped = names
        channels += f"[channels]\n{mapped}" if mapped else ""
        (tmp_path / "sensor.kf").write_text(f"Predicted = Offset + Gain * {speed}\nscalar Offset\nscalar Gain\n")
        (tmp_path / "kennfeld.toml").write_text(
            f'[model]\nfile = "sensor.kf"\n{channels}\n[[dataset]]\nfiles = ["bench_*.mf4"]\n{dataset}\n'
            f'[[criterion]]\nnode = "Predicted"\ntarget = {{ channel = "{target}" }}\n'
            "[parameters]\nOffset = { initial = 0.0 }\nGain = { initial = 0.0 }\n"
        )
        for name, start in (("bench_a.mf4", 0.0), ("bench_b.mf4", 0.25)):
            _record(tmp_path / name, start, twice)
        return Project.read(tmp_path / "kennfeld.toml")

    return write


def _record(path, start, twice):
    from asammdf import MDF, Signal

    fast, slow = np.arange(start, start + 5, 0.01), np.arange(0.1, 4, 0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with MDF(version="4.10") as file:
            file.append([Signal(1000 + 100 * fast, fast, name="Speed", unit="rpm")], comment="10ms")
            torque = [Signal(53 + 5 * slow, slow, name="Torque", unit="Nm")]
            again = [Signal(0 * slow, slow, name="Speed", unit="rpm")] if twice else []
            file.append(torque + again, comment="100ms", common_timebase=True)
            file.save(path, overwrite=True)


def test_a_project_calibrates_on_several_files_and_rasters(project):
    result = project("raster = 0.02").calibrate()
    assert result.parameters["Gain"].value == pytest.approx(0.05, rel=1e-6)
    assert result.parameters["Offset"].value == pytest.approx(3.0, rel=1e-6)


def test_a_missing_raster_is_reported_for_each_file(project):
    messages = [str(finding) for finding in project("").check() if "rasters" in finding.message]
    assert [line.split(":")[0] for line in messages] == ["bench_a.mf4", "bench_b.mf4"]
    assert "Give a raster in s, such as raster = 0.01." in messages[0]


def test_a_name_in_several_groups_must_be_chosen(project):
    messages = [str(finding) for finding in project("raster = 0.02", twice=True).check()]
    assert "bench_a.mf4: 2 channels are named Speed. Name one of them: 10ms/Speed, 100ms/Speed." in messages
    chosen = project("raster = 0.02", twice=True, channels='[channels]\nSpeed = "10ms/Speed"')
    assert not [f for f in chosen.check() if f.severity == "error"]
    assert chosen.calibrate().parameters["Gain"].value == pytest.approx(0.05, rel=1e-6)


def test_messages_about_groups_offer_what_the_project_would_say(project):
    def fixes(word, **settings):
        [finding] = [f for f in project(**settings).check() if word in f.message and f.location.file == "bench_a.mf4"]
        return [(fix.title, *fix.changes, fix.options) for fix in finding.fixes]

    assert fixes("named Speed", dataset="", twice=True) == [
        ("Read Speed from", (("channels", "Speed"), ""), ("10ms/Speed", "100ms/Speed"))
    ]
    # the input has another name than the channel
    other = {"dataset": "", "twice": True, "names": ("n", 'n = "Speed"')}
    assert fixes("named Speed", **other)[0][:2] == ("Read n from", (("channels", "n"), ""))
    # and so has the target
    target = {"dataset": "", "twice": True, "target": "Speed"}
    assert (("criterion", 1, "target", "channel"), "") in [each[1] for each in fixes("named Speed", **target)]
    assert fixes("rasters", dataset="") == [
        ("Set raster = 0.01", (("dataset", 1, "raster"), 0.01), ()),
        ("Set raster = 0.1", (("dataset", 1, "raster"), 0.1), ()),
    ]


def test_a_damaged_file_is_named(project, tmp_path):
    benches = project("raster = 0.02")
    path = tmp_path / "bench_b.mf4"
    path.write_bytes(path.read_bytes()[:600])
    with pytest.raises(InputError, match=r"bench_b\.mf4: the MDF file is damaged"):
        benches.calibrate()


def test_a_second_run_does_not_read_the_files_again(project, tmp_path, monkeypatch):
    first = project("raster = 0.02").problem().datasets[0]
    assert len(list((tmp_path / ".kennfeld" / "cache").glob("*.parquet"))) == 2
    monkeypatch.setattr("kennfeld.measurement.cache.read_leniently", None)
    monkeypatch.setattr("kennfeld.preprocessing.recordings.read_leniently", None)
    second = Project.read(tmp_path / "kennfeld.toml").problem().datasets[0]
    assert second.time.tolist() == first.time.tolist()
    assert all(second[name].values.tolist() == first[name].values.tolist() for name in first)
    assert second["Torque"].unit == "Nm"


def test_a_dataset_can_do_without_the_cache(project, tmp_path):
    assert project("raster = 0.02\ncache = false").problem().datasets[0].samples
    assert not (tmp_path / ".kennfeld").exists()


def test_missing_channels_are_cached(project, tmp_path, monkeypatch):
    from asammdf import MDF, Signal

    benches = project("raster = 0.02")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with MDF(version="4.10") as file:
            time = np.arange(0, 5, 0.01)
            file.append([Signal(1000 + 100 * time, time, name="Speed", unit="rpm")])
            file.save(tmp_path / "bench_b.mf4", overwrite=True)
    first = benches.problem().datasets[0]
    monkeypatch.setattr("kennfeld.measurement.cache.read_leniently", None)
    monkeypatch.setattr("kennfeld.preprocessing.recordings.describe", None)
    second = Project.read(tmp_path / "kennfeld.toml").problem().datasets[0]
    assert np.array_equal(first["Torque"].values, second["Torque"].values, equal_nan=True)
    assert np.isnan(first["Torque"].values).any()


@pytest.mark.slow
def test_a_further_run_loads_no_library_that_reads_files(project, tmp_path):
    project("raster = 0.02").problem()
    code = "import sys; from kennfeld.project import Project\n"
    code += f"assert Project.read({str(tmp_path / 'kennfeld.toml')!r}).problem()\n"
    code += "assert not {'asammdf', 'pandas'} & set(sys.modules)"
    for _ in range(3):  # where something disturbed the cache, a run reads the files and keeps them for the next
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        if done.returncode == 0:
            break
    assert done.returncode == 0, done.stderr

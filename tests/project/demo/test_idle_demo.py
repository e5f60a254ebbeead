"""The idle demo as a user sees it: the trained engine, the fitted gains, both tested on the physical engine."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.project.demo import closing, idle, prepare, projects, write
from kennfeld.surrogate import read_surrogate

ENGINE = idle.FILES["engine.toml"]
SHORT = {  # recordings, the size of the engine model and its training
    "recording.csv": lambda: idle.recording("recording", 0.5, 1),
    "other_recording.csv": lambda: idle.recording("other_recording", 0.15, 2, "test"),
    "engine.toml": lambda: (
        ENGINE().replace("centres = 150", "centres = 40").replace("iterations = 15", "iterations = 2")
    ),
}


@pytest.fixture(scope="module", params=["short", pytest.param("whole", marks=pytest.mark.slow)])
def demo(request, tmp_path_factory):
    folder, messages = tmp_path_factory.mktemp("idle") / "demo", []
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "short":
            patch.setattr(idle, "FILES", idle.FILES | SHORT)
        path = write("idle", folder)
    prepare("idle", folder, messages.append)
    assert any("free run" in line for line in messages)
    return path.parent


@pytest.fixture(scope="module")
def results(demo):
    from kennfeld.project.results import write as write_results

    fits = {}
    for file, folder in projects("idle"):
        project = kf.Project.read(demo / file)
        assert [finding for finding in project.check() if finding.severity == "error"] == []
        fits[file] = project.calibrate()
        write_results(fits[file], project, demo / folder)
    return fits


@pytest.mark.slow
def test_the_engine_runs_freely_on_another_recording(demo, request):
    rows = {(q.dataset, q.mode): q for q in read_surrogate(demo / "engine.json").quality}
    assert rows["another recording", "free run"].rmse < (60 if request.node.callspec.params["demo"] == "short" else 15)
    assert rows["another recording", "free run"].use == "test"


def test_the_engine_is_trained_once(demo):
    before = (demo / "engine.json").stat().st_mtime_ns
    prepare("idle", demo, lambda line: pytest.fail("trained again"))
    assert (demo / "engine.json").stat().st_mtime_ns == before


@pytest.mark.slow
def test_the_gains_are_found_from_zero(results):
    free = results["kennfeld.toml"]
    assert free.converged
    assert free.start["Kp"].value == free.start["Ki"].value == 0
    assert free.quality[0].rmse_after < 0.25 * free.quality[0].rmse_before
    assert free.parameters["Ki"].value > 0


def test_the_limit_is_kept_and_costs_something(demo, results):
    free, limited = results["kennfeld.toml"], results["limited.toml"]
    assert limited.converged
    assert limited.cost_after > free.cost_after
    overshoot = {
        file: kf.Project.read(demo / file).simulate(results[file].parameters)[0]["overshoot"].values.max()
        for file in results
    }
    assert overshoot["kennfeld.toml"] > 50
    assert overshoot["limited.toml"] < 10.1


def test_the_physical_engine_agrees(demo, results):
    head, free, limited = closing("idle", demo)
    assert head[-1] == "overshoot, rpm"
    for row, file in ((free, "kennfeld.toml"), (limited, "limited.toml")):
        assert float(row[3]) == pytest.approx(results[file].quality[0].rmse_after, rel=0.05)
    assert float(free[4]) > 50
    assert float(limited[4]) < 25


def test_the_plant_keeps_its_numbers_and_has_a_file_of_its_own(demo, results):
    engine = results["kennfeld.toml"].parameters["engine"]
    assert engine.expansion == read_surrogate(demo / "engine.json").expansion
    assert "engine" not in (demo / "results" / "parameters.json").read_text()


def test_the_recordings_differ_from_the_set_value_drive():
    training, set_values = idle.recording("a", 0.2, 1), idle.set_values()
    assert "n_set" not in training
    assert np.ptp(set_values["load"].values) > 0
    assert training["throttle"].values.min() >= idle.THROTTLE[0]
    assert training["throttle"].values.max() <= idle.THROTTLE[1]

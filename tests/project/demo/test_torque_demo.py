import tomllib
from pathlib import Path

import numpy as np
import pytest

from kennfeld import InputError, formula, read, read_parameters
from kennfeld.cli import run
from kennfeld.project import Project
from kennfeld.project.demo import engine, torque, write


@pytest.fixture
def project(tmp_path):
    return Project.read(write("torque", tmp_path / "demo"))


def test_the_bench_is_full_factorial_and_met_nearly():
    bench = torque.bench()
    assert bench.samples == 2812
    assert len(np.unique(bench["Ignition"].values.round(-1))) == 4


def test_the_best_spark_gives_the_greatest_torque():
    speed, air = np.array([1500.0, 4000.0]), np.array([40.0, 90.0])
    best = engine.best_spark(speed, air)
    top = engine.torque(speed, air, best)
    assert np.all(top > engine.torque(speed, air, best + 1))
    assert np.all(top > engine.torque(speed, air, best - 1))


def test_the_start_is_as_bad_as_the_papers_and_as_large(project):
    problem = project.problem()
    assert sum(problem.parameters[name].size for name in problem.free_names) == 519
    model, bench = project.simulate()[0], torque.bench()
    error = model["TorquePredict"].values - bench["Torque"].values
    assert np.sqrt(np.mean(error**2)) == pytest.approx(76.38, rel=0.01)


def test_fresh_points_are_met_to_the_noise(project):
    training, test = project.calibrate().quality
    assert test.use == "test"
    assert test.rmse_after <= 1.1 * torque.NOISE
    assert training.rmse_after < torque.NOISE


@pytest.mark.parametrize("seed", [3, 4])
def test_other_noise_gives_the_same_picture(project, seed):
    from kennfeld import Options, Pin, calibrate

    result = calibrate(
        formula(torque.FORMULA, parameters=list(torque.start())),
        torque.bench(seed),
        torque.start(),
        "Torque",
        node="TorquePredict",
        test=torque.fresh(seed=seed + 1),
        smoothness=torque.SMOOTHNESS,
        limits=torque.BOUNDS,
        pins=[Pin(*torque.PIN)],
        options=Options(continuation="off"),
    )
    assert result.quality[1].rmse_after <= 1.1 * torque.NOISE


def test_limits_hold_exactly(project):
    parameters = project.calibrate().parameters
    eta = parameters["CurveEtaDeltaSpark"]
    assert eta.values[list(eta.axes[0].breakpoints).index(0.0)] == pytest.approx(1.0, abs=1e-9)
    for name, (low, high) in torque.BOUNDS.items():
        assert low <= parameters[name].values.min()
        assert parameters[name].values.max() <= high


def test_the_project_file_says_what_the_module_says(project):
    text = tomllib.loads(project.path.read_text(encoding="utf-8"))
    tables = text["parameters"]
    assert {name: table["smoothness"] for name, table in tables.items()} == torque.SMOOTHNESS
    assert {n: tuple(t["bounds"]) for n, t in tables.items() if "bounds" in t} == torque.BOUNDS
    name, at, value = torque.PIN
    assert tables[name]["pin"] == [{"at": list(at), "value": value}]


def test_what_is_written_is_what_was_made(project):
    folder = project.path.parent
    bench = torque.bench()
    written = read(folder / "bench.csv")
    for name in bench:
        assert np.array_equal(written[name].values, bench[name].values)
        assert written[name].unit == bench[name].unit
    start = read_parameters(folder / "start.dcm")
    for name, parameter in torque.start().items():
        assert np.allclose(start[name].values, parameter.values, rtol=1e-12)
    assert (folder / "torque.kf").read_text(encoding="utf-8") == torque.FORMULA


def test_a_demo_that_is_there_already_keeps_every_change(tmp_path):
    path = write("torque", tmp_path)
    changed = path.read_text(encoding="utf-8") + "# mine\n"
    path.write_text(changed, encoding="utf-8")
    (tmp_path / "fresh.csv").unlink()
    write("torque", tmp_path)
    assert path.read_text(encoding="utf-8") == changed
    assert (tmp_path / "fresh.csv").exists()
    assert not list(tmp_path.glob(".*"))


def test_a_folder_that_holds_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious", encoding="utf-8")
    with pytest.raises(InputError, match=r"not this demo.*--dir"):
        write("torque", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_project_of_ones_own_is_no_demo(tmp_path):
    (tmp_path / "kennfeld.toml").write_text('[model]\nfile = "mine.kf"\n', encoding="utf-8")
    with pytest.raises(InputError, match="not this demo"):
        write("torque", tmp_path)


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "demo").write_text("a file", encoding="utf-8")
    with pytest.raises(InputError, match="--dir"):
        write("torque", tmp_path / "demo")


def test_an_unknown_demo_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match="Did you mean torque"):
        write("torqe", tmp_path / "demo")
    assert not (tmp_path / "demo").exists()


def test_the_command_runs_it_and_says_what_the_noise_is(tmp_path, capsys):
    assert run(["demo", "torque", "--dir", str(tmp_path / "demo")]) == 0
    said = capsys.readouterr().out
    assert "1.8 Nm" in said
    assert "converged" in said
    open_ones = said.partition("What the data leave open:\n")[2].split("\n")
    assert "Scaling MapOptTorque by 1.01, stretching CurveEtaDeltaSpark about 1" in open_ones[0]
    assert "Pin a value of CurveEtaDeltaSpark that you know" in open_ones[0]
    assert {path.name for path in Path(tmp_path / "demo" / "results").iterdir()} >= {"result.json", "parameters.dcm"}

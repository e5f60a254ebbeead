import tomllib
from pathlib import Path

import numpy as np
import pytest

from kennfeld import InputError, formula, read, read_parameters
from kennfeld.cli import run
from kennfeld.project import Project
from kennfeld.project.demo import petrol_engine, torque, write
from tests.draws import mostly_slow


@pytest.fixture
def project(tmp_path):
    return Project.read(write("torque", tmp_path / "demo"))


@pytest.fixture
def load_only(project):
    """The same without motored points: the problem of the paper."""
    return Project.read(project.path.with_name("load-only.toml"))


def errors_of_tables(parameters):
    """The root mean square difference of each map from the engine's own, at its grid points."""
    truths = {
        "MapOptTorque": lambda n, air: (
            petrol_engine.torque(n, air, petrol_engine.best_spark(n, air)) + petrol_engine.drag(n)
        ),
        "MapOptIgnition": petrol_engine.best_spark,
        "MapDragTorque": lambda n, air: petrol_engine.drag(n),
    }
    errors = {}
    for name, truth in truths.items():
        grid = np.meshgrid(*[axis.breakpoints for axis in parameters[name].axes], indexing="ij")
        errors[name] = float(np.sqrt(np.mean((parameters[name].values - truth(*grid)) ** 2)))
    return errors


def test_the_bench_is_full_factorial_with_small_deviations():
    bench = torque.bench()
    assert bench.samples == 2812
    assert len(np.unique(bench["Ignition"].values.round(-1))) == 4


def test_the_best_spark_gives_the_greatest_torque():
    speed, air = np.array([1500.0, 4000.0]), np.array([40.0, 90.0])
    best = petrol_engine.best_spark(speed, air)
    top = petrol_engine.torque(speed, air, best)
    assert np.all(top > petrol_engine.torque(speed, air, best + 1))
    assert np.all(top > petrol_engine.torque(speed, air, best - 1))


def test_without_charge_the_engine_drags():
    """Crossley and Cook: 181.3 - 138.7 Nm, and what changes with speed, here 0 and 100 rad/s."""
    speed = np.array([0.0, 100.0]) * 30 / np.pi
    assert petrol_engine.drag(speed) == pytest.approx([42.6, 42.6 - 2.7 + 1.07], abs=0.02)


def test_the_efficiency_is_1_at_the_best_spark_and_falls_on_both_sides():
    speed, air = np.array([1500.0, 4000.0]), np.array([40.0, 90.0])
    assert petrol_engine.efficiency(speed, air, np.zeros(2)) == pytest.approx(1.0)
    assert np.all(petrol_engine.efficiency(speed, air, np.full(2, 20.0)) < 0.97)
    assert petrol_engine.efficiency(speed, air, np.full(2, 20.0)) == pytest.approx(
        petrol_engine.efficiency(speed, air, -20.0)
    )


def test_motored_points_are_few_and_measure_the_drag():
    motored = torque.motored()
    error = motored["MotoringTorque"].values - petrol_engine.drag(motored["Speed"].values)
    assert motored.samples == 27
    assert np.sqrt(np.mean(error**2)) == pytest.approx(torque.NOISE, rel=0.3)


@pytest.mark.slow
def test_motored_points_give_maps_of_physical_values(project, load_only):
    """Load alone leaves torque and drag to each other; the error of the torque is the same."""
    with_motored, without = project.calibrate(), load_only.calibrate()
    right, wrong = (errors_of_tables(result.parameters) for result in (with_motored, without))
    assert right["MapOptTorque"] < 2.0
    assert right["MapDragTorque"] < 2.0
    assert right["MapOptIgnition"] < 1.0
    assert with_motored.parameters["MapDragTorque"].values.min() > 35
    assert wrong["MapDragTorque"] > 20
    last = [result.quality[-2 if result is with_motored else -1] for result in (with_motored, without)]
    assert last[0].rmse_after == pytest.approx(last[1].rmse_after, rel=0.05)
    assert len(with_motored.trust.directions) <= 2 < len(without.trust.directions)


def test_a_project_without_problems_is_reported_as_such(project, load_only):
    assert project.check() == load_only.check() == []


@pytest.mark.parametrize("name", ["project", "load_only"])
def test_the_start_has_the_published_size_and_error(name, request):
    chosen = request.getfixturevalue(name)
    problem = chosen.problem()
    assert sum(problem.parameters[name].size for name in problem.free_names) == 519
    model, bench = chosen.simulate()[0], torque.bench()
    error = model["TorquePredict"].values - bench["Torque"].values
    assert np.sqrt(np.mean(error**2)) == pytest.approx(76.38, rel=0.01)


def test_fresh_points_are_predicted_to_the_noise(project):
    rows = {(q.criterion, q.dataset): q for q in project.calibrate().quality}
    training, test = rows["TorquePredict", "bench"], rows["TorquePredict", "fresh"]
    assert test.use == "test"
    assert test.rmse_after <= 1.1 * torque.NOISE
    assert training.rmse_after < torque.NOISE


@pytest.mark.parametrize("seed", mostly_slow([3, 4], 1))
def test_other_noise_gives_similar_errors(project, seed):
    from kennfeld import Options, Pin, calibrate

    result = calibrate(
        formula(torque.FORMULA, parameters=list(torque.start())),
        torque.bench(seed),
        torque.start(),
        "Torque",
        node="TorquePredict",
        test=torque.fresh(seed=seed + 1),
        smoothness=torque.SMOOTHNESS,
        bounds=torque.BOUNDS,
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


def test_the_project_file_without_motored_points_agrees_with_the_module(load_only):
    text = tomllib.loads(load_only.path.read_text(encoding="utf-8"))
    tables = text["parameters"]
    assert {name: table["smoothness"] for name, table in tables.items()} == torque.SMOOTHNESS
    assert {n: tuple(t["bounds"]) for n, t in tables.items() if "bounds" in t} == torque.BOUNDS
    name, at, value = torque.PIN
    assert tables[name]["pin"] == [{"at": list(at), "value": value}]


def test_the_project_file_adds_knowledge_of_an_engineer(project, load_only):
    ours, theirs = (tomllib.loads(p.path.read_text(encoding="utf-8")) for p in (project, load_only))
    assert [data["name"] for data in ours["dataset"]] == ["bench", "motored", "fresh"]
    for name, table in theirs["parameters"].items():
        assert table.items() <= ours["parameters"][name].items()
    best = ours["parameters"]["MapOptIgnition"]["pin"][0]
    assert best["value"] == pytest.approx(float(petrol_engine.best_spark(*np.array(best["at"])[:, None])[0]), abs=0.5)


def test_files_contain_the_data_of_the_module(project):
    folder = project.path.parent
    for dataset in (torque.bench(), torque.motored()):
        written = read(folder / f"{dataset.name}.csv")
        for name in dataset:
            assert np.array_equal(written[name].values, dataset[name].values)
            assert written[name].unit == dataset[name].unit
    start = read_parameters(folder / "start.dcm")
    for name, parameter in torque.start().items():
        assert np.allclose(start[name].values, parameter.values, rtol=1e-12)
    assert (folder / "torque.kf").read_text(encoding="utf-8") == torque.FORMULA


def test_an_existing_demo_keeps_every_change(tmp_path):
    path = write("torque", tmp_path)
    changed = path.read_text(encoding="utf-8") + "# mine\n"
    path.write_text(changed, encoding="utf-8")
    (tmp_path / "fresh.csv").unlink()
    write("torque", tmp_path)
    assert path.read_text(encoding="utf-8") == changed
    assert (tmp_path / "fresh.csv").exists()
    assert not list(tmp_path.glob(".*"))


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious", encoding="utf-8")
    with pytest.raises(InputError, match=r"not contain this demo.*--dir"):
        write("torque", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_project_of_the_user_does_not_count_as_a_demo(tmp_path):
    (tmp_path / "kennfeld.toml").write_text('[model]\nfile = "mine.kf"\n', encoding="utf-8")
    with pytest.raises(InputError, match="not contain this demo"):
        write("torque", tmp_path)


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "demo").write_text("a file", encoding="utf-8")
    with pytest.raises(InputError, match="--dir"):
        write("torque", tmp_path / "demo")


def test_an_unknown_demo_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match="Did you mean torque"):
        write("torqe", tmp_path / "demo")
    assert not (tmp_path / "demo").exists()


@pytest.mark.slow
def test_the_command_runs_the_demo_and_states_the_noise(tmp_path, capsys):
    assert run(["demo", "torque", "--dir", str(tmp_path / "demo")]) == 0
    output = capsys.readouterr().out
    assert "1.8 Nm" in output
    assert "converged" in output
    open_ones = output.partition("Coupled, but determined:\n")[2].split("\n")
    assert "Scaling MapOptTorque by 1.01 and raising MapDragTorque by 1.7 Nm" in open_ones[0]
    assert "standard deviation 0.2" in open_ones[0]
    assert "nan" not in output
    assert {path.name for path in Path(tmp_path / "demo" / "results").iterdir()} >= {"result.json", "parameters.dcm"}

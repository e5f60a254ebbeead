"""Calibrations on a Dask cluster of real processes: the same bits as in one process, whatever happens to workers."""

import os
import signal
import sys
import threading
import time

import numpy as np
import pytest
from pyarrow import parquet

from kennfeld.analysis.cross_validation import cross_validate
from kennfeld.cli import run
from kennfeld.dask_runner import DaskRunner
from kennfeld.errors import InputError
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.solver.levenberg_marquardt import Stop
from kennfeld.project import Project
from kennfeld.project.results import write_simulation
from kennfeld.report import document
from tests.project.cluster_processes import (
    SHORT,
    Cluster,
    calibrate,
    free_port,
    values_of,
    write_short,
    write_short_drives,
)
from tests.project.partitioned_projects import (
    SHIFTED,
    STEADY,
    TIMED,
    in_partitions,
    write_shifted,
    write_steady,
    write_timed,
)
from tests.report.report_projects import Page

pytest.importorskip("distributed", reason="dask.distributed is not installed: pip install kennfeld[cluster]")


@pytest.fixture
def cluster(tmp_path):
    made = Cluster(tmp_path, 2)
    yield made
    made.close()


@pytest.mark.parametrize("write", [write_short, write_short_drives])
def test_any_number_of_workers_gives_the_same_bits(tmp_path, write, cluster):
    path = write(tmp_path)
    serial = calibrate(in_partitions(path, 400))
    several = calibrate(in_partitions(path, 400, scheduler=cluster.address))
    cluster.kill_worker(1)
    single = calibrate(in_partitions(path, 400, scheduler=cluster.address))
    for result in (several, single):
        assert np.array_equal(values_of(result), values_of(serial))
        assert result.cost_after == serial.cost_after
        assert result.quality == serial.quality
        assert all(np.array_equal(result.trust.deviation[n], serial.trust.deviation[n]) for n in serial.trust.deviation)


def test_choices_of_smoothness_and_shift_are_the_same_bits(tmp_path, cluster, monkeypatch):
    monkeypatch.setattr("kennfeld.optimize.tuning.shift_estimation.SCANNED_SAMPLES", 900)
    monkeypatch.setattr("kennfeld.optimize.partitions.LEAST_STRETCH", 300)
    path = write_shifted(tmp_path, text=SHIFTED.replace("smoothness = 1e-4", 'smoothness = "auto"'))
    serial = calibrate(in_partitions(path, 1000))
    several = calibrate(in_partitions(path, 1000, scheduler=cluster.address))
    cluster.kill_worker(1)
    single = calibrate(in_partitions(path, 1000, scheduler=cluster.address))
    for result in (several, single):
        assert result.shifts == serial.shifts
        assert result.smoothness == serial.smoothness
        assert result.message == serial.message
        assert np.array_equal(values_of(result), values_of(serial))
        assert result.quality == serial.quality
    assert "Shifts were scanned on " in serial.message


def test_a_scheduler_that_dies_while_smoothness_is_chosen_ends_with_the_best_values(tmp_path, cluster):
    path = write_steady(tmp_path, text=STEADY.replace("smoothness = 0.01", 'smoothness = "auto"'))
    stages = []

    def kill_scheduler(line):
        stages.append(line.stage)
        if line.stage == "smoothness 2":
            cluster.scheduler.kill()

    result = calibrate(in_partitions(path, 600, scheduler=cluster.address), kill_scheduler)
    assert result.status == "stopped"
    assert f"the scheduler at {cluster.address} is gone" in result.message
    assert result.cost_after < result.cost_before
    assert stages[-1] == "smoothness 2"


def test_limits_of_outputs_give_the_same_bits(tmp_path, cluster):
    limit = '\n[[limit]]\nnode = "Lagged"\nmax = 2.0\nwhere = "u > 0.1"\n'
    path = write_timed(tmp_path, text=TIMED + limit + SHORT + "tolerance = 1e-3\n")
    serial = calibrate(in_partitions(path, 400))
    assert any(line.stage.startswith("limits") for line in serial.trace)
    several = calibrate(in_partitions(path, 400, scheduler=cluster.address, folder=str(tmp_path / "several")))
    cluster.kill_worker(1)
    single = calibrate(in_partitions(path, 400, scheduler=cluster.address))
    for result in (several, single):
        assert np.array_equal(values_of(result), values_of(serial))
        assert result.cost_after == serial.cost_after
        assert result.trust.holdings == serial.trust.holdings


def test_a_search_that_begins_with_some_recordings_gives_the_same_bits(tmp_path, cluster, monkeypatch):
    monkeypatch.setattr("kennfeld.optimize.compiled.SEARCH_PIECE_SAMPLES", 1500)  # read in this process only
    path = write_timed(tmp_path, files=24, samples=100, text=TIMED)
    serial = calibrate(in_partitions(path, 2000))
    assert {line.stage for line in serial.trace} == {"plain", "final"}
    several = calibrate(in_partitions(path, 2000, scheduler=cluster.address))
    assert np.array_equal(values_of(several), values_of(serial))
    assert several.cost_after == serial.cost_after


def test_a_simulation_on_workers_gives_the_same_table(tmp_path, cluster):
    path, tables = write_short_drives(tmp_path), []
    for project in (Project.read(path), in_partitions(path, 400, scheduler=cluster.address)):
        file = write_simulation(project.simulation(), tmp_path / "simulation.parquet")
        project.close()
        tables.append(parquet.read_table(file))
    assert tables[0].to_pydict() == tables[1].to_pydict()


def test_a_report_on_workers_has_the_same_figures(tmp_path, cluster):
    path, figures = write_short_drives(tmp_path), []
    result = calibrate(in_partitions(path, 400))
    for project in (in_partitions(path, 400), in_partitions(path, 400, scheduler=cluster.address)):
        figures.append(Page(document(project, result)).data["figures"])
        project.close()
    assert figures[1] == figures[0]


def test_processes_of_this_machine_give_the_same_bits(tmp_path):
    path = write_short(tmp_path)
    serial = calibrate(in_partitions(path, 400))
    lines = []
    project = in_partitions(path, 400).on_cluster(workers=2, report=lines.append)
    assert np.array_equal(values_of(calibrate(project)), values_of(serial))
    assert lines[0].startswith("cluster: 2 workers at tcp://")
    assert "dashboard http://" in lines[0]
    assert [line.split(":")[0] for line in lines[1:]] == ["worker 0", "worker 1"]


def test_a_killed_worker_costs_its_tasks_only(tmp_path, cluster):
    path = write_short(tmp_path)
    serial = calibrate(in_partitions(path, 400))
    killed = []

    def kill_one(line):
        if not killed:
            killed.append(cluster.workers[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    result = calibrate(in_partitions(path, 400, scheduler=cluster.address), kill_one)
    assert killed
    assert np.array_equal(values_of(result), values_of(serial))


def test_all_workers_may_be_replaced(tmp_path, cluster):
    path = write_short(tmp_path)
    serial = calibrate(in_partitions(path, 400))
    done = []

    def replace_all(line):
        if not done:
            done.append(line)
            for worker in cluster.workers:
                worker.kill()
            threading.Timer(1.0, lambda: cluster.workers.append(cluster.add_worker("later"))).start()

    result = calibrate(in_partitions(path, 400, scheduler=cluster.address), replace_all)
    assert np.array_equal(values_of(result), values_of(serial))


def test_a_killed_scheduler_ends_with_the_best_values(tmp_path, cluster):
    path = write_short(tmp_path)
    costs = []

    def kill_scheduler(line):
        costs.append(line.cost)
        if line.stage == "plain" and line.iteration == 2:
            cluster.scheduler.kill()

    result = calibrate(in_partitions(path, 400, scheduler=cluster.address), kill_scheduler)
    assert result.status == "stopped"
    assert f"the scheduler at {cluster.address} is gone" in result.message
    assert result.cost_after == costs[-1]
    assert not np.array_equal(
        values_of(result), np.concatenate([np.ravel(result.start[n].values) for n in result.start])
    )
    serial = in_partitions(path, 400)
    compiled = CompiledProblem(serial.problem())
    objective = compiled.sums.cost(compiled.values.pack(result.parameters))
    assert (
        objective + compiled.roughness.cost(compiled.values.pack(result.parameters)[: compiled.values.free])
        == costs[-1]
    )


def test_a_killed_scheduler_leaves_results(tmp_path, cluster, capsys):
    path = write_short(tmp_path)
    settings = f'save_every = 1\n[cluster]\nscheduler = "{cluster.address}"\npartition = 400\n'
    path.write_text(path.read_text() + settings)
    out = tmp_path / "out"
    threading.Thread(target=_kill_after_first_step, args=(out, cluster), daemon=True).start()
    assert run(["calibrate", str(path), "-o", str(out)]) == 1
    assert (out / "parameters.json").is_file()
    assert "stopped: " in capsys.readouterr().out


def _kill_after_first_step(folder, cluster):
    while not list(folder.glob("saves/*.json")):
        time.sleep(0.02)
    cluster.scheduler.kill()


def test_a_scheduler_that_dies_while_files_are_read_is_an_error(tmp_path, cluster, capsys, monkeypatch):
    path, map_tasks = write_short(tmp_path), DaskRunner.map
    for worker in range(2):
        cluster.kill_worker(worker)

    def map_and_kill(self, *arguments):
        threading.Timer(1.0, cluster.scheduler.kill).start()
        return map_tasks(self, *arguments)

    monkeypatch.setattr(DaskRunner, "map", map_and_kill)
    assert run(["calibrate", str(path), "--scheduler", cluster.address]) == 2
    assert f"the scheduler at {cluster.address} is gone" in capsys.readouterr().err


def test_a_file_that_fails_on_a_worker_names_file_worker_and_reason(tmp_path, cluster):
    path = write_short(tmp_path)
    (tmp_path / "bench_2.csv").write_bytes(b"PK\x03\x04 damaged")
    project = in_partitions(path, 400, scheduler=cluster.address)
    messages = [str(finding) for finding in project.check() if finding.severity == "error"]
    project.close()
    (message,) = messages
    assert "bench_2.csv" in message
    assert "(on worker worker-" in message


def test_a_file_that_vanishes_while_a_calibration_runs_names_it(tmp_path, cluster):
    path = write_short(tmp_path)
    project = in_partitions(path, 400, scheduler=cluster.address)
    problem = project.problem()
    (tmp_path / "bench_1.csv").unlink()
    for entry in (tmp_path / ".kennfeld" / "partitions").iterdir():
        entry.unlink()
    with pytest.raises(InputError, match=r"bench_1\.csv.*no such file on this machine \(on worker worker-"):
        CompiledProblem(problem).sums.cost(CompiledProblem(problem).start)
    project.close()


def test_a_scheduler_that_does_not_answer_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr("kennfeld.dask_runner.CONNECT_TIMEOUT", 1.0)
    address = f"tcp://127.0.0.1:{free_port()}"
    (finding,) = in_partitions(write_short(tmp_path), 400, scheduler=address).check()
    assert str(finding).startswith(f"scheduler {address}: does not answer")


def test_without_the_library_the_remedy_is_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    (finding,) = in_partitions(write_short(tmp_path), 400, scheduler="tcp://127.0.0.1:1").check()
    assert str(finding) == '[cluster]: the package distributed is not installed. Run: pip install "kennfeld[cluster]"'


def test_the_command_joins_the_scheduler_that_it_is_given(tmp_path, cluster, capsys):
    path = write_short(tmp_path)
    assert (
        run(["calibrate", str(path), "--scheduler", cluster.address, "-o", str(tmp_path / "out")]) == 1
    )  # max_iterations
    assert f"at {cluster.address}; dashboard" in capsys.readouterr().err
    assert (tmp_path / "out" / "report.html").is_file()


def whole_on(path, address):
    """A project whose data are read here, and whose starts and folds are tasks of a cluster."""
    return in_partitions(path, 0, scheduler=address)


def test_starts_are_tasks_of_a_cluster(tmp_path, cluster):
    path = write_steady(tmp_path, text=STEADY + SHORT + "starts = 3\nsave_every = 4\n")
    local = Project.read(path).calibrate(workers=1)
    lines = []
    project = whole_on(path, cluster.address)
    result = calibrate(project, lines.append)
    assert np.array_equal(values_of(result), values_of(local))
    assert [row.cost_after for row in result.starts] == [row.cost_after for row in local.starts]
    assert {line.start for line in lines} == {1, 2, 3}
    assert list((tmp_path / "results" / "saves").glob("3-*.json"))


def test_starts_on_a_cluster_stop_at_their_best_values(tmp_path, cluster):
    path = write_steady(tmp_path, text=STEADY + SHORT.replace("12", "200") + "starts = 3\n")

    def stop(line):
        if line.iteration >= 3:
            raise Stop

    result = calibrate(whole_on(path, cluster.address), stop)
    assert result.status == "stopped"
    assert result.cost_after < result.cost_before


def test_folds_are_tasks_of_a_cluster(tmp_path, cluster):
    path = write_short(tmp_path)
    local = cross_validate(Project.read(path).problem(), folds=3, options=Project.read(path).options)
    project = whole_on(path, cluster.address)
    lines = []
    remote = cross_validate(project.problem(), folds=3, options=project.options, progress=lines.append)
    project.close()
    assert remote == local
    assert {line.stage.split()[1] for line in lines} == {"1", "2", "3"}

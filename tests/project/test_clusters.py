"""Calibrations on a Dask cluster of real processes: the same bits as in one process, whatever happens to workers."""

import os
import signal
import sys
import threading
import time
from importlib import import_module
from importlib.util import find_spec

import numpy as np
import pytest
from pyarrow import parquet

from kennfeld.analysis.cross_validation import cross_validate
from kennfeld.base.dask_runner import ClusterAddress, DaskRunner
from kennfeld.base.errors import InputError
from kennfeld.cli import run
from kennfeld.optimize.solver.levenberg_marquardt import Stop
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.project import Project
from kennfeld.project.results import write_simulation
from kennfeld.report import document
from tests.project.cluster_processes import (
    FIXED,
    SHORT,
    SIZE,
    calibrate,
    free_port,
    start_method,
    values_of,
    write_short,
    write_short_drives,
    write_short_with_quantiles,
)
from tests.project.partitioned_projects import (
    SHIFTED,
    TIMED,
    in_partitions,
    write_shifted,
    write_steady,
    write_timed,
)
from tests.report.report_projects import Page

pytestmark = [
    pytest.mark.bits,
    pytest.mark.skipif(
        find_spec("distributed") is None, reason="dask.distributed is not installed: pip install kennfeld[cluster]"
    ),
]


def assert_same_bits(result, serial):
    assert np.array_equal(values_of(result), values_of(serial))
    assert result.cost_after == serial.cost_after
    assert result.quality == serial.quality
    assert all(np.array_equal(result.trust.deviation[n], serial.trust.deviation[n]) for n in serial.trust.deviation)


def on_two_workers_and_on_the_last(path, size, cluster):
    """Calibrate on two workers, and on one after the other was killed."""
    yield calibrate(in_partitions(path, size, scheduler=cluster.address))
    cluster.kill_worker(1)
    yield calibrate(in_partitions(path, size, scheduler=cluster.address))


def test_two_workers_give_the_same_bits_as_this_process(tmp_path, shared_cluster):
    path = write_short_drives(tmp_path)
    serial = calibrate(in_partitions(path, SIZE))
    assert_same_bits(calibrate(in_partitions(path, SIZE, scheduler=shared_cluster.address)), serial)


def test_several_users_of_a_cluster_get_their_own_results(shared_cluster):
    def joined(shared, item, arguments):
        return b" ".join([shared, item, arguments])

    runners = [DaskRunner.start(ClusterAddress(shared_cluster.address)) for _ in range(2)]
    items = [b"1", b"2", b"3"]
    try:
        # both at once: what the first one has asked for stays known to the scheduler
        runs = [runner.map(joined, owner, items, owner) for runner, owner in zip(runners, (b"a", b"b"), strict=True)]
        assert [list(run) for run in zip(*runs, strict=True)] == [[b"a %d a" % k, b"b %d b" % k] for k in (1, 2, 3)]
    finally:
        for runner in runners:
            runner.close()


@pytest.mark.slow
def test_any_number_of_workers_gives_the_same_bits(tmp_path, start_cluster):
    path = write_short_with_quantiles(tmp_path)
    serial = calibrate(in_partitions(path, SIZE))
    for result in on_two_workers_and_on_the_last(path, SIZE, start_cluster(2)):
        assert_same_bits(result, serial)


def scan_a_part(monkeypatch, samples):
    monkeypatch.setattr("kennfeld.optimize.tuning.shift_estimation.SCANNED_SAMPLES", samples)
    monkeypatch.setattr("kennfeld.optimize.problem.partitions.LEAST_STRETCH", samples // 3)


@pytest.mark.slow
def test_choices_of_smoothness_and_shift_are_the_same_bits(tmp_path, shared_cluster, monkeypatch):
    scan_a_part(monkeypatch, 200)
    monkeypatch.setattr("kennfeld.optimize.tuning.shift_estimation.WINDOW", 6)
    text = SHIFTED.replace("smoothness = 1e-4", 'smoothness = "auto"') + SHORT
    path = write_shifted(tmp_path, "none", text=text, files=2, samples=200)
    serial, remote = (
        calibrate(in_partitions(path, 250, scheduler=address)) for address in ("", shared_cluster.address)
    )
    assert remote.shifts == serial.shifts
    assert remote.smoothness == serial.smoothness
    assert remote.message == serial.message
    assert "Shifts were scanned on " in serial.message
    assert_same_bits(remote, serial)


def write_automatic(folder):
    text = FIXED.replace("1.0\nsmoothness = 0.01", '1.0\nsmoothness = "auto"') + SHORT.replace("= 3", "= 2")
    return write_steady(folder, files=2, samples=120, text=text)


@pytest.mark.slow
def test_a_scheduler_that_dies_while_smoothness_is_chosen_ends_with_the_best_values(tmp_path, start_cluster):
    path, cluster, lines = write_automatic(tmp_path), start_cluster(1), []

    def kill_scheduler(line):
        lines.append(line)
        if line.stage == "smoothness 2":
            cluster.scheduler.kill()

    result = calibrate(in_partitions(path, SIZE, scheduler=cluster.address), kill_scheduler)
    assert result.status == "stopped"
    assert f"the scheduler at {cluster.address} is gone" in result.message
    assert result.cost_after < result.cost_before
    assert lines[-1].stage == "smoothness 2"

    def stop(line):
        if line.stage == "smoothness 2":
            raise Stop

    serial = calibrate(in_partitions(path, SIZE), stop)
    assert [(line.stage, line.cost) for line in lines] == [(line.stage, line.cost) for line in serial.trace]


LIMIT = '\n[[limit]]\nnode = "Lagged"\nmax = 2.0\nwhere = "u > 0.1"\n'


@pytest.mark.slow
def test_limits_of_outputs_give_the_same_bits(tmp_path, shared_cluster):
    text = TIMED.replace("count = 5", "count = 3") + LIMIT + SHORT + "tolerance = 1e-2\n"
    path = write_timed(tmp_path, files=2, samples=120, text=text)
    serial = calibrate(in_partitions(path, 120))
    assert any(line.stage.startswith("limits") for line in serial.trace)
    remote = calibrate(in_partitions(path, 120, scheduler=shared_cluster.address, folder=str(tmp_path / "remote")))
    assert_same_bits(remote, serial)
    assert remote.trust.holdings == serial.trust.holdings


@pytest.mark.slow
def test_a_search_that_begins_with_some_recordings_gives_the_same_bits(tmp_path, shared_cluster, monkeypatch):
    monkeypatch.setattr("kennfeld.optimize.sums.compiled.SEARCH_PIECE_SAMPLES", 300)  # read in this process only
    monkeypatch.setattr("kennfeld.optimize.sums.compiled.SEARCH_PIECES", 4)
    path = write_timed(tmp_path, files=10, samples=80, text=TIMED + SHORT, growth=10)
    serial = calibrate(in_partitions(path, 400))
    assert {line.stage for line in serial.trace} == {"plain", "final"}
    assert_same_bits(calibrate(in_partitions(path, 400, scheduler=shared_cluster.address)), serial)


def test_a_simulation_on_workers_gives_the_same_table(tmp_path, shared_cluster):
    path, tables = write_short_drives(tmp_path), []
    for project in (Project.read(path), in_partitions(path, SIZE, scheduler=shared_cluster.address)):
        file = write_simulation(project.simulation(), tmp_path / "simulation.parquet")
        project.close()
        tables.append(parquet.read_table(file))
    assert tables[0].to_pydict() == tables[1].to_pydict()


@pytest.mark.slow
def test_a_report_on_workers_has_the_same_figures(tmp_path, shared_cluster):
    path, figures = write_short_drives(tmp_path), []
    result = calibrate(in_partitions(path, SIZE))
    for project in (in_partitions(path, SIZE), in_partitions(path, SIZE, scheduler=shared_cluster.address)):
        figures.append(Page(document(project, result)).data["figures"])
        project.close()
    assert figures[1] == figures[0]


@pytest.mark.slow
def test_processes_of_this_machine_give_the_same_bits(tmp_path):
    path = write_short(tmp_path)
    serial = calibrate(in_partitions(path, SIZE))
    lines = []
    with import_module("dask").config.set({"distributed.worker.multiprocessing-method": start_method()}):
        project = in_partitions(path, SIZE).on_cluster(workers=2, report=lines.append)
        assert np.array_equal(values_of(calibrate(project)), values_of(serial))
    assert lines[0].startswith("cluster: 2 workers at tcp://")
    assert "dashboard http://" in lines[0]
    assert [line.split(":")[0] for line in lines[1:]] == ["worker 0", "worker 1"]


@pytest.mark.slow
def test_only_the_tasks_of_a_killed_worker_are_repeated(tmp_path, start_cluster):
    path, cluster = write_short(tmp_path), start_cluster(2)
    serial = calibrate(in_partitions(path, SIZE))
    killed = []

    def kill_first_worker(line):
        if not killed:
            killed.append(cluster.workers[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    result = calibrate(in_partitions(path, SIZE, scheduler=cluster.address), kill_first_worker)
    assert killed
    assert_same_bits(result, serial)


@pytest.mark.slow
def test_all_workers_may_be_replaced(tmp_path, start_cluster):
    path, cluster = write_short(tmp_path), start_cluster(1)
    serial = calibrate(in_partitions(path, SIZE))
    replacements = []

    def replace_worker(line):
        if not replacements:
            cluster.kill_worker(0)
            replacements.append(threading.Timer(0.5, lambda: cluster.workers.append(cluster.add_worker("later"))))
            replacements[0].start()

    result = calibrate(in_partitions(path, SIZE, scheduler=cluster.address), replace_worker)
    assert len(cluster.workers) == 2
    assert_same_bits(result, serial)


@pytest.mark.slow
def test_a_killed_scheduler_ends_with_the_best_values(tmp_path, start_cluster):
    path, cluster = write_short(tmp_path), start_cluster(1)
    costs = []

    def kill_scheduler(line):
        costs.append(line.cost)
        if line.stage == "plain" and line.iteration == 2:
            cluster.scheduler.kill()

    result = calibrate(in_partitions(path, SIZE, scheduler=cluster.address), kill_scheduler)
    assert result.status == "stopped"
    assert f"the scheduler at {cluster.address} is gone" in result.message
    assert result.cost_after == costs[-1]
    assert not np.array_equal(
        values_of(result), np.concatenate([np.ravel(result.start[n].values) for n in result.start])
    )
    compiled = CompiledProblem(in_partitions(path, SIZE).problem())
    values = compiled.values.pack(result.parameters)
    assert compiled.sums.cost(values) + compiled.roughness.cost(values[: compiled.values.free]) == costs[-1]


@pytest.mark.slow
def test_a_killed_scheduler_leaves_results(tmp_path, start_cluster, capsys, monkeypatch):
    monkeypatch.setattr("kennfeld.base.dask_runner.CONNECT_TIMEOUT", 5.0)  # for so long, Dask tries to find it again
    path, cluster = write_short(tmp_path), start_cluster(1)
    text = path.read_text().replace("max_iterations = 3", "max_iterations = 100\nsave_every = 1")
    path.write_text(f'{text}\n[cluster]\nscheduler = "{cluster.address}"\npartition = {SIZE}\n')
    out = tmp_path / "out"
    threading.Thread(target=_kill_after_first_step, args=(out, cluster), daemon=True).start()
    assert run(["calibrate", str(path), "-o", str(out), "--trust"]) == 1
    assert (out / "parameters.json").is_file()
    assert "stopped: " in capsys.readouterr().out


def _kill_after_first_step(folder, cluster):
    while not list(folder.glob("saves/*.json")):
        time.sleep(0.02)
    cluster.scheduler.kill()


def test_a_scheduler_that_dies_while_files_are_read_is_an_error(tmp_path, start_cluster, capsys, monkeypatch):
    path, cluster, map_tasks = write_short(tmp_path), start_cluster(0), DaskRunner.map

    def map_and_kill(self, *arguments):
        threading.Timer(0.3, cluster.scheduler.kill).start()
        return map_tasks(self, *arguments)

    monkeypatch.setattr(DaskRunner, "map", map_and_kill)
    assert run(["calibrate", str(path), "--scheduler", cluster.address]) == 2
    assert f"the scheduler at {cluster.address} is gone" in capsys.readouterr().err


def test_a_file_that_fails_on_a_worker_names_file_worker_and_reason(tmp_path, shared_cluster):
    path = write_short(tmp_path)
    (tmp_path / "bench_1.csv").write_bytes(b"PK\x03\x04 damaged")
    project = in_partitions(path, SIZE, scheduler=shared_cluster.address)
    messages = [str(finding) for finding in project.check() if finding.severity == "error"]
    project.close()
    (message,) = messages
    assert "bench_1.csv" in message
    assert "(on worker worker-" in message


def test_a_file_that_vanishes_while_a_calibration_runs_names_it(tmp_path, shared_cluster):
    path = write_short(tmp_path)
    project = in_partitions(path, SIZE, scheduler=shared_cluster.address)
    problem = project.problem()
    (tmp_path / "bench_1.csv").unlink()
    for entry in (tmp_path / ".kennfeld" / "partitions").iterdir():
        entry.unlink()
    with pytest.raises(InputError, match=r"bench_1\.csv.*no such file on this machine \(on worker worker-"):
        CompiledProblem(problem).sums.cost(CompiledProblem(problem).start)
    project.close()


def test_a_scheduler_that_does_not_answer_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr("kennfeld.base.dask_runner.CONNECT_TIMEOUT", 1.0)
    address = f"tcp://127.0.0.1:{free_port()}"
    (finding,) = in_partitions(write_short(tmp_path), SIZE, scheduler=address).check()
    assert str(finding).startswith(f"scheduler {address}: does not answer")


def test_the_remedy_for_a_missing_library_is_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    (finding,) = in_partitions(write_short(tmp_path), SIZE, scheduler="tcp://127.0.0.1:1").check()
    assert str(finding) == '[cluster]: the package distributed is not installed. Run: pip install "kennfeld[cluster]"'


@pytest.mark.slow
def test_the_command_joins_the_scheduler_of_its_option(tmp_path, shared_cluster, capsys):
    path, address, out = write_short(tmp_path), shared_cluster.address, tmp_path / "out"
    assert run(["calibrate", str(path), "--scheduler", address, "-o", str(out)]) == 1  # max_iterations
    assert f"at {address}; dashboard" in capsys.readouterr().err
    assert (out / "report.html").is_file()


def whole_on(path, address):
    """A project whose data are read here, and whose starts and folds are tasks of a cluster."""
    return in_partitions(path, 0, scheduler=address)


def test_starts_are_tasks_of_a_cluster(tmp_path, shared_cluster):
    path = write_steady(tmp_path, files=2, samples=200, text=FIXED + SHORT + "starts = 3\nsave_every = 2\n")
    local = Project.read(path).calibrate(workers=1)
    lines = []
    result = calibrate(whole_on(path, shared_cluster.address), lines.append)
    assert np.array_equal(values_of(result), values_of(local))
    assert [row.cost_after for row in result.starts] == [row.cost_after for row in local.starts]
    assert {line.start for line in lines} == {1, 2, 3}
    assert list((tmp_path / "results" / "saves").glob("3-*.json"))


def test_starts_on_a_cluster_stop_at_their_best_values(tmp_path, shared_cluster):
    text = FIXED + SHORT.replace("= 3", "= 200") + "starts = 3\n"
    path = write_steady(tmp_path, files=2, samples=200, text=text)

    def stop(line):
        if line.iteration >= 3:
            raise Stop

    result = calibrate(whole_on(path, shared_cluster.address), stop)
    assert result.status == "stopped"
    assert result.cost_after < result.cost_before


def test_folds_are_tasks_of_a_cluster(tmp_path, shared_cluster):
    path = write_short(tmp_path)
    local = cross_validate(Project.read(path).problem(), folds=3, options=Project.read(path).options)
    project = whole_on(path, shared_cluster.address)
    lines = []
    remote = cross_validate(project.problem(), folds=3, options=project.options, progress=lines.append)
    project.close()
    assert remote == local
    assert {line.stage.split()[1] for line in lines} == {"1", "2", "3"}

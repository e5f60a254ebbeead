"""The app with data in partitions: screens show an excerpt, runs and reports evaluate all samples."""

import json
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from kennfeld.app.questions import QUESTIONS, overview, recordings
from kennfeld.app.session import partitioned_data
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys, SetValues
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.base.markup import decimal
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.quality.quality import Scorer
from kennfeld.project import Project, partitioned_loading
from kennfeld.report import document
from tests.project.partitioned_projects import FEW, in_partitions, write_steady
from tests.report.report_projects import Page

pytestmark = pytest.mark.usefixtures("forked_workers")

SHORT = '\n[optimizer]\ncontinuation = "off"\nmax_iterations = 6\n'
SAMPLES = 5 * 100 + 90 * (1 + 2 + 3 + 4)  # of five files
PARTITIONS = "\n[cluster]\npartition = 300\n"
needs_dask = pytest.mark.skipif(find_spec("distributed") is None, reason="dask.distributed is not installed")


def write_project(folder: Path, cluster: str = PARTITIONS, optimizer: str = SHORT) -> Path:
    return write_steady(folder, files=4, samples=100, text=FEW + optimizer + cluster)


@pytest.fixture(autouse=True)
def small_excerpt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(partitioned_loading, "EXCERPT", 100)
    monkeypatch.setattr(partitioned_loading, "LEAST_EXCERPT", 20)


def wait(session: Session, until: Callable[[], bool]) -> None:
    while not until():
        time.sleep(0.02)
        session.pump()


def calibrated(session: Session) -> Result:
    session.run()
    wait(session, lambda: session.job.state not in ("running", "stopping"))
    assert session.runs, session.job.message
    return session.runs[-1].result


def tables(result: Result) -> list[np.ndarray]:
    return [result.parameters[name].values for name in result.parameters]


def test_screens_show_an_excerpt_and_say_so(tmp_path: Path) -> None:
    session = Session(write_project(tmp_path))
    state = overview.overview(session)
    excerpt, samples = state.excerpt
    assert samples == SAMPLES
    assert excerpt == sum(dataset.samples for dataset in state.datasets) < 0.2 * samples
    assert state.scores[0].samples < excerpt


def test_a_complete_excerpt_is_not_mentioned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(partitioned_loading, "EXCERPT", 10**6)
    assert overview.overview(Session(write_project(tmp_path))).excerpt is None
    plain = write_project(tmp_path, cluster="")
    assert overview.overview(Session(plain)).excerpt is None


@pytest.mark.slow
def test_a_run_evaluates_all_partitions_as_the_command_does(tmp_path: Path) -> None:
    session = Session(write_project(tmp_path))
    result, command = calibrated(session), Project.read(session.path).calibrate()
    assert all(np.array_equal(*pair) for pair in zip(tables(result), tables(command), strict=True))
    assert result.quality == command.quality
    assert all(
        np.array_equal(result.trust.samples[name], command.trust.samples[name]) for name in command.trust.samples
    )
    head = QUESTIONS["outcome"](session, {}).head["result"]
    assert head["quality"] == list(map(list, command.table()))
    assert session.job.trace


@pytest.mark.slow  # processes of a run are started below too; their bits are those of `project/test_clusters.py`
@needs_dask
def test_a_run_uses_the_processes_of_the_project(tmp_path: Path) -> None:
    optimizer = SHORT.replace("= 6", "= 2")
    command = Project.read(write_project(tmp_path, optimizer=optimizer)).calibrate()
    session = Session(write_project(tmp_path, PARTITIONS + "workers = 2\n", optimizer))
    result = calibrated(session)
    assert all(np.array_equal(*pair) for pair in zip(tables(result), tables(command), strict=True))
    assert result.quality == command.quality
    export_of(session, report=True)


def test_a_run_is_stopped_at_its_best_values(tmp_path: Path) -> None:
    session = Session(write_project(tmp_path, optimizer="\n[optimizer]\nstarts = 100\n"))
    session.run()
    wait(session, lambda: len(session.job.trace) > 0 or session.job.state != "running")
    session.stop()
    wait(session, lambda: session.job.state not in ("running", "stopping"))
    assert session.job.state == "stopped"
    result = session.runs[-1].result
    assert result.cost_after < result.cost_before


@needs_dask
def test_a_scheduler_that_does_not_answer_fails_the_run_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session(write_project(tmp_path, cluster=PARTITIONS + 'scheduler = "nobody://127.0.0.1:1"\n'))
    assert session.view is not None
    with pytest.raises(InputError, match=r"joins the scheduler nobody://127\.0\.0\.1:1, which can run code here"):
        session.run()
    with pytest.raises(InputError, match="has not been allowed to"):
        QUESTIONS["export"](session, {"report": True})
    session.allow_code([request.digest for request in session.undecided])
    session.run()
    wait(session, lambda: session.job.state not in ("running", "stopping"))
    assert session.job.state == "failed"
    assert session.job.message.startswith("scheduler nobody://127.0.0.1:1: does not answer")


@needs_dask
@pytest.mark.slow
def test_processes_of_a_run_end_with_the_session(tmp_path: Path) -> None:
    processes = pytest.importorskip("psutil", reason="psutil is not installed")
    session = Session(write_project(tmp_path, PARTITIONS + "workers = 2\n", "\n[optimizer]\nstarts = 100\n"))
    session.run()
    wait(session, lambda: bool(session.job.trace) or session.job.state != "running")
    assert session._runner.running is not None
    started = processes.Process(session._runner.running.process.pid).children(recursive=True)
    assert len(started) >= 2
    session.close()
    wait(session, lambda: not any(process.is_running() for process in started))


def export_of(session: Session, **arguments: bool) -> Page:
    QUESTIONS["export"](session, arguments)
    return Page((session.path.parent / "results" / "report.html").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_reports_and_results_are_those_of_all_samples(tmp_path: Path) -> None:
    session = Session(write_project(tmp_path))
    result = calibrated(session)
    page = export_of(session, report=True, whole=True)
    expected = Page(document(in_partitions(session.path, 300), result))
    for kind in ("strip", "scatter", "histograms", "cells"):
        assert page.figures(kind) == expected.figures(kind)
    folder = session.path.parent / "results"
    assert not (folder / "simulation.parquet").exists()
    summary = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert [row["samples"] for row in summary["quality"]] == [row.samples for row in result.quality]


@pytest.mark.slow
def test_a_report_on_edited_values_has_their_errors_on_all_samples(tmp_path: Path) -> None:
    session = Session(write_project(tmp_path))
    result = calibrated(session)
    session.do(SetValues("raise", "M", session.parameters["M"].values * 1.1))
    page = export_of(session, report=True)
    problem = Project.read(session.path).problem()
    (row, _) = Scorer(problem).scores(problem.parameters, session.parameters).quality
    assert row.samples == result.quality[0].samples > 700
    assert row.rmse_after > 2 * result.quality[0].rmse_after
    errors = f"{row.samples} – {decimal(row.rmse_before)} {decimal(row.rmse_after)}"
    assert f"bench training {errors}" in page.words_in_a_row


@pytest.mark.slow
def test_edits_do_not_read_recordings_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session(write_project(tmp_path))
    calls = []
    load = partitioned_data.PartitionedLoading.__call__

    def count(self: object, *arguments: object) -> object:
        calls.append(arguments)
        return load(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(partitioned_data.PartitionedLoading, "__call__", count)
    session.do(SetKeys("smoothness", session.path.name, [(("parameters", "M", "smoothness"), 0.1)]))
    assert calls == []
    lines = (tmp_path / "bench_0.csv").read_text().splitlines()
    (tmp_path / "bench_0.csv").write_text("\n".join(lines[:60]))
    session.refresh()
    assert len(calls) == 1
    assert overview.overview(session).excerpt[1] == SAMPLES - (len(lines) - 60)


def test_partitions_can_be_switched_off_and_on(tmp_path: Path) -> None:
    session = Session(write_project(tmp_path))
    session.do(SetKeys("off", session.path.name, [(("cluster", "partition"), 0)]))
    assert overview.overview(session).excerpt is None
    assert session.require_view().model.problem.partitions is None
    session.undo()
    assert overview.overview(session).excerpt is not None


def test_few_files_of_many_are_read_to_describe_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recordings, "MAX_DESCRIBED", 2)
    monkeypatch.setattr(recordings, "MAX_FILES", 1)
    session = Session(write_project(tmp_path))
    described, *_ = QUESTIONS["files"](session, {}).head["datasets"]
    rows = [(file["name"], file.get("note"), len(file["channels"])) for file in described["files"]]
    note = "read in partitions"
    assert rows == [
        ("bench_0.csv", None, 4),
        ("bench_1.csv", None, 4),
        ("bench_2.csv", note, 0),
        ("1 more file", note, 0),
    ]
    assert recordings.recorded_channels(session, 0) == {}
    assert recordings.channel_names(session) == ["n", "rl", "zw", "torque"]


def test_files_of_a_store_are_listed_by_their_address(tmp_path: Path) -> None:
    path = write_project(tmp_path)
    path.write_text(path.read_text().replace('files = ["', f'files = ["file://{tmp_path}/'))
    session = Session(path)
    assert overview.overview(session).excerpt[1] == SAMPLES
    _, road = QUESTIONS["files"](session, {}).head["datasets"]
    assert road["files"] == [
        {"name": f"file://{tmp_path}/road.csv", "note": "read in partitions", "channels": [], "groups": []}
    ]


def test_further_channels_of_recordings_are_refused_with_a_reason(tmp_path: Path) -> None:
    session = Session(write_project(tmp_path))
    recording = session.require_view().model.recordings[0]
    with pytest.raises(ArgumentError, match="other cannot be drawn, since the data are in partitions"):
        session._recordings.further_channels(recording, ["other"])
    assert session._recordings.further_channels(recording, []) == {}

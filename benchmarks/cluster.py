"""Topic `cluster`: data in partitions, in one process and on a Dask cluster of this machine."""

import hashlib
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cluster_data import PARTITION, POINTS, GeneratedFiles, write_fleet
from benchmarks.cluster_links import DelayedLink
from benchmarks.machine import load
from benchmarks.measure import apart, peak, reset_peak
from benchmarks.table import Table, megabytes, seconds

__all__ = ["calibrate", "evaluate", "evaluate_generated", "evaluate_over_link", "run"]

FILES = (16, 100)
WORKERS = (1, 4)
ITERATIONS = 3
SMALL = 1000  # points of a file of the project from which the memory of the program itself is known
CHUNKED = (10, 100, 1000)  # partitions that are generated when they are evaluated
LINKS = ((0.0, 1e12), (0.005, 1e12), (0.02, 1e12), (0.0, 20e6), (0.02, 20e6))  # s, bytes per s
ROUND_TRIPS = 1  # for each partition: its result is fetched after those before
TIMEOUT = 3600.0  # s
COLUMNS = (
    *("points", "processes", "first reading", "second", "ratio", "cost", "normal", "CPU of normal", "overhead"),
    *("client", "a worker", "of a partition", "bits"),
)


def run() -> list[Table]:
    """All tables."""
    with tempfile.TemporaryDirectory(prefix="kennfeld-benchmark-") as folder:
        evaluation = _evaluations(Path(folder))
        kill, links = _kills(Path(folder) / str(FILES[0])), _links(Path(folder) / str(FILES[0]))
    return [evaluation, kill, _generated(), links]


def _evaluations(folder: Path) -> Table:
    table = Table("cluster: one evaluation of the torque model, 519 values", COLUMNS)
    for files in FILES:
        project = write_fleet(folder / str(files), files, ITERATIONS)
        small = write_fleet(folder / f"small {files}", 16 * PARTITION, ITERATIONS, SMALL)
        for workers in WORKERS:
            shutil.rmtree(project.parent / ".kennfeld", ignore_errors=True)
            first, second = (
                apart(
                    "benchmarks.cluster:evaluate",
                    timeout=TIMEOUT,
                    project=str(project),
                    small=str(small),
                    workers=workers,
                )
                for _ in range(2)
            )
            _evaluation_row(table, files, workers, first, second)
    table.notes = [
        "Reading precedes the first evaluation, without the start of the processes: files are read and prepared "
        "the first time, mapped into memory the second. CPU is that of all processes together, scheduler included; "
        "overhead is the part of it that is spent outside of tasks, relative to that within.",
        "Client is the peak memory of its process; a worker's is the peak beyond its memory after an evaluation "
        f"of {SMALL} points; mapped files count as long as they are mapped. A partition has {PARTITION} files.",
        "Bits: a digest of gradient and Gauss-Newton matrix; it is equal only if all their bits are.",
        f"Budget: client below 1 GB, a worker below 1.5 partitions. Load at the end {load()}; {os.cpu_count()} cores.",
    ]
    return table


def _evaluation_row(table: Table, files: int, workers: int, first: dict[str, Any], second: dict[str, Any]) -> None:
    name = f"{files * POINTS}"
    if "error" in first or "error" in second:
        table.add(name, str(workers), str(first.get("error", second.get("error"))))
        return
    table.add(
        name,
        str(workers),
        *(seconds(each["read"]) for each in (first, second)),
        f"{first['read'] / second['read']:.1f}",
        *(seconds(second[part]) for part in ("cost", "normal", "cpu")),
        f"{second['overhead']:.0%}" if workers > 1 else "-",
        megabytes(max(first["client"], second["client"])),
        *([megabytes(first["worker"]), f"{first['worker'] / first['bytes']:.2f}"] if workers > 1 else ["-", "-"]),
        second["bits"][:8],
    )


def evaluate(project: str, small: str, workers: int) -> dict[str, Any]:
    """Open a project and evaluate it, in a process of its own; one process for one worker.

    A small project of the same kind comes first, so that what remains is due to the data.
    """
    from kennfeld.optimize.sums.compiled import CompiledProblem
    from kennfeld.project import Project

    first = Project.read(small).on_cluster(workers=workers)
    compiled = CompiledProblem(first.problem())
    for number in range(2 * workers):
        compiled.sums.normal(_values(compiled, number))
    runner = first._runner
    start, at_start = reset_peak(), runner.client.run(reset_peak) if workers > 1 else {}
    opened = Project.read(project)
    opened.__dict__["_runner"] = runner
    read, problem = _timed(opened.problem)
    compiled = CompiledProblem(problem)
    unread, *costs = (_timed(partial(compiled.sums.cost, _values(compiled, number)))[0] for number in range(3))
    cost = min(costs)
    runs = []
    for number in range(3, 6):
        before = _processor_time(), _task_time(runner)
        normal, equations = _timed(partial(compiled.sums.normal, _values(compiled, number)))
        runs.append((_processor_time() - before[0], _task_time(runner) - before[1], normal))
    spent, tasks, normal = min(runs)
    worker = 0
    if workers > 1:
        peaks = runner.client.run(peak)
        worker = max(peaks[address] - at_start[address] for address in peaks)
    client = peak()
    opened.close()
    return {
        "read": read + unread - cost,
        "cost": cost,
        "normal": normal,
        "cpu": spent,
        "overhead": spent / tasks - 1 if workers > 1 else 0.0,
        "client": client,
        "client data": client - start,
        "worker": worker,
        "bytes": PARTITION * POINTS * 8 * (len(compiled.kernel.layout.inputs) + 1),
        "bits": _bits(equations.gradient, equations.matrix),
    }


def _values(compiled: Any, number: int) -> np.ndarray[Any, Any]:
    """Return other values for each number, as sums at the last ones are remembered."""
    return np.asarray(compiled.start * (1.0 + 1e-9 * number))


def _task_time(runner: Any) -> float:
    """Return the processor time of all tasks so far in s."""
    return float(sum(each.processor for each in getattr(runner, "loads", {}).values()))


def _timed(work: Callable[[], Any]) -> tuple[float, Any]:
    began = time.perf_counter()
    result = work()
    return time.perf_counter() - began, result


def _processor_time() -> float:
    """Return the processor time of this process and its children in s."""
    import psutil

    own = psutil.Process()
    return float(sum(sum(process.cpu_times()[:2]) for process in (own, *own.children(recursive=True))))


def _bits(*arrays: np.ndarray[Any, Any]) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()


def _kills(folder: Path) -> Table:
    table = Table("cluster: calibration of 16 000 000 points", ("run", "total", "cost", "bits of all values"))
    project = str(folder / "kennfeld.toml")
    for name, workers, kill in (("one process", 1, 0), ("4 workers", 4, 0), ("4 workers, kill -9 of two", 4, 2)):
        outcome = apart("benchmarks.cluster:calibrate", timeout=TIMEOUT, project=project, workers=workers, kill=kill)
        if "error" in outcome:
            table.add(name, outcome["error"])
        else:
            table.add(name, seconds(outcome["seconds"]), f"{outcome['cost']:.10g}", outcome["bits"][:8])
    table.notes = ["Workers are killed at the first accepted step; Dask starts others in their place."]
    return table


def calibrate(project: str, workers: int, kill: int) -> dict[str, Any]:
    """Calibrate, and kill some workers on the way."""
    from kennfeld.project import Project

    opened = Project.read(project).on_cluster(workers=workers)
    victims: list[int] = []

    def watch(line: object) -> None:
        if kill and not victims:
            victims.extend(list(opened._runner.client.run(os.getpid).values())[:kill])
            for process in victims:
                os.kill(process, signal.SIGKILL)

    duration, result = _timed(lambda: opened.calibrate(watch))
    opened.close()
    values = [result.parameters[name].values for name in result.parameters]
    return {"seconds": duration, "cost": result.cost_after, "bits": _bits(*values)}


def _generated() -> Table:
    table = Table(
        "cluster: data that no disk holds", ("points", "bytes", "one evaluation", "peak beyond the start", "cost")
    )
    for partitions in CHUNKED:
        outcome = apart("benchmarks.cluster:evaluate_generated", timeout=TIMEOUT, partitions=partitions)
        size = megabytes(partitions * POINTS * 8 * 4)
        if "error" in outcome:
            table.add(f"{partitions * POINTS}", size, outcome["error"])
            continue
        table.add(
            *(f"{partitions * POINTS}", size, seconds(outcome["seconds"]), megabytes(outcome["peak"])),
            f"{outcome['cost']:.10g}",
        )
    table.notes = [
        "One process; each partition is generated, prepared, evaluated (gradient and Gauss-Newton matrix) and dropped, "
        "like a recording whose prepared form does not fit on the disk. Most of the time is generation and sorting."
    ]
    return table


def evaluate_generated(partitions: int) -> dict[str, Any]:
    """Evaluate points that are generated partition by partition."""
    from dataclasses import replace

    from kennfeld.optimize.problem.partitions import Part, Partition, Recordings
    from kennfeld.optimize.sums.compiled import CompiledProblem
    from kennfeld.preprocessing.recording_sources import RecordingSource

    with tempfile.TemporaryDirectory() as folder:
        project = write_fleet(Path(folder) / "project", 1, ITERATIONS)
        from kennfeld.project import Project

        problem = Project.read(project).problem()
        own = problem.partitions
        assert own is not None
        recordings = Recordings(own.recordings.recipes, GeneratedFiles(Path(folder), 0))
        sources = [RecordingSource(str(number), "") for number in range(partitions)]
        training = tuple(Partition((Part(0, source, 0, POINTS),)) for source in sources)
        problem = replace(problem, partitions=replace(own, recordings=recordings, training=training))
        compiled = CompiledProblem(problem)
        start = reset_peak()
        duration, equations = _timed(lambda: compiled.sums.normal(compiled.start))
        cost = float(equations.gradient @ equations.gradient)
    return {"seconds": duration, "peak": peak() - start, "cost": cost}


def _links(folder: Path) -> Table:
    columns = ("latency", "bandwidth", "one evaluation", "by the model", "traffic")
    table = Table("cluster: a slow link between client and scheduler", columns)
    outcome = apart("benchmarks.cluster:evaluate_over_link", timeout=TIMEOUT, project=str(folder / "kennfeld.toml"))
    if "error" in outcome:
        table.add(outcome["error"])
        return table
    for row in outcome["rows"]:
        speed = f"{row['bandwidth'] / 1e6:g} MB/s" if row["bandwidth"] < 1e11 else "that of the machine"
        table.add(
            *(seconds(row["latency"]), speed, seconds(row["seconds"]), seconds(row["model"])),
            f"{row['bytes'] / 1e6:.1f} MB",
        )
    table.notes = [
        "Model: time without delay + round trips * 2 latency + traffic / bandwidth. A partition sends half a symmetric "
        "matrix of doubles, which is fetched when those before have arrived. See docs/cluster.md."
    ]
    return table


def evaluate_over_link(project: str) -> dict[str, Any]:
    """Evaluate over links of several speeds, with two workers."""
    import distributed

    from kennfeld.optimize.sums.compiled import CompiledProblem
    from kennfeld.project import Project

    rows: list[Mapping[str, float]] = []
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        host, port = cluster.scheduler_address.removeprefix("tcp://").split(":")
        plain = 0.0
        for latency, bandwidth in LINKS:
            with DelayedLink(host, int(port), latency, bandwidth) as link:
                opened = Project.read(project).on_cluster(link.address)
                compiled = CompiledProblem(opened.problem())
                compiled.sums.normal(_values(compiled, 0))
                duration = min(_timed(partial(compiled.sums.normal, _values(compiled, k)))[0] for k in range(1, 4))
                count, free = len(opened.problem().partitions.training), compiled.values.free  # type: ignore[union-attr]
                opened.close()
            plain = plain or duration
            size = count * 4 * free * (free + 1)
            model = plain + ROUND_TRIPS * count * 2 * latency + size / bandwidth
            rows.append(
                {"latency": latency, "bandwidth": bandwidth, "seconds": duration, "model": model, "bytes": size}
            )
    return {"rows": rows}

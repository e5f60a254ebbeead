"""Several starts: the best is returned, all are listed, and the number of processes does not matter."""

import math
import os
import signal
from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import ArgumentError
from kennfeld.optimize.problem.options import MAX_STARTS
from kennfeld.optimize.search import multistart, worker_pool
from tests.draws import mostly_slow

X = np.linspace(0, 10, 120)


def sine(**options):
    """A frequency far from the start: its cost has a minimum every few tenths."""
    start = kf.ParameterSet(
        [
            kf.Scalar("a", 1.0, lower=0.0, upper=5.0),
            kf.Scalar("w", 1.0, lower=0.1, upper=8.0),
            kf.Scalar("p", 0.0, lower=-3.2, upper=3.2),
        ]
    )
    progress = options.pop("progress", None)
    data = {"x": X, "y": 2 * np.sin(3.7 * X + 0.4)}
    settings = kf.Options(**({"starts": 12, "seed": 1, "workers": 1} | options))
    return kf.calibrate("m = a * sin(w * x + p)", data, start, target="y", options=settings, progress=progress)


def chain(**options):
    """A map looked up in a fixed curve that waves: what the curve gives does not say where on it one is."""
    u = np.linspace(0, 10, 41)
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)))
    wave = kf.Curve("Wave", u, 3 * np.sin(1.3 * u) + 0.8 * u, locked=True)
    grid = np.linspace(0, 1, 3)
    truth = kf.Map("Place", grid, grid, 7.5 + np.add.outer(grid, -grid))
    text = "m = Wave(Place(x, y))"
    measured = kf.simulate(text, {"x": x, "y": y}, kf.ParameterSet([wave, truth]))["m"].values
    start = kf.ParameterSet([wave, kf.Map("Place", grid, grid, np.full((3, 3), 0.5), lower=0.0, upper=10.0)])
    return kf.calibrate(text, {"x": x, "y": y, "z": measured}, start, target="z", options=kf.Options(**options))


def comparable(result):
    """Everything of a result but the times."""
    values = {name: parameter.values.tolist() for name, parameter in result.parameters.items()}
    trace = [replace(line, seconds=0.0) for line in result.trace]
    facts = (result.status, result.message, result.iterations, result.evaluations, result.cost_after)
    return values, trace, facts, [row.as_json() for row in result.starts]


@pytest.fixture(scope="module")
def twelve():
    return sine()


@pytest.mark.slow
def test_the_global_minimum_of_a_sine_is_found_although_the_initial_start_fails(twelve):
    result = twelve
    assert result.starts[0].cost_after > 100
    assert result.parameters["w"].value == pytest.approx(3.7, rel=1e-9)
    assert result.cost_after < 1e-12
    assert "Best of 12 starts: number" in result.message
    assert result.cost_before == sine(starts=1).cost_before


@pytest.mark.slow
@pytest.mark.parametrize("continuation", ["off", "auto"])
def test_the_global_minimum_of_a_chain_of_tables_is_found(continuation):
    alone = chain(continuation=continuation)
    result = chain(continuation=continuation, starts=3, seed=2, workers=1)
    assert alone.cost_after > 1
    assert result.starts[0].cost_after == alone.cost_after
    assert result.cost_after < 1e-6


def test_every_start_has_a_row(twelve):
    result = twelve
    assert [row.start for row in result.starts] == list(range(1, 13))
    costs = [row.cost_after for row in result.starts]
    best = result.starts[int(np.argmin(costs))]
    assert best.cost_after == result.cost_after
    assert best.distance == 0
    assert all(row.distance > 0.1 for row in result.starts if row.cost_after > 100)
    assert sum(row.iterations for row in result.starts) == result.iterations
    assert len(result.as_json()["starts"]) == 12
    assert {line.start for line in result.trace} == set(range(1, 13))
    for row in result.starts:
        assert [line.cost for line in result.trace if line.start == row.start][-1] >= row.cost_after


def test_a_single_start_has_a_row():
    (row,) = sine(starts=1).starts
    assert (row.start, row.distance, row.status) == (1, 0.0, "converged")


@pytest.mark.slow
@pytest.mark.parametrize("problem", [sine, pytest.param(chain, marks=pytest.mark.slow)])
def test_the_result_does_not_depend_on_the_number_of_processes(problem, monkeypatch):
    serial = problem(starts=3, seed=3, workers=1)
    monkeypatch.setattr(multistart, "_run_in_turn", lambda climber, begins, *_: list(begins))  # none may be left
    parallel = problem(starts=3, seed=3, workers=2)
    assert comparable(serial) == comparable(parallel)


@pytest.mark.slow
def test_another_seed_gives_other_starts():
    assert [row.cost_before for row in sine(starts=2).starts][1:] != [
        row.cost_before for row in sine(starts=2, seed=2).starts
    ][1:]


def failing(**options):
    start = kf.ParameterSet([kf.Scalar("k", 2.0, lower=-4.0, upper=4.0)])
    return kf.calibrate("m = log(k * x)", {"x": [1.0, 2.0], "y": [0.0, 1.0]}, start, "y", options=kf.Options(**options))


@pytest.mark.parametrize("processes", mostly_slow([1, 2], 1))
def test_a_start_that_fails_is_a_row(processes):
    result = failing(starts=8, workers=processes)
    states = [row.status for row in result.starts]
    assert result.status == states[0] == "converged"
    assert 2 <= states.count("failed") <= 6
    assert f"{states.count('failed')} of them failed" in result.message
    row = result.starts[states.index("failed")]
    assert "not a finite number" in row.message
    assert row.as_json()["cost"] == {"before": None, "after": None}


def test_a_start_that_raises_an_error_is_a_row(monkeypatch):
    from kennfeld.optimize.fit import descent_strategy

    descend = descent_strategy.levenberg_marquardt

    def breaks(objective, start, *rest):
        if start[0] == 2.0:
            return descend(objective, start, *rest)
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(descent_strategy, "levenberg_marquardt", breaks)
    result = failing(starts=3, workers=1)
    assert [row.status for row in result.starts] == ["converged", "failed", "failed"]
    assert "SVD did not converge" in result.starts[1].message
    with pytest.raises(np.linalg.LinAlgError):
        kf.calibrate("m = k * x", {"x": [1.0], "y": [1.0]}, {"k": 3.0}, target="y")


def test_the_result_has_failed_if_all_starts_fail():
    data = {"x": [1.0, 2.0], "y": [0.0, 1.0]}
    start = kf.ParameterSet([kf.Scalar("k", -2.0, lower=-4.0, upper=-1.0)])
    result = kf.calibrate("m = log(k * x)", data, start, target="y", options=kf.Options(starts=3, workers=1))
    assert result.status == "failed"
    assert result.parameters["k"].value == -2.0


@pytest.mark.slow
def test_a_start_whose_process_dies_is_a_row(monkeypatch):
    workers = []

    class Mortal(worker_pool._Worker):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            workers.append(self)

    monkeypatch.setattr(worker_pool, "_Worker", Mortal)
    killed = set()

    def kill(line):
        if not killed:
            killed.add(line.start)
            next(w for w in workers if w.point is not None and w.point.start == line.start).process.kill()

    result = sine(starts=5, workers=2, progress=kill)
    dead = [row for row in result.starts if row.status == "failed"]
    assert killed
    assert len(dead) <= 1  # the start may have come to its end before, and the next one have been handed over
    assert len(result.starts) == 5
    assert all("process of this start ended" in row.message for row in dead)
    assert all(worker.process.returncode is not None for worker in workers)


def test_the_starts_run_in_turn_if_no_process_can_be_started(monkeypatch):
    monkeypatch.setattr(worker_pool, "COMMAND", "raise SystemExit(3) # {path}")
    result = sine(starts=3, workers=2)
    assert "ran sequentially" in result.message
    assert [row.cost_after for row in result.starts] == [row.cost_after for row in sine(starts=3).starts]


@pytest.fixture
def interruptible():
    """Ctrl-C raises `KeyboardInterrupt`, also where this process was started to ignore it, as behind nohup."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize(
    ("how", "processes"), [("stop", 1), ("ctrl-c", 1), pytest.param("stop", 2, marks=pytest.mark.slow), ("ctrl-c", 2)]
)
def test_a_request_to_stop_ends_all_starts_and_keeps_the_best(processes, how):
    lines = []

    def watch(line):
        lines.append(line)
        if len(lines) == 4:
            if how == "stop":
                raise kf.Stop
            signal.raise_signal(signal.SIGINT)

    result = sine(starts=30, workers=processes, progress=watch)
    assert result.status == "stopped"
    assert "best values so far" in result.message
    assert len(result.starts) == 30
    assert result.starts[-1].message == "Stopped on request before it began."
    assert result.cost_after <= result.cost_before
    assert result.cost_after == min(r.cost_after for r in result.starts if np.isfinite(r.cost_after))


@pytest.mark.slow
def test_a_script_without_a_guard_can_use_several_processes(tmp_path):
    import subprocess
    import sys

    script = tmp_path / "script.py"
    script.write_text(
        "import kennfeld as kf\nprint('once')\n"
        "options = kf.Options(starts=2, workers=2)\n"
        "r = kf.calibrate('m = k * x', {'x': [1, 2], 'y': [2, 4]}, {'k': 1}, 'y', options=options)\n"
        "print(r.message)\n",
        encoding="utf-8",
    )
    paths = os.pathsep.join(path for path in sys.path if path)
    done = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": paths},
        check=True,
    )
    assert done.stdout.count("once") == 1
    assert "Best of 2 starts" in done.stdout
    assert "ran sequentially" not in done.stdout


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("starts", 0),
        ("starts", 2.5),
        ("seed", -1),
        ("workers", 0),
        ("spread", 0.0),
        ("spread", np.inf),
        ("save_every", -1),
    ],
)
def test_invalid_options_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        kf.Options(**{name: value})


@pytest.mark.slow
@pytest.mark.parametrize("workers", mostly_slow([1, 2], 1))
def test_a_model_with_memory_can_be_started_several_times(workers):
    t = 0.1 * np.arange(200)
    u = (np.sin(t) > 0).astype(float)
    data = kf.Dataset.of("d", {"u": u}, time=t)
    text = "m = PT1(g * u, T)"
    y = kf.simulate(text, data, {"g": 3.0, "T": 0.7})["m"].values
    start = kf.ParameterSet([kf.Scalar("g", 1.0), kf.Scalar("T", 5.0, lower=0.0, upper=10.0)])
    result = kf.calibrate(
        text, data.with_channels(kf.Channel("y", y)), start, target="y", options=kf.Options(starts=4, workers=workers)
    )
    assert result.parameters["T"].value == pytest.approx(0.7, rel=1e-6)


def test_starts_keep_pins_and_locks_exactly():
    points = np.linspace(0, 10, 7)
    member = kf.Curve("C", points, np.full(7, 1.0), locked=np.arange(7) == 2, lower=0.0, upper=3.0)
    result = kf.calibrate(
        "m = C(x)",
        {"x": X, "y": 1 + np.sin(X) ** 2},
        kf.ParameterSet([member]),
        target="y",
        pins=[kf.Pin("C", (0.5,), 1.25)],
        options=kf.Options(starts=4, workers=1),
    )
    values = result.parameters["C"].values
    assert values[2] == 1.0
    assert np.interp(0.5, points, values) == pytest.approx(1.25, rel=1e-9)
    assert all(row.status == "converged" for row in result.starts)


@pytest.mark.parametrize("processes", [1, 2])
def test_ctrl_c_before_the_first_step_is_raised_again(processes, monkeypatch):
    from kennfeld.optimize.search.start_runner import StartRunner
    from kennfeld.optimize.search.worker_pool import _Pool

    def press(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(StartRunner, "run", press)
    monkeypatch.setattr(_Pool, "_handle_message", press)
    with pytest.raises(KeyboardInterrupt):
        sine(starts=3, workers=processes)


def test_a_table_of_the_starts_can_be_shown():
    head, *rows = sine(starts=3).starts_table()
    assert head[:2] == ("start", "status")
    assert [row[0] for row in rows] == ["1", "2", "3"]


def test_unknown_costs_of_a_start_are_empty_cells_of_the_table():
    result = sine(starts=2)
    unknown = replace(result.starts[1], status="stopped", cost_before=math.nan, cost_after=math.nan)
    _, _, row = replace(result, starts=(result.starts[0], unknown)).starts_table()
    assert row[1:4] == ("stopped", "", "")


def test_too_many_starts_are_refused():
    with pytest.raises(ArgumentError, match="starts must be <= 10000, got 1000000000"):
        kf.Options(starts=10**9)
    assert kf.Options(starts=MAX_STARTS).starts == MAX_STARTS


def line(noise, criteria=()):
    measured = 2 * X + 1 + noise * np.cos(40 * X)
    start = [kf.Scalar(name, value, lower=-9.0, upper=9.0) for name, value in {"a": 1.0, "b": 0.0, "k": 3.0}.items()]
    options = kf.Options(starts=5, workers=1)
    target = None if criteria else "z"
    text = "m = a * x + b\nother = k * x"
    return kf.calibrate(text, {"x": X, "z": measured}, start, target, criteria=criteria, node=None, options=options)


NODES = [kf.Criterion("m", "z"), kf.Criterion("other", "z", weight=0.0)]


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_of_starts_with_equal_ends_the_given_one_is_the_best_whatever_the_last_digits_are(noise, monkeypatch):
    first = line(noise, NODES)
    assert "Best of 5 starts: number 1." in first.message
    costs = [row.cost_after for row in first.starts]
    assert len(set(costs)) > 1
    # the last digits are those of another machine
    cost = multistart.StartRunner.cost
    monkeypatch.setattr(multistart.StartRunner, "cost", lambda *own: cost(*own) * (1 + 1e-12 * next(digits)))
    digits = iter(range(100, 0, -1))
    assert "Best of 5 starts: number 1." in line(noise, NODES).message


def test_of_equal_ends_one_that_converged_is_preferred(monkeypatch):
    finish = multistart.StartPoint.skip

    def run_start(runner, point, progress, keep):
        status = "max_iterations" if point.start == 1 else "converged"
        outcome = finish(point)
        return replace(outcome, row=replace(outcome.row, status=status, cost_after=1.0))

    monkeypatch.setattr(multistart.StartRunner, "run_start", run_start)
    assert "Best of 5 starts: number 2." in line(0.1, NODES).message


def test_values_that_only_a_criterion_without_weight_sees_are_not_spread():
    result = line(0.1, NODES)
    assert result.parameters["k"].value == 3.0
    # with a weight it is
    weighted = line(0.1, [NODES[0], replace(NODES[1], weight=1.0)])
    assert weighted.parameters["k"].value != 3.0

"""Calls with models that run machine code of others, in a process of their own."""

import ctypes
import os
import signal

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError, InputWarning
from kennfeld.base.watch_folder import FOLDER
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.external_function import ExternalFunction
from kennfeld.models import Model

X = np.array([1.0, 2.0, 3.0])
DATA = {"x": X, "target": 2.0 * X}


class Doubled:
    """A loaded function y = k x, whose process ends at k = 9."""

    def __init__(self):
        self._callback = ctypes.CFUNCTYPE(None, *[ctypes.POINTER(ctypes.c_double)] * 3)(self._call)

    @property
    def address(self):
        return ctypes.cast(self._callback, ctypes.c_void_p).value

    def _call(self, x, y, slopes):
        if x[1] == 9.0:
            os.kill(os.getpid(), signal.SIGABRT)
        y[0] = x[0] * x[1]
        if slopes:
            slopes[0], slopes[1] = x[1], x[0]


def load_doubled(path):
    return Doubled()


def load_number(path):
    """Return a function whose result is the number of its process."""
    loaded = Doubled()
    loaded._callback = ctypes.CFUNCTYPE(None, *[ctypes.POINTER(ctypes.c_double)] * 3)(
        lambda x, y, slopes: y.__setitem__(0, os.getpid())
    )
    return loaded


def model_of(loader, file, native=True):
    builder = GraphBuilder()
    x, k = builder.input("x"), builder.lookup("k")
    function = ExternalFunction("f", 2, 1, f"{__name__}:{loader}", (str(file),), native=native)
    (y,) = builder.external(function, x, k)
    return Model(builder.finish({"y": y}, outputs=["y"]))


@pytest.fixture
def model(tmp_path):
    return model_of("load_doubled", tmp_path / "plant.so")


@pytest.mark.slow
def test_a_crash_is_an_error_after_which_the_session_goes_on(model):
    with pytest.raises(InputError, match=r"ended before it ran|crashed"):
        kf.simulate(model, DATA, {"k": 9.0})
    np.testing.assert_array_equal(kf.simulate(model, DATA, {"k": 3.0})["y"].values, 3 * X)


@pytest.mark.parametrize(("native", "here"), [(True, False), (False, True)])
def test_only_machine_code_of_others_runs_in_another_process(tmp_path, native, here):
    (number,) = set(kf.simulate(model_of("load_number", tmp_path / "n.so", native), DATA, {"k": 1.0})["y"].values)
    assert (number == os.getpid()) == here


def test_a_watched_process_runs_it_itself(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER, str(tmp_path))
    (number,) = set(kf.simulate(model_of("load_number", tmp_path / "n.so"), DATA, {"k": 1.0})["y"].values)
    assert number == os.getpid()


class OnlyHere(dict):
    """Columns of a class that another process does not know."""

    def __reduce__(self):
        return (fail_elsewhere, (os.getpid(), dict(self)))


def fail_elsewhere(process, columns):
    if process != os.getpid():
        raise AttributeError("a class of the script of the caller")
    return columns


def test_a_call_that_another_process_cannot_read_is_made_here(tmp_path):
    model = model_of("load_number", tmp_path / "n.so")
    (number,) = set(kf.simulate(model, OnlyHere(DATA), {"k": 1.0})["y"].values)
    assert number == os.getpid()


def test_progress_is_reported_here_and_may_stop_the_fit(model):
    lines = []

    def stop(line):
        lines.append(line)
        raise kf.Stop

    assert kf.calibrate(model, DATA, {"k": 0.5}, "target", progress=lines.append).status == "converged"
    assert lines
    assert kf.calibrate(model, DATA, {"k": 0.5}, "target", progress=stop).status in ("stopped", "converged")


def test_an_error_of_progress_is_raised(model):
    def divide(line):
        raise ZeroDivisionError("of the caller")

    with pytest.raises(ZeroDivisionError, match="of the caller"):
        kf.calibrate(model, DATA, {"k": 0.5}, "target", progress=divide)
    assert kf.calibrate(model, DATA, {"k": 0.5}, "target").status == "converged"


def test_errors_and_warnings_are_those_of_a_call_here(model):
    with pytest.raises(InputError, match="k"):
        kf.simulate(model, DATA, {})
    with pytest.warns(InputWarning, match="1 of 3 samples is not simulated") as caught:
        kf.simulate(model, {"x": np.array([1.0, np.nan, 3.0])}, {"k": 1.0})
    assert caught[0].filename == __file__

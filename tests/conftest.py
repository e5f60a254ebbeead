"""How every test runs: the same random cases each time, however slow the machine.

New ones are explored on request: `pytest --hypothesis-profile=explore`.
"""

import gc
import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# Tests run in one process a core, and threads of a BLAS wait by spinning. This comes before numpy is loaded; commands
# that tests start inherit it.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# What starts the tests may ignore signals (`nohup`, a job in the background), and every process inherits that.
for name in ("SIGHUP", "SIGTERM"):
    if hasattr(signal, name):
        signal.signal(getattr(signal, name), signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Every command that a test starts would compile the whole package anew, and every run rewrite all assertions.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

os.environ.pop("COLUMNS", None)  # tables would follow the width of a terminal that pytest-xdist tells its workers

# Code that tests compile is kept apart from that of the user; processes of one run share it.
os.environ.setdefault(
    "KENNFELD_CACHE", str(Path(tempfile.gettempdir()) / f"kennfeld-tests-{os.getuid() if hasattr(os, 'getuid') else 0}")
)

from kennfeld.base.machine_code import engine  # noqa: E402
from kennfeld.models import code_consent  # noqa: E402

pytest_plugins = ["tests.costs", "tests.doctests", "tests.guests"]

MACHINE_CODE = {"native", "machine_code"}  # folders of tests

PATIENT = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}

settings.register_profile("same", derandomize=True, **PATIENT)
settings.register_profile("explore", derandomize=False, print_blob=True, **PATIENT)  # on servers of CI, too
settings.load_profile("same")


def pytest_configure(config: pytest.Config) -> None:
    """Keep Hypothesis from drawing constants of the modules that are loaded, unless new cases are explored.

    Which are loaded depends on the tests before, and all of them are parsed for it.
    """
    with suppress(ImportError):  # older versions draw no constants
        from hypothesis.internal.conjecture import providers

        if config.getoption("hypothesis_profile", None) != "explore" and hasattr(providers, "_get_local_constants"):
            providers._get_local_constants = lambda: providers._local_constants


@pytest.hookimpl(wrapper=True, optionalhook=True)
def pytest_xdist_auto_num_workers() -> Iterator[int]:
    """Start one process more than there are cores: a test also waits, for a browser, a server or another process."""
    return (yield) + 1


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection(session: pytest.Session) -> Iterator[object]:
    """Pause garbage collection while tests are collected: to search a million new objects takes a fifth of its time.

    From then on it leaves them out: to search them takes a second each time, in whichever test it happens.
    """
    gc.disable()
    try:
        _share_compilation(session.config)
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(20_000, 20, 1000)
        gc.enable()


def _share_compilation(config: pytest.Config) -> None:
    """Import the modules of a whole run in another order in each process, so that each compiles a part for all."""
    worker = getattr(config, "workerinput", None)
    if worker is None or config.args_source != pytest.Config.ArgsSource.TESTPATHS:
        return
    files = sorted((config.rootpath / "tests").rglob("test_*.py"))
    first = len(files) * int(worker["workerid"].removeprefix("gw")) // worker["workercount"]
    for file in files[first:] + files[:first]:
        with suppress(Exception, pytest.skip.Exception):  # collection reports them
            import_module(".".join(file.relative_to(config.rootpath).with_suffix("").parts))


def pytest_sessionstart() -> None:
    """Patch for all tests what a fixture would patch for each, which takes longer than many tests."""
    os.fsync = lambda descriptor: None  # the loss of power that it is for does not come
    code_consent.consent_file = lambda: None  # remember nothing in the folder of the user


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Select the instructions of models as for long ones, in a fifth of the time; fixtures of modules do so, too.

    Slow tests, those of the machine code itself and those with the mark `bits` compile as users do.
    """
    marked = any(item.get_closest_marker(name) for name in ("slow", "bits"))
    engine.LEVEL = engine.BEST if marked or MACHINE_CODE & set(item.path.parts) else 0

"""Measurements in processes of their own, so that neither memory nor threads of one show in another."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any

from kennfeld.base.threads import available_cores

__all__ = ["apart", "environment_of_users", "installed", "peak", "repeated", "reset_peak", "threads"]

ROOT = Path(__file__).parents[1]
POOLS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def threads(cores: int | None) -> int:
    """Return the number of threads for a measurement on so many cores, None for all."""
    return cores or available_cores()


def installed(*packages: str) -> bool:
    """Return True if all packages can be imported."""
    return all(find_spec(package) is not None for package in packages)


def environment_of_users() -> dict[str, str]:
    """Return the environment variables of this process, except that Python keeps its byte code.

    Compiling all modules takes longer than a short run.
    """
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def apart(target: str, *, cores: int | None = None, timeout: float = 900.0, **arguments: Any) -> dict[str, Any]:
    """Return the result of `module:function` in a fresh process, held to `cores` cores where the system can do that.

    Arguments and result pass as JSON. A process that fails or lasts longer than `timeout` gives {"error": a sentence}.
    """
    environment = environment_of_users()
    if cores is not None:
        environment |= dict.fromkeys(POOLS, str(cores)) | {"BENCHMARK_CORES": str(cores)}
    command = [sys.executable, "-m", "benchmarks.worker", target, json.dumps(arguments)]
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired:
        return {"error": f"did not end within {timeout:g} s"}
    if done.returncode:
        return {"error": (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]}
    durations: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return durations


def repeated(work: Callable[[], object], least: int = 3, lasting: float = 1.0, most: int = 50) -> dict[str, float]:
    """Return the shortest and the median duration in s of at least `least` calls that take about `lasting` s."""
    durations: list[float] = []
    while len(durations) < least or (sum(durations) < lasting and len(durations) < most):
        began = time.perf_counter()
        work()
        durations.append(time.perf_counter() - began)
    return {"best": min(durations), "median": median(durations), "runs": len(durations)}


def reset_peak() -> int:
    """Reset the peak memory of this process, and return its present memory in bytes."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")
    return _status("VmRSS")


def peak() -> int:
    """Return the peak memory of this process since `reset_peak`, in bytes."""
    return _status("VmHWM")


def _status(field: str) -> int:
    # getrusage is the fallback only: after an exec it still knows the size of the process that started this one.
    status = Path("/proc/self/status")
    if status.exists():
        return 1024 * next(
            int(line.split()[1]) for line in status.read_text(encoding="utf-8").splitlines() if line.startswith(field)
        )
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)

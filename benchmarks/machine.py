"""Environment of a benchmark: the machine, its load, and the versions of what took part."""

import datetime
import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

__all__ = ["PACKAGES", "heading", "load"]

PACKAGES = (
    "kennfeld",
    "numpy",
    "scipy",
    "llvmlite",
    "lmfit",
    "casadi",
    "optimistix",
    "jax",
    "optimagic",
    "pyceres",
    "fmpy",
)


def processor() -> str:
    """The model name of the processor."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def load() -> str:
    """The load of the last minute: how many processes wanted to run, on average."""
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"


def package(name: str) -> str:
    """Name and version of an installed package, or that it is missing."""
    try:
        return f"{name} {version(name)}"
    except PackageNotFoundError:
        return f"{name} missing"


def heading() -> str:
    """Date, machine and versions as lines of markdown."""
    return "\n".join(
        [
            f"- Date: {datetime.datetime.now(datetime.UTC):%Y-%m-%d %H:%M} UTC",
            f"- Machine: {processor()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}; "
            f"load of the last minute at the beginning {load()}",
            f"- Python {platform.python_version()}; {', '.join(package(name) for name in PACKAGES)}",
        ]
    )

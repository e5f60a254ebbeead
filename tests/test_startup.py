"""The modules that a command loads. Nothing else decides how long a short run takes to start."""

import subprocess
import sys
from pathlib import Path

import pytest

import kennfeld.base.lazy_names
from kennfeld.project.demo import write
from tests.draws import mostly_slow

FACES = ("calfiles", "models.formula", "native", "optimize", "optimize.trust", "surrogate")

# libraries of which a run on CSV, DCM and formula text needs nothing
LIBRARIES = {
    *("asammdf", "cma", "h5py", "pandas", "pint", "pydantic", "python_calamine", "scipy", "starlette", "typer"),
    *("uvicorn", "xlsxwriter", "multiprocessing", "rich", "matplotlib"),
}
# and packages and modules of our own
OTHER_LANGUAGES = {
    "app",
    "matlab",
    "notebook",
    "models.imperative",
    "importers.simulink.importing",
    "surrogate",
    "base.workbooks",
}
OTHER_FORMATS = {
    *("calfiles.a2l.image_files", "calfiles.a2l.parser", "calfiles.cdfx", "calfiles.excel", "calfiles.matlab_reader"),
    *("calfiles.comparison", "calfiles.merging", "measurement.mdf", "measurement.excel", "measurement.matlab"),
}
ANALYSIS = {"analysis", "report", "optimize.trust", "optimize.fit.fit", "optimize.tuning", "optimize.api"}
COMPUTATION = {"base.machine_code", "native", "models.formula", "optimize"}

# by command, what it must do without
UNNEEDED = {
    "calibrate": {"analysis.cross_validation", "optimize.api", "optimize.tuning.smoothness"},
    "check": ANALYSIS,
    "simulate": ANALYSIS,
    "report": {"analysis.cross_validation", "optimize.fit.fit", "optimize.api"},
    "info": ANALYSIS | COMPUTATION,
}
UNNEEDED_LIBRARIES = {"check": {"pyarrow.parquet"}, "info": {"llvmlite", "pyarrow", "threadpoolctl"}}


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write("torque", tmp_path_factory.mktemp("startup"))


def modules_after(*codes: str) -> list[list[str]]:
    """Return the modules that a fresh interpreter holds after running each of some pieces of code."""
    script = "\n".join(["import sys", *(f"{code}\nprint('modules:', *sys.modules)" for code in codes)])
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("modules: ")]


def those_in(modules: list[str], packages: set[str]) -> list[str]:
    return [name for name in modules if any(name == package or name.startswith(f"{package}.") for package in packages)]


@pytest.mark.parametrize("command", mostly_slow(UNNEEDED, ["check"]))
def test_a_command_loads_what_it_needs(command: str, project: Path) -> None:
    [modules] = modules_after(f"from kennfeld.cli import run\nassert run([{command!r}, {str(project)!r}]) == 0")
    assert "kennfeld.project.project" in modules
    assert those_in(modules, LIBRARIES | UNNEEDED_LIBRARIES.get(command, set())) == []
    own = OTHER_LANGUAGES | OTHER_FORMATS | UNNEEDED[command]
    assert those_in(modules, {f"kennfeld.{name}" for name in own}) == []


@pytest.mark.parametrize("face", mostly_slow(FACES, ["optimize"]))
def test_the_face_of_a_package_loads_its_modules_when_they_are_used(face: str) -> None:
    package = f"kennfeld.{face}"
    modules, used = modules_after(f"import {package} as face", "[getattr(face, name) for name in face.__all__]")
    assert len(those_in(modules, {package})) < 8
    assert set(modules) < set(used)


@pytest.mark.parametrize("face", FACES)
def test_no_name_of_a_face_is_that_of_a_module(face: str) -> None:
    package = __import__(f"kennfeld.{face}", fromlist=["__all__"])
    files = {path.stem for path in Path(package.__file__).parent.iterdir()}
    assert files.isdisjoint(package.__all__)


def test_an_unknown_name_of_a_face_is_an_error() -> None:
    with pytest.raises(AttributeError, match=r"module 'kennfeld\.native' has no attribute 'Kernels'"):
        kennfeld.base.lazy_names.lazy_names("kennfeld.native", {"kernel": "Kernel"})("Kernels")

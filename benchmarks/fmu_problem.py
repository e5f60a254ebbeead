"""FMUs of the topic `fmu`, compiled from `fmu_models.c`, and data for their calibration."""

import platform
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["PROBLEMS", "Problem", "build", "data_of"]

Float = NDArray[np.float64]
SOURCE = Path(__file__).with_name("fmu_models.c")
NOISE = 0.05
GRID = (6, 5, 4)  # rows and columns of the map, points of the curve


class Problem:
    """An FMU whose parameters are to be found.

    Attributes:
        name: its name, in upper case the macro that selects it.
        states: names of its states, of which the first is the output.
        inputs: names of its inputs.
        parameters: names and start values of its parameters.
        true: values of the parameters with which the data are made.
    """

    def __init__(
        self, name: str, states: tuple[str, ...], inputs: tuple[str, ...], parameters: dict[str, float], true: Float
    ) -> None:
        self.name, self.states, self.inputs, self.parameters, self.true = name, states, inputs, parameters, true

    @property
    def output(self) -> str:
        """The name of its output."""
        return self.states[0]

    @property
    def tables(self) -> tuple[str, ...]:
        """The names of its scalars, curves and maps."""
        return tuple(dict.fromkeys(name.partition("[")[0] for name in self.parameters))

    def tables_of(self, values: Float) -> dict[str, Float]:
        """Return the values of each scalar, curve and map."""
        members: dict[str, list[float]] = {name: [] for name in self.tables}
        for name, value in zip(self.parameters, values.tolist(), strict=True):
            members[name.partition("[")[0]].append(value)
        shapes = {"MapSettled": GRID[:2], "CurveTimeConstant": GRID[2:]}
        return {name: np.reshape(numbers, shapes.get(name, ())) for name, numbers in members.items()}


def _exhaust() -> Problem:
    rows, columns, points = GRID
    rng = np.random.default_rng(1)
    names = [f"MapSettled[{i + 1},{j + 1}]" for i in range(rows) for j in range(columns)]
    curve = [f"CurveTimeConstant[{k + 1}]" for k in range(points)]
    true = np.concatenate([rng.uniform(150.0, 700.0, rows * columns), rng.uniform(2.0, 9.0, points)])
    starts = dict.fromkeys(names, 230.0) | dict.fromkeys(curve, 5.0)
    return Problem("exhaust", ("T",), ("speed", "injection", "air"), starts, true)


PROBLEMS = {
    "vanderpol": Problem("vanderpol", ("x0", "x1"), (), {"mu": 1.0}, np.array([1.7])),
    "lag": Problem("lag", ("y",), ("u",), {"tau": 1.0, "gain": 1.0}, np.array([0.4, 2.5])),
    "exhaust": _exhaust(),
}


def build(folder: Path, name: str, *, directional: bool = True) -> Path:
    """Compile an FMU for this platform.

    Raises:
        FileNotFoundError: there is no C compiler `gcc`.
    """
    problem = PROBLEMS[name]
    system = {"win32": ("win", ".dll"), "darwin": ("darwin", ".dylib")}.get(sys.platform, ("linux", ".so"))
    machine = platform.machine().lower()
    library = folder / f"models{system[1]}"
    macros = [
        f"-D{name.upper()}",
        *(f"-D{key}={n}" for key, n in zip(("ROWS", "COLUMNS", "POINTS"), GRID, strict=True)),
    ]
    subprocess.run(["gcc", "-shared", "-fPIC", "-O2", "-w", *macros, "-o", library, SOURCE, "-lm"], check=True)
    path = folder / f"{name}.fmu"
    place = f"{system[0]}64" if machine in ("amd64", "x86_64") else f"{system[0]}-{machine}"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", _description(problem, directional))
        archive.write(library, f"binaries/{place}/{library.name}")
    return path


def _description(problem: Problem, directional: bool) -> str:
    first = len(problem.states)
    lines = [_variable("time", 'causality="independent"', "")]
    words = ['causality="output" initial="calculated"', *['causality="local"'] * (first - 1)]
    lines += [_variable(name, word, "") for name, word in zip(problem.states, words, strict=True)]
    lines += [_variable(f"der({name})", "", f'derivative="{k + 2}"') for k, name in enumerate(problem.states)]
    lines += [_variable(name, 'causality="input"', 'start="0"') for name in problem.inputs]
    fixed = 'causality="parameter" variability="tunable"'
    lines += [
        _variable(name, fixed, f'start="{start}"' + (' min="0.001"' if start < 10 else ""))
        for name, start in problem.parameters.items()
    ]
    numbered = "".join(line.format(number) for number, line in enumerate(lines))
    derivatives = "".join(f'<Unknown index="{first + 2 + k}"/>' for k in range(first))
    offered = 'providesDirectionalDerivative="true"' if directional else ""
    return f"""<?xml version="1.0"?>
<fmiModelDescription fmiVersion="2.0" modelName="{problem.name}" guid="{{models}}" numberOfEventIndicators="0">
<ModelExchange modelIdentifier="models" {offered}/>
<CoSimulation modelIdentifier="models" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>{numbered}</ModelVariables>
<ModelStructure><Outputs><Unknown index="2"/></Outputs><Derivatives>{derivatives}</Derivatives></ModelStructure>
</fmiModelDescription>"""


def _variable(name: str, words: str, real: str) -> str:
    return f'<ScalarVariable name="{name}" valueReference="{{}}" {words}><Real {real}/></ScalarVariable>'


def data_of(name: str, samples: int, span: float) -> dict[str, Float]:
    """Return time and inputs over `span` s: sums of sines, for the exhaust model over the whole grid."""
    time = np.arange(samples) * (span / samples)
    rng = np.random.default_rng(2)
    inputs = {}
    for channel in PROBLEMS[name].inputs:
        frequencies, phases = rng.uniform(0.05, 0.5, 3), rng.uniform(0.0, 6.0, 3)
        waves = np.sin(2 * np.pi * np.outer(time, frequencies) + phases).sum(axis=1)
        inputs[channel] = np.clip(0.5 + 0.35 * waves, 0.0, 1.0)
    return {"time": time, **inputs}

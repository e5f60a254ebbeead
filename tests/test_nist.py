"""The nonlinear regression problems of NIST, whose answers are certified: every one, from both starts, one setting."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from tests.draws import mostly_slow

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data" / "nist_strd"
PROBLEMS = [
    "Bennett5",
    "BoxBOD",
    "Chwirut1",
    "Chwirut2",
    "DanWood",
    "ENSO",
    "Eckerle4",
    "Gauss1",
    "Gauss2",
    "Gauss3",
    "Hahn1",
    "Kirby2",
    "Lanczos1",
    "Lanczos2",
    "Lanczos3",
    "MGH09",
    "MGH10",
    "MGH17",
    "Misra1a",
    "Misra1b",
    "Misra1c",
    "Misra1d",
    "Nelson",
    "Rat42",
    "Rat43",
    "Roszman1",
    "Thurber",
]
EASY = {  # for which few steps suffice
    *("Chwirut1", "Chwirut2", "DanWood", "Gauss1", "Gauss2", "Kirby2", "Lanczos1", "Lanczos2"),
    *("Misra1a", "Misra1b", "Misra1c", "Misra1d", "Nelson", "Rat42", "Roszman1"),
}
SETTINGS = kf.Options(max_iterations=2000, tolerance=1e-15)

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason=f"the NIST problems are not at {FOLDER}")


@dataclass(frozen=True)
class Certified:
    """A problem as its file states it."""

    formula: str
    columns: dict[str, np.ndarray]
    starts: tuple[dict[str, float], dict[str, float]]
    values: dict[str, float]
    deviations: dict[str, float]
    squares: float


def read(name):
    text = (FOLDER / f"{name}.dat").read_text(encoding="ascii")
    lines = text.splitlines()
    first, last = (int(n) for n in re.search(r"Data\s+\(lines\s+(\d+)\s+to\s+(\d+)\)", text).groups())
    numbers = np.array([line.split() for line in lines[first - 1 : last]], dtype=float).T
    response, model = re.search(r"^ +(y|log\[y\]) += (.+?)\+\s*e\s*$", text, re.MULTILINE | re.DOTALL).groups()
    predictors = ["x"] if len(numbers) == 2 else ["x1", "x2"]
    columns = dict(zip(["y", *predictors], numbers, strict=True))
    if response != "y":
        columns["y"] = np.log(columns["y"])
    rows = re.findall(r"^ +(b\d+) += +(\S+) +(\S+) +(\S+) +(\S+)\s*$", text, re.MULTILINE)
    starts = tuple({row[0]: float(row[i]) for row in rows} for i in (1, 2))
    squares = float(re.search(r"Residual Sum of Squares:\s+(\S+)", text)[1])
    values, deviations = ({row[0]: float(row[i]) for row in rows} for i in (3, 4))
    return Certified(as_formula(model), columns, starts, values, deviations, squares)


def as_formula(model):
    """The model text of a file as formula text: one line, our signs for powers, brackets and functions."""
    text = " ".join(model.split())
    for theirs, ours in (("**", "^"), ("[", "("), ("]", ")"), ("arctan", "atan")):
        text = text.replace(theirs, ours)
    return f"model = {text}"


def test_all_problems_are_there():
    assert sorted(path.stem for path in FOLDER.glob("*.dat")) == PROBLEMS


@pytest.mark.parametrize(
    "start", [pytest.param(0, id="far start"), pytest.param(1, id="near start", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("name", mostly_slow(PROBLEMS, set(PROBLEMS) - EASY - {"MGH10"}))  # it takes hundreds of steps
def test_the_certified_values_are_found(name, start):
    problem = read(name)
    result = kf.calibrate(problem.formula, problem.columns, problem.starts[start], target="y", options=SETTINGS)
    values = {n: result.parameters[n].value for n in problem.values}
    names = {n: n for n in problem.values}
    if name == "MGH17" and values["b4"] > values["b5"]:  # its two exponentials may change places
        names |= {"b2": "b3", "b3": "b2", "b4": "b5", "b5": "b4"}
    values = {n: values[other] for n, other in names.items()}
    assert values == pytest.approx(problem.values, rel=1e-6, abs=0.0), result.message
    assert result.status == "converged"
    assert result.cost_after == pytest.approx(problem.squares, rel=1e-6, abs=1e-20)
    if problem.squares > 1e-15:  # less is the rounding of the data
        deviations = {n: float(result.trust.deviation[other]) for n, other in names.items()}
        assert deviations == pytest.approx(problem.deviations, rel=1e-4, abs=0.0)

"""The nonlinear regressions of NIST's Statistical Reference Datasets, read from their files."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["DIGITS", "Regression", "digits", "read"]

Float = NDArray[np.float64]
DIGITS = 6


@dataclass(frozen=True)
class Regression:
    """One data set: its model as text, two starts, and the certified answer."""

    name: str
    expression: str  # right-hand side in Python's notation, of x (or x1, x2) and b1, b2, ...
    logarithm: bool  # whether the model is of log(y)
    starts: Float  # Float[2, parameters]
    certified: Float  # Float[parameters]
    columns: dict[str, Float]  # predictors, and "y", the logarithm taken

    @property
    def names(self) -> list[str]:
        """The parameters."""
        return [f"b{i + 1}" for i in range(self.certified.size)]

    @property
    def formula(self) -> str:
        """The model as Kennfeld's formula text."""
        return f"model = {self.expression.replace('**', '^').replace('arctan', 'atan')}"


def read(file: Path) -> Regression:
    """Read a data file."""
    lines = file.read_text(encoding="utf-8").splitlines()
    rows = [re.match(r"\s*b\d+\s*=(.*)", line) for line in lines[40:60]]
    numbers = np.array([[float(word) for word in row.group(1).split()] for row in rows if row])
    model, logarithm = _model(lines[25:40])
    at = max(i for i, line in enumerate(lines) if line.startswith("Data:"))
    names = lines[at].split()[1:]
    table = np.array([[float(word) for word in line.split()] for line in lines[at + 1 :] if line.strip()])
    columns = dict(zip(names, table.T, strict=True))
    if logarithm:
        columns["y"] = np.log(columns["y"])
    return Regression(file.stem, model, logarithm, numbers[:, :2].T, numbers[:, 2], columns)


def _model(lines: list[str]) -> tuple[str, bool]:
    at = next(i for i, line in enumerate(lines) if re.match(r"\s*(y|log\[y\])\s*=", line))
    text = []
    for line in lines[at:]:
        if not line.strip():
            break
        text.append(line.strip())
    left, right = " ".join(text).split("=", 1)
    right = re.sub(r"\+\s*e\s*$", "", right.strip()).translate(str.maketrans("[]", "()"))
    return right.strip(), "log" in left


def digits(values: Float, certified: Float) -> float:
    """Return the number of digits to which the worst parameter agrees, at most 11, as many as are certified."""
    with np.errstate(all="ignore"):
        error = np.max(np.abs(values - certified) / np.abs(certified))
    return 0.0 if not np.isfinite(error) else float(np.clip(-np.log10(max(error, 1e-11)), 0.0, 11.0))

"""The trust in each value, read back from the folder of an earlier run."""

import csv
import json
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.parameters import ParameterSet
from kennfeld.report.trust import Direction, TrustView

__all__ = ["stored_trust"]

COLUMNS = ("samples", "deviation", "leverage", "informed", "by_smoothness")
FLAGS = ("informed", "by_smoothness")


def stored_trust(folder: Path, parameters: ParameterSet) -> TrustView:
    """The parts of a trust that stand in `trust.csv` and `result.json`; empty where there are none, or others' tables.

    What a report says without them is right all the same, so nothing is raised.
    """
    try:
        return TrustView(**_said(folder / "result.json"), **_tables(folder, parameters))
    except (OSError, ValueError, KeyError, TypeError):
        return TrustView()


def _said(path: Path) -> dict[str, Any]:
    """What stands there in words."""
    trust = json.loads(path.read_text(encoding="utf-8")).get("trust") or {}
    whole = trust.get("null_space") or {}
    return {
        "directions": tuple(Direction(entry["sentence"], entry["remedy"]) for entry in trust.get("directions", [])),
        "null_space": Direction(whole["sentence"], whole["remedy"]) if whole.get("sentence") else None,
        "holdings": tuple(entry["sentence"] for entry in trust.get("holdings", [])),
        "remark": trust.get("remark", ""),
    }


def _tables(folder: Path, parameters: ParameterSet) -> dict[str, Any]:
    """An array for each column and parameter that the table is complete for, and for each axis in it."""
    path = folder / "trust.csv"
    if not path.is_file():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    found: dict[str, dict[str, Any]] = {column: {} for column in COLUMNS}
    for name, group in groupby(rows, key=lambda row: row["parameter"]):
        lines = list(group)
        shape = parameters[name].values.shape if name in parameters else (len(lines),)
        if int(np.prod(shape)) == len(lines):
            for column in COLUMNS:
                values = _column(lines, column).reshape(shape)
                if not np.isnan(values).all():
                    found[column][name] = _typed(column, values)
    return found


def _column(lines: Sequence[Mapping[str, str]], column: str) -> Float:
    return np.array([float(line[column] or "nan") for line in lines])


def _typed(column: str, values: Float) -> Any:
    if column in FLAGS:
        return values != 0
    return values.astype(np.int64) if column == "samples" else values

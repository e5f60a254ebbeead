"""What `kennfeld surrogate train` reads: a file that says from which recordings a data-driven model is made."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kennfeld.dataset import Dataset
from kennfeld.errors import ArgumentError, Finding, InputError, nearest
from kennfeld.project.calculated import read_calculated
from kennfeld.project.loading import Wanted, load
from kennfeld.project.schema import CalibrationEntry, ModelEntry, OptimizerEntry, ProjectFile
from kennfeld.project.section import Section
from kennfeld.project.sections import read_datasets
from kennfeld.project.toml import read_toml
from kennfeld.surrogate import Surrogate
from kennfeld.surrogate.training import SurrogateSettings, train_surrogate

__all__ = ["Training", "read_training"]

SECTIONS = ("surrogate", "calculated", "dataset")


@dataclass(frozen=True, eq=False)
class Training:
    """A training file: its data, the settings, and the file that the surrogate goes to."""

    data: ProjectFile
    settings: SurrogateSettings
    target: Path

    def datasets(self) -> list[Dataset]:
        """The recordings. Raises `InputError` with every problem of theirs."""
        findings: list[Finding] = []
        calculated = read_calculated(self.data, findings)
        needed = dict.fromkeys(self.settings.inputs, "an input of the surrogate")
        needed[self.settings.output] = "the output of the surrogate"
        loaded = load(self.data, Wanted(needed), calculated, findings)
        if any(finding.severity == "error" for finding in findings):
            raise InputError(findings)
        return loaded.datasets

    def train(self, report: Callable[[str], None] = lambda line: None) -> Surrogate:
        """The surrogate; `report` hears how it goes on. Raises `InputError` where the data do not suffice."""
        return train_surrogate(self.datasets(), self.settings, report)


def read_training(path: str | Path) -> Training:
    """The values of a training file. Raises `InputError` with every problem of the file itself."""
    path, findings = Path(path), list[Finding]()
    root = Section(read_toml(path), path.name, findings)
    settings, target = _surrogate(root, path)
    data = ProjectFile(
        path=path,
        name=path.stem,
        model=ModelEntry(""),
        channels={},
        calculated=root.text_table("calculated"),
        datasets=read_datasets(root),
        calibration=CalibrationEntry(),
        axes={},
        parameters={},
        criteria=(),
        optimizer=OptimizerEntry(),
    )
    for key in root.values:
        if key not in SECTIONS:
            root.report(f"[{key}]", "is no section that a training file knows", nearest(key, SECTIONS))
    if any(finding.severity == "error" for finding in findings) or settings is None:
        raise InputError(findings)
    return Training(data, settings, path.parent / target)


def _surrogate(root: Section, path: Path) -> tuple[SurrogateSettings | None, str]:
    section = root.section("surrogate", 'Write [surrogate] with inputs = ["..."] and output = "...".')
    if section is None:
        return None, ""
    for key in ("inputs", "output"):
        if not section.has(key):
            section.report(key, "the key is missing", "Write the names of channels.")
    name = section.text("name") or (path.stem if path.stem != "surrogate" else section.text("output"))
    inputs = section.texts("inputs")
    given: dict[str, Any] = {
        "kind": section.choice("kind", "static", ("static", "dynamic")),
        "method": section.choice("method", "auto", ("auto", "exact", "sparse", "expansion")),
        "centres": section.whole("centres", 300, 1),
        "seed": section.whole("seed", 0, 0),
        "starts": section.whole("starts", 3, 1),
        "step": section.number("step", 0.0, 0.0, above=True) or None,
        "lags": _lags(section),
        "output_lags": _whole_numbers(section, "output_lags"),
        "longest_lag": section.whole("longest_lag", 20, 1),
        "free_run": section.flag("free_run") is not False,
        "moves_centres": section.flag("moves_centres") is True,
        "hold": section.number("hold", 0.0, 0.0) if section.has("hold") else None,
        "iterations": section.whole("iterations", 15, 1),
    }
    limits = _limits(section)
    if limits is not None:
        given["limits"] = limits
    target = section.text("file") or f"{name}.json"
    output = section.text("output")
    section.end()
    try:
        return SurrogateSettings(name, inputs, output, **given), target
    except ArgumentError as error:
        section.report("", str(error))
        return None, target


def _lags(section: Section) -> Any:
    """Lags by input, or "auto"."""
    if section.get("lags") in (None, "auto"):
        return "auto"
    inner = section.inner("lags")
    return "auto" if inner is None else {name: _whole_numbers(inner, name) for name in inner.values}


def _whole_numbers(section: Section, key: str) -> Any:
    value = section.get(key)
    if value in (None, "auto"):
        return "auto"
    numbers = value if isinstance(value, list) else [value]
    if not all(isinstance(number, int) and not isinstance(number, bool) and number >= 0 for number in numbers):
        section.report(key, f"{value!r} is no list of whole numbers", f'Write {key} = [1, 2], or "auto".')
        return "auto"
    return tuple(numbers)


def _limits(section: Section) -> tuple[float, float] | None:
    """Two numbers, either of which may be infinite."""
    value = section.get("limits")
    if value is None:
        return None
    if isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)) and value[0] < value[1]:
        return float(value[0]), float(value[1])
    section.report("limits", f"{value!r} is no pair of a lower and a higher number", "Write limits = [0, inf].")
    return None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)

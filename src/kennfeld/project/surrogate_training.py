"""Reads training files, `kennfeld surrogate train`: the recordings and settings of a surrogate."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.errors import ArgumentError, Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.preprocessing.calculated import parse_calculated
from kennfeld.preprocessing.pipeline import load_datasets
from kennfeld.preprocessing.recordings import ChannelRequest
from kennfeld.project.schema import MAX_STARTS, CalibrationEntry, ModelEntry, OptimizerEntry, ProjectFile
from kennfeld.project.sections import read_datasets
from kennfeld.project.structuring import Section, as_number
from kennfeld.project.toml_file import read_toml
from kennfeld.surrogate.surrogate_file import Surrogate
from kennfeld.surrogate.training import SurrogateSettings, train_surrogate
from kennfeld.surrogate.training_data import extract_points, raster_of, split_recordings

DYNAMIC_KEYS = (
    *("step", "lags", "output_lags", "longest_lag", "limits"),
    *("free_run", "moves_centres", "hold", "iterations"),
)
METHODS = {"static": ("auto", "exact", "sparse", "expansion"), "dynamic": ("auto", "sparse")}

SECTIONS = ("surrogate", "calculated", "dataset", "units")


def read_settings(root: Section, path: Path) -> tuple[SurrogateSettings | None, str]:
    """Return the settings, None with findings if they are invalid, and the name of the file to write."""
    section = root.section("surrogate", 'Write [surrogate] with inputs = ["..."] and output = "...".')
    if section is None:
        return None, ""
    before = len(section.findings)
    inputs, output = _channels(section)
    name = section.text("name") or (path.stem if path.stem != "surrogate" else output)
    kind = section.choice("kind", "static", tuple(METHODS))
    settings = {"kind": kind, "method": _method(section, kind), **_numbers(section), **_dynamic(section, kind, inputs)}
    target = section.text("file") or f"{name}.json"
    _check_target(section, path, target)
    section.end()
    if len(section.findings) > before:
        return None, target
    try:
        return SurrogateSettings(name, inputs, output, **settings), target
    except ArgumentError as error:
        section.report("", str(error))
        return None, target


def _channels(section: Section) -> tuple[tuple[str, ...], str]:
    for key in ("inputs", "output"):
        if not section.has(key):
            section.report(key, "the key is missing", "Write names of channels.")
    inputs, output = section.texts("inputs"), section.text("output")
    if section.get("inputs") == []:
        section.report("inputs", "the list is empty", "Write names of channels.")
    if output and output in inputs:
        section.report("output", f"{output} is also an input", "Remove it from inputs.")
    return inputs, output


def _method(section: Section, kind: str) -> str:
    method = section.choice("method", "auto", METHODS["static"])
    if method not in METHODS[kind]:
        section.report("method", f'"{method}" requires a static surrogate', 'Write "auto" or "sparse".')
    return method


def _numbers(section: Section) -> dict[str, Any]:
    default = SurrogateSettings
    return {
        "centres": section.whole("centres", default.centres, 1),
        "seed": section.whole("seed", default.seed, 0),
        "starts": section.whole("starts", default.starts, 1, MAX_STARTS),
    }


def _dynamic(section: Section, kind: str, inputs: Sequence[str]) -> dict[str, Any]:
    """Return the settings of dynamic surrogates."""
    if kind == "static":
        for key in DYNAMIC_KEYS:
            if section.has(key):
                remedy = 'Write kind = "dynamic", or remove it.'
                section.report(key, f"{key} requires a dynamic surrogate", remedy)
        return {}
    default = SurrogateSettings
    settings = {
        "step": section.number("step", 0.0, 0.0, above=True) or None,
        "lags": _lags(section, inputs),
        "output_lags": _whole_numbers(section, "output_lags", 1),
        "longest_lag": section.whole("longest_lag", default.longest_lag, 1),
        "free_run": section.flag("free_run") is not False,
        "moves_centres": section.flag("moves_centres") is True,
        "hold": section.number("hold", 0.0, 0.0) if section.has("hold") else None,
        "iterations": section.whole("iterations", default.iterations, 1),
    }
    limits = _limits(section)
    return settings if limits is None else settings | {"limits": limits}


def _lags(section: Section, inputs: Sequence[str]) -> Any:
    """Return lags by input, or "auto"."""
    if section.get("lags") in (None, "auto"):
        return "auto"
    inner = section.inner("lags")
    if inner is None:
        return "auto"
    for name in inner.values:
        if inputs and name not in inputs:
            inner.report(name, f"unknown input {name}", nearest(name, inputs) or f"Inputs are {', '.join(inputs)}.")
    for name in inputs:
        if name not in inner.values:
            inner.report(name, "the input is missing", f"Write {name} = [0] for the current sample, or other lags.")
    return {name: _whole_numbers(inner, name, 0) for name in inner.values}


def _whole_numbers(section: Section, key: str, least: int) -> Any:
    value = section.get(key)
    if value is None or (value == "auto" and least):
        return "auto"
    numbers = value if isinstance(value, list) else [value]
    whole = all(isinstance(number, int) and not isinstance(number, bool) and number >= least for number in numbers)
    if not whole or not numbers:
        remedy = f"Write {key} = [1, 2]" + (', or "auto".' if least else ".")
        section.report(key, f"must be integers >= {least}, in samples, got {value!r}", remedy)
        return "auto"
    return tuple(numbers)


def _limits(section: Section) -> tuple[float, float] | None:
    """Return two numbers, which may be infinite."""
    value = section.get("limits")
    if value is None:
        return None
    ends = [as_number(end) for end in value] if isinstance(value, list) else []
    if len(ends) != 2 or ends[0] is None or ends[1] is None or not ends[0] < ends[1]:
        section.report("limits", f"must be a lower and a higher number, got {value!r}", "Write limits = [0, inf].")
        return None
    return ends[0], ends[1]


def _check_target(section: Section, path: Path, target: str) -> None:
    """Report a target that cannot be written, before the training."""
    file = path.parent / target
    if not file.parent.is_dir():
        section.report("file", f"folder {Path(target).parent} does not exist", "Create it, or name another one.")
    elif file.is_dir():
        section.report("file", f"{target} is a folder", 'Write file = "....json".')
    elif file.resolve() == path.resolve():
        section.report("file", f"{target} is this training file", 'Write file = "....json".')


@dataclass(frozen=True, eq=False)
class Training:
    """A training file: its data, its settings, and the file to write."""

    data: ProjectFile
    settings: SurrogateSettings
    target: Path

    @property
    def formula(self) -> str:
        """The call of the surrogate, `n = engine(throttle, load)`."""
        return f"{self.settings.output} = {self.settings.name}({', '.join(self.settings.inputs)})"

    def datasets(self) -> list[Dataset]:
        """Return the recordings. Raises `InputError` with every problem of their files."""
        findings: list[Finding] = []
        datasets = self._datasets(findings)
        if any(finding.severity == "error" for finding in findings):
            raise InputError(findings)
        return datasets

    def check(self) -> tuple[list[Dataset], list[Finding]]:
        """Return the recordings and all findings about them, errors and warnings; nothing is trained."""
        findings: list[Finding] = []
        datasets = self._datasets(findings)
        if not any(finding.severity == "error" for finding in findings):
            findings += self._unusable(datasets)
        return datasets, list(dict.fromkeys(findings))

    def _datasets(self, findings: list[Finding]) -> list[Dataset]:
        calculated = parse_calculated(self.data, findings)
        needed = dict.fromkeys(self.settings.inputs, "an input of the surrogate")
        needed[self.settings.output] = "the output of the surrogate"
        return load_datasets(self.data, ChannelRequest(needed), calculated, findings).datasets

    def _unusable(self, datasets: list[Dataset]) -> Iterator[Finding]:
        """Yield reasons why the recordings cannot be used for training, as far as known without training."""
        training = [data for data in datasets if data.use == "training"]
        if not training:
            yield Finding(
                self.data.place("[[dataset]]"),
                "no dataset is used for training",
                'Write use = "training" in one of them.',
            )
            return
        tables = []
        try:
            step = raster_of(datasets, self.settings.step) if self.settings.kind == "dynamic" else 0.0
            tables = [table for data in training for table in self._tables(data, step)]
        except InputError as error:
            yield from error.findings
            return
        if not tables:
            message = "all gap-free pieces of the training data are too short"
            yield Finding(self.data.place("[[dataset]]"), message, "Increase max_gap, or use other files.")
            return
        whole = np.concatenate(tables)
        for name, column in zip((*self.settings.inputs, self.settings.output), whole.T, strict=True):
            if np.ptp(column) == 0:
                message = f"channel {name} is constant ({column[0]:g}) in the training data"
                yield Finding(self.data.place("[surrogate]"), message, "Remove it.")

    def _tables(self, dataset: Dataset, step: float) -> list[Float]:
        """Return the training samples of a dataset, Float[samples, inputs and output] per piece."""
        arguments = dataset, self.settings.inputs, self.settings.output
        if self.settings.kind == "dynamic":
            return [np.column_stack([run.u, run.y]) for run in split_recordings(*arguments, step)]
        return [np.column_stack(extract_points(*arguments))]

    def train(self, report: Callable[[str], None] = lambda line: None) -> Surrogate:
        """Train the surrogate, reporting lines on progress. Raises `InputError` if the data are insufficient."""
        return train_surrogate(self.datasets(), self.settings, report)


def read_training(path: str | Path) -> Training:
    """Read a training file. Raises `InputError` with every problem of the file itself."""
    path, findings = Path(path), list[Finding]()
    tables = read_toml(path)
    if "surrogate" not in tables and "model" in tables:
        raise InputError.of(path.name, "this is a project, not a training file", "Run `kennfeld calibrate`.")
    root = Section(tables, path.name, findings)
    settings, target = read_settings(root, path)
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
        units=root.text_table("units"),
    )
    _check_datasets(root)
    for key in root.values:
        if key not in SECTIONS:
            root.report(f"[{key}]", "unknown section", nearest(key, SECTIONS))
    if any(finding.severity == "error" for finding in findings) or settings is None:
        raise InputError(findings)
    return Training(data, settings, path.parent / target)


def _check_datasets(root: Section) -> None:
    """Report keys of `[[dataset]]` that apply to calibration only."""
    for section in root.sections("dataset"):
        for key in ("weight", "weight_channel", "settle", "average", "step"):
            if section.has(key):
                section.report(key, f"{key} is not supported in a training file", "Remove it.")
        shift = section.get("shift")
        if isinstance(shift, dict) and "auto" in shift.values():
            section.report("shift", '"auto" is not supported in a training file', "Write the shift as a number.")

"""Reads training files, `kennfeld surrogate train`: the recordings and settings of a surrogate."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, Finding, Findings, InputError, Location
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import within
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.file_keys import KeyProblem, key
from kennfeld.domain.search_settings import MAX_STARTS
from kennfeld.preprocessing.calculated import parse_calculated
from kennfeld.preprocessing.pipeline import load_datasets
from kennfeld.preprocessing.recipe import DatasetEntry, used_entries
from kennfeld.preprocessing.recordings import ChannelRequest
from kennfeld.project.forms import Form, IntegerForm, TableOfForm, TextsForm, keys_of, read_entry
from kennfeld.project.schema import SectionsFile, open_sections
from kennfeld.project.section import Section
from kennfeld.project.value_forms import PairForm
from kennfeld.surrogate.stopping import Stopped, never
from kennfeld.surrogate.surrogate_file import Surrogate
from kennfeld.surrogate.training import SurrogateSettings, train_surrogate
from kennfeld.surrogate.training_data import (
    extract_points,
    listed_twice,
    raster_of,
    repeated_rows,
    split_recordings,
)

_CHANNELS = "Write names of channels."
_UNSUPPORTED = ("weight", "weight_channel", "settle", "average", "step")  # keys of [[dataset]]


@dataclass(frozen=True)
class LagsForm(Form):
    """A number of samples, or a list of them; or "auto", if the current sample is not a lag."""

    least: int

    @property
    def label(self) -> str:
        return f"list of integers >= {self.least}" + (' or `"auto"`' if self.least else "")

    def read(self, section: Section, key: str) -> tuple[int, ...] | str | None:
        value = section.values[key]
        if value == "auto" and self.least:
            return "auto"
        lags = value if isinstance(value, list) else [value]
        if lags and all(isinstance(n, int) and not isinstance(n, bool) and n >= self.least for n in lags):
            return tuple(lags)
        remedy = f"Write {key} = [1, 2]" + (', or "auto".' if self.least else ".")
        section.report(key, f"must be integers >= {self.least}, in samples, got {value!r}", remedy)
        return None

    def json_schema(self) -> dict[str, Any]:
        number = IntegerForm(least=self.least).json_schema()
        lags = [number, {"type": "array", "items": number, "minItems": 1}]
        return {"anyOf": [*lags, {"const": "auto"}] if self.least else lags}


class LimitsForm(PairForm):
    """A lower and an upper limit, or "auto"."""

    label = '`"auto"` or `[lower, upper]`'

    def read(self, section: Section, key: str) -> Any:
        return "auto" if section.values[key] == "auto" else super().read(section, key)

    def json_schema(self) -> dict[str, Any]:
        return {"anyOf": [{"const": "auto"}, super().json_schema()]}


class InputLagsForm(TableOfForm):
    """Lags by input, or "auto"."""

    label = '`"auto"` or table of lists of integers >= 0'

    def read(self, section: Section, key: str) -> Any:
        value = section.values[key]
        if value == "auto":
            return value
        lags = super().read(section, key)
        return lags if lags is None else {name: lags.get(name, ()) for name in value}  # also of invalid ones

    def json_schema(self) -> dict[str, Any]:
        return {"anyOf": [{"const": "auto"}, super().json_schema()]}


@dataclass(frozen=True)
class SurrogateEntry:
    """`[surrogate]`; the keys with `dynamic` are for models of recordings over time."""

    inputs: tuple[str, ...] = key("channels", form=TextsForm(_CHANNELS), missing=_CHANNELS)
    output: str = key("the channel that is modelled", missing=_CHANNELS)
    name: str = key(
        "the name that `info` shows; a project can choose another name",
        "",
        default_text="the file's stem; `output` if the file is `surrogate.toml`",
    )
    kind: Literal["static", "dynamic"] = key(
        '`"static"` for points, `"dynamic"` for recordings over time', SurrogateSettings.kind
    )
    method: Literal["auto", "exact", "sparse", "expansion"] = key(
        '`"exact"` or `"sparse"` Gaussian process, or `"expansion"` for few centres by k-means; `"auto"` is exact up '
        "to 1000 points, or up to `centres` if that is given. Dynamic surrogates are always sparse",
        SurrogateSettings.method,
    )
    kernel: Literal["auto", "gaussian", "matern52"] = key(
        'shape of the bells, `"gaussian"` or `"matern52"` (of order 5/2); `"auto"` takes the one with the smaller '
        "residuals of points left out. Dynamic surrogates have Gaussian bells",
        SurrogateSettings.kernel,
    )
    noise: Literal["auto", "gaussian", "student"] = key(
        'distribution of the noise; with `"student"`, large errors count less. `"auto"` takes it for '
        "points without time if it is clearly more likely for residuals of points left out. Static surrogates only",
        SurrogateSettings.noise,
    )
    kinks: bool = key(
        "a Gaussian process may have kinks along single inputs, if residuals of points left out become smaller by more "
        "than chance. Static surrogates only",
        SurrogateSettings.kinks,
    )
    centres: int | None = key(
        "maximum number of centres", None, least=1, default_text="one per point up to 1000 points, else 300"
    )
    seed: int = key("random seed of the search for length scales", SurrogateSettings.seed, least=0)
    starts: int = key("number of starts of that search", SurrogateSettings.starts, least=1, most=MAX_STARTS)
    step: float | None = key("sampling step in s", None, above=0, dynamic=True, default_text="that of the data")
    lags: Mapping[str, tuple[int, ...]] | Literal["auto"] = key(
        "lags of each input in samples; 0 is the present sample: `{ throttle = [0, 4] }`",
        SurrogateSettings.lags,
        form=InputLagsForm(LagsForm(0)),
        dynamic=True,
    )
    output_lags: tuple[int, ...] | Literal["auto"] = key(
        "lags of the output in samples, 1 or more", SurrogateSettings.output_lags, form=LagsForm(1), dynamic=True
    )
    longest_lag: int = key(
        "longest lag in samples that the automatic choice tries", SurrogateSettings.longest_lag, least=1, dynamic=True
    )
    limits: tuple[float, float] | Literal["auto"] = key(
        "minimum and maximum output, `inf` for none. They also limit the output that is fed back, for a saturation "
        'that is part of the system. `"auto"` recognises where the training output stays at its minimum or maximum',
        SurrogateSettings.limits,
        form=LimitsForm("must be a lower and a higher number", 'Write limits = [0, inf], or "auto".', shows=True),
        dynamic=True,
    )
    structure: Literal["auto", "narx", "filtered"] = key(
        '`"narx"` feeds past outputs back; `"filtered"` is a static function of the inputs and of the inputs through '
        'first-order filters; `"auto"` takes the one with the smaller error on held-out blocks, or `"narx"` if `lags`, '
        "`output_lags` or `hold` are given",
        SurrogateSettings.structure,
        dynamic=True,
    )
    held: tuple[str, ...] = key(
        "inputs that keep their value until the next sample, and are not interpolated where the step of the data "
        "differs from `step`; channels that jump between levels do so by themselves",
        (),
        form=TextsForm(_CHANNELS),
        dynamic=True,
        default_text="none",
    )
    free_run: bool = key("train for free run, not only one step ahead", SurrogateSettings.free_run, dynamic=True)
    moves_centres: bool = key(
        "also refine centres and widths; slow with more than about 50 centres",
        SurrogateSettings.moves_centres,
        dynamic=True,
    )
    hold: float | None = key(
        "strength of the regularisation of the bells during training for free run; by default chosen on held-out "
        "blocks, which takes minutes",
        None,
        least=0,
        dynamic=True,
        default_text="chosen",
    )
    iterations: int = key(
        "maximum iterations of the training for free run", SurrogateSettings.iterations, least=1, dynamic=True
    )
    file: str = key("output file", "", default_text="`NAME.json`")

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield contradictions between the keys."""
        if self.output and self.output in self.inputs:
            yield "output", f"{self.output} is also an input", "Remove it from inputs."
        if self.kind == "dynamic":
            yield from self._dynamic_problems()
            return
        for name, value in (("kernel", "matern52"), ("noise", "student")):
            if self.method == "expansion" and getattr(self, name) == value:
                yield name, f'"{value}" requires a Gaussian process', 'Remove it, or write method = "auto".'
        for name, part in keys_of(SurrogateEntry).items():
            if part.metadata.get("dynamic") and name in present:
                yield name, f"{name} requires a dynamic surrogate", 'Write kind = "dynamic", or remove it.'

    def _dynamic_problems(self) -> Iterator[KeyProblem]:
        if self.method in ("exact", "expansion"):
            yield "method", f'"{self.method}" requires a static surrogate', 'Write "auto" or "sparse".'
        if self.kernel == "matern52":
            yield "kernel", '"matern52" requires a static surrogate', 'Write "auto" or "gaussian".'
        if self.noise == "student":
            yield "noise", '"student" requires a static surrogate', 'Write "auto" or "gaussian".'
        for name in self.held:
            if self.inputs and name not in self.inputs:
                remedy = nearest(name, self.inputs) or f"Inputs are {', '.join(self.inputs)}."
                yield "held", f"unknown input {name}", remedy
        lags = self.lags if isinstance(self.lags, Mapping) else dict.fromkeys(self.inputs)
        for name in lags:
            if self.inputs and name not in self.inputs:
                remedy = nearest(name, self.inputs) or f"Inputs are {', '.join(self.inputs)}."
                yield f"lags {name}", f"unknown input {name}", remedy
        for name in self.inputs:
            if name not in lags:
                remedy = f"Write {name} = [0] for the current sample, or other lags."
                yield f"lags {name}", "the input is missing", remedy

    def target(self, path: Path) -> str:
        """Return the file to write, for the training file at `path`."""
        return self.file or f"{self.model_name(path)}.json"

    def model_name(self, path: Path) -> str:
        """Return the name in formula text, for the training file at `path`."""
        # every folder has a surrogate.toml: its stem would give all surrogates one name
        return self.name or (path.stem if path.stem != "surrogate" else self.output)


@dataclass(frozen=True, eq=False, kw_only=True)
class TrainingFile(SectionsFile):
    """Contents of a training file, its sections in the documented order."""

    surrogate: SurrogateEntry = key("", missing='Write [surrogate] with inputs = ["..."] and output = "...".')
    calculated: Mapping[str, str] = key("", factory=dict)
    units: Mapping[str, str] = key("", factory=dict)
    datasets: tuple[DatasetEntry, ...] = key("", name="dataset", missing='Write [[dataset]] and files = ["..."].')

    @property
    def channels(self) -> Mapping[str, str]:
        """A surrogate reads its inputs under their own names."""
        return {}


@dataclass(frozen=True, eq=False)
class Training:
    """A training file: its data, its settings, and the file to write."""

    data: TrainingFile
    settings: SurrogateSettings
    target: Path

    @property
    def formula(self) -> str:
        """The call of the surrogate, `n = engine(throttle, load)`."""
        return f"{self.settings.output} = {self.settings.name}({', '.join(self.settings.inputs)})"

    def datasets(self, warn: Callable[[Finding], None] = lambda finding: None) -> list[Dataset]:
        """Return the recordings; call `warn` with each warning. Raises `InputError` with all problems of the files."""
        datasets, findings = self._load()
        for finding in findings.finish():
            warn(finding)
        return datasets

    def check(self) -> tuple[list[Dataset], list[Finding]]:
        """Return the recordings and all findings about them, errors and warnings; nothing is trained."""
        datasets, findings = self._load()
        if not findings.has_errors:
            findings.add(*self._unusable(datasets), *repeated_rows(self._training_points(datasets)))
        return datasets, list(dict.fromkeys(findings))

    def _load(self) -> tuple[list[Dataset], Findings]:
        calculated = parse_calculated(self.data)
        needed = dict.fromkeys(self.settings.inputs, "an input of the surrogate")
        needed[self.settings.output] = "the output of the surrogate"
        loaded = load_datasets(self.data, ChannelRequest(needed), calculated)
        twice = listed_twice(loaded.datasets)
        return loaded.datasets, Findings((*calculated.findings, *loaded.findings, *twice))

    def _training_points(self, datasets: list[Dataset]) -> list[Float]:
        """Return the inputs of the points that a static surrogate is trained on, by dataset; none of a dynamic one."""
        if self.settings.kind == "dynamic":
            return []
        return [self._tables(data, 0.0)[0][:, :-1] for data in datasets if data.use == "training"]

    def _unusable(self, datasets: list[Dataset]) -> Iterator[Finding]:
        """Yield reasons why the recordings cannot be used for training, as far as known without training."""
        training = [data for data in datasets if data.use == "training"]
        if not training:
            yield Finding(
                self.data.location("dataset"),
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
            yield Finding(self.data.location("dataset"), message, "Increase max_gap, or use other files.")
            return
        whole = np.concatenate(tables)
        for name, column in zip((*self.settings.inputs, self.settings.output), whole.T, strict=True):
            if np.ptp(column) == 0:
                message = f"channel {name} is constant ({column[0]:g}) in the training data"
                yield Finding(self.data.location("surrogate"), message, "Remove it.")

    def _tables(self, dataset: Dataset, step: float) -> list[Float]:
        """Return the training samples of a dataset, Float[samples, inputs and output] per piece."""
        arguments = dataset, self.settings.inputs, self.settings.output
        if self.settings.kind == "dynamic":
            return [np.column_stack([run.u, run.y]) for run in split_recordings(*arguments, step, self.settings.held)]
        return [np.column_stack(extract_points(*arguments)[:2])]

    def train(
        self,
        report: Callable[[str], None] = lambda line: None,
        stopped: Stopped = never,
        warn: Callable[[Finding], None] = lambda finding: None,
    ) -> Surrogate:
        """Train the surrogate, reporting lines on progress; end at the best so far once `stopped` returns true.

        `warn` is called with each warning about the recordings, and about samples that were not used.

        Raises:
            InputError: the data are insufficient.
        """
        surrogate = train_surrogate(self.datasets(warn), self.settings, report, stopped)
        for remark in getattr(surrogate, "remarks", ()):
            warn(Finding(Location(self.data.path.name), remark, severity="warning"))
        return surrogate


def read_training(path: str | Path) -> Training:
    """Read a training file. Raises `InputError` with every problem of the file itself."""
    path = Path(path)
    root = open_sections(path)
    if "surrogate" not in root.values and "model" in root.values:
        raise InputError.of(root.location, "this is a project, not a training file", "Run `kennfeld calibrate`.")
    file: TrainingFile = read_entry(TrainingFile, root, path=path, lines=root.location.lines)
    _check_datasets(root, file)
    file = replace(file, datasets=used_entries(file.datasets or ()))
    target = path.parent / file.surrogate.target(path)
    # without its section the name of the target is a guess
    if "surrogate" in root.values:
        for message, remedy in _target_problems(target, file.surrogate.target(path), path):
            root.findings.error(file.location("surrogate", "file"), message, remedy)
    settings = None
    if not root.findings.has_errors:
        settings = _settings(root, file)
    root.findings.finish()
    assert settings is not None, "finish raises if there are no settings"
    return Training(file, settings, target)


def _settings(root: Section, file: TrainingFile) -> SurrogateSettings | None:
    entry = file.surrogate
    shared = [part.name for part in fields(SurrogateSettings) if part.name != "name"]
    try:
        return SurrogateSettings(entry.model_name(file.path), **{name: getattr(entry, name) for name in shared})
    except ArgumentError as error:
        root.findings.error(file.location("surrogate"), str(error))
        return None


def _target_problems(file: Path, target: str, path: Path) -> Iterator[tuple[str, str]]:
    """Yield message and remedy of a target that cannot be written, before the training."""
    try:
        within(path.parent, target)
    except OSError as error:
        yield f"{target} cannot be written: {error.strerror}", "Name a file in the folder of this file."
        return
    if not file.parent.is_dir():
        yield f"folder {Path(target).parent} does not exist", "Create it, or name another one."
    elif file.is_dir():
        yield f"{target} is a folder", 'Write file = "....json".'
    elif file.resolve() == path.resolve():
        yield f"{target} is this training file", 'Write file = "....json".'


def _check_datasets(root: Section, file: TrainingFile) -> None:
    """Report keys of `[[dataset]]` that apply to calibration only."""
    tables = root.values.get("dataset", ()) if file.datasets else ()
    for table, entry in zip(tables, file.datasets, strict=True):
        for name in _UNSUPPORTED:
            if name in table:
                message = f"{name} is not supported in a training file"
                root.findings.error(entry.location.within(name), message, "Remove it.")
        if entry.unknown_shifts:
            message = '"auto" is not supported in a training file'
            root.findings.error(entry.location.within("shift"), message, "Write the shift as a number.")

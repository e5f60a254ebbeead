"""The project file: its sections and their keys, in the documented order.

Reading, writing, the JSON schema and the tables of the documentation all come from these classes.
"""

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Findings, Fix, InputError, Location
from kennfeld.base.file_errors import files_alike
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.watch_folder import DEFAULT_LIMIT
from kennfeld.domain.criteria import ROBUST_LOSSES, RobustLoss
from kennfeld.domain.file_keys import KeyProblem, key
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.search_settings import SearchSettings
from kennfeld.domain.storage import MAX_SHIFT, RoundingMethod
from kennfeld.models.function_files import split_reference
from kennfeld.models.importer import ImportOptions, ImportRequest
from kennfeld.models.importer_registry import importer_of, importers
from kennfeld.preprocessing.recipe import DatasetEntry, used_entries
from kennfeld.project.design_table import DesignEntry
from kennfeld.project.forms import (
    EitherForm,
    EntriesForm,
    IntegerForm,
    NamedEntriesForm,
    TableOfForm,
    TextForm,
    form_of,
    keys_of,
    read_entry,
)
from kennfeld.project.section import KeyLocation, Section
from kennfeld.project.table_schema import FACTOR, FACTORS, Factor, GroupAxisEntry, ParameterEntry
from kennfeld.project.toml_file import is_training, parse_toml, read_text
from kennfeld.project.toml_keys import TomlKeys
from kennfeld.project.value_forms import (
    DIRECTIONS,
    CoordinatesForm,
    ImageEntry,
    InitialForm,
    Lock,
    LockForm,
    OutputForm,
    ResultsForm,
    StepCriteriaForm,
    TargetEntry,
    TargetForm,
)

DEFAULT_PARTITION = 1_000_000  # samples, on a cluster
_INNER = "calculated"
_REDUCTION = IntegerForm(least=1)
_REDUCTIONS = EitherForm(_REDUCTION, TableOfForm(_REDUCTION, names=DIRECTIONS))
_TERMS_EXAMPLE = 'Write terms = [{ parameter = "...", at = [...], factor = 1 }, ...].'
_ROBUST = " or ".join(f'`"{loss}"`' for loss in ROBUST_LOSSES)
_REGION_EXAMPLE = 'Write regions = [{ where = "Speed > 3000", weight = 2.0 }].'


@dataclass(frozen=True)
class ModelEntry:
    """`[model]`; the keys after `timeout` are for Simulink models, ASCET projects and FMUs."""

    file: str = key(
        "the function: a `.kf` file, a [Simulink model](formats.md#simulink), `.slx` or `.mdl`, a class or an "
        "application of an [ASCET project](ascet.md), `.esdl` or `.app`, `.axl` or `.amd`, or a "
        "[function from another tool](functions.md): `plant.fmu`, `knock.onnx`, `engine.c:torque`, `engine.py:torque`",
        holds="function file",
        missing='Write file = "....kf", the formula text.',
    )
    step: float | None = key(
        "for models with memory: the step of the model. If it is finer than the step of the data, inputs are "
        "interpolated, except for switches and others that jump between levels, which are held",
        None,
        above=0,
        unit="s",
        default_text="the step of the data",
    )
    timeout: float = key(
        "for functions of files whose code runs, such as [FMUs](functions.md#crashes-and-endless-loops): the time that "
        "one call may take. A command that waits for longer ends with a message",
        DEFAULT_LIMIT,
        above=0,
        unit="s",
    )
    subsystem: str = key('the part of a Simulink model that is the function: `"Engine/Torque"`', "")
    parameters: tuple[str, ...] = key(
        "a file, or a list of files, with values of a Simulink model's variables: scripts (`.m`), `.mat`, `.sldd`, "
        "calibration files; later files take precedence",
        (),
        holds="calibration file",
    )
    bind: Mapping[str, str] = key(
        '`{ "Engine/Sensor" = "T_meas + 273.15" }` replaces the output of a block of a Simulink model by a channel or '
        "a [formula](formula.md) over channels",
        factory=dict,
        holds="formula",
        by="block",
    )
    folders: tuple[str, ...] = key(
        "a folder or a list of folders in which libraries, referenced models, data dictionaries, classes and functions "
        "of a Simulink model, or packages of an ASCET project, are searched, in addition to its own folder",
        (),
        holds="folder",
    )
    class_name: str = key(
        "the class of an ESDL file, or the class or module of an `.axl` archive, that is the function, if the file has "
        "several",
        "",
        name="class",
    )
    methods: tuple[str, ...] = key(
        "the methods of the class that a step calls, in their order",
        (),
        default_text="those of its task, or its public methods less those that start or reset it",
    )
    startup: tuple[str, ...] = key(
        "the methods of the class that run once before the first step", (), default_text="those of the application"
    )
    task: tuple[str, ...] = key(
        'the task of an ASCET application that is the function, if it has several; or a list of tasks, or `"*"` for '
        "all that are periodic, each of which runs at its own period",
        (),
    )
    outputs: tuple[str, ...] = key(
        "variables of an [FMU](functions.md#fmu) that become nodes in addition to its outputs, or patterns of their "
        'names: `["body.v", "der(*)"]`',
        (),
        default_text="the states, if it has no outputs",
    )
    limit_assignments: bool | None = key(
        "`true`: real numbers of an ASCET model are limited to the [ranges of their types](ascet.md#ranges-of-reals) "
        "when they are assigned; `false`: they are not",
        None,
        default_text="as generated code does",
    )
    target: Literal["lp64", "ilp32"] = key(
        "the data model of the processor for functions in C, also of those of `[functions]`: `ilp32`, where `long`, "
        "`size_t` and addresses have 32 bits, or `lp64`, where they have 64",
        "lp64",
    )
    float32: bool = key(
        "round each result of type `float` of functions in C, and signals of type `single` of a "
        "[Simulink model](simulink.md#data-types), to single precision, as the processor does; for C also in "
        "`[functions]`",
        False,
    )

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield keys that the importer of the function does not take."""
        # formula text may call functions in C, which take these two
        own = ("step", *(("target", "float32") if self.file.endswith(".kf") else ()))
        plain = ModelEntry(self.file)
        names = [part.name for part in fields(ImportOptions) if part.name not in own]
        used = [name for name in names if getattr(self, name) != getattr(plain, name)]
        if not self.file or not used:
            return
        importer = importer_of(split_reference(self.file)[0])
        taken = () if importer is None else importer.keys
        # one finding for all keys of the same importers
        keys: dict[tuple[str, ...], list[str]] = {}
        for name in used:
            if name not in taken:
                takers = tuple(each.label for each in importers() if name in each.keys)
                keys.setdefault(takers, []).append("class" if name == "class_name" else name)
        for takers, names in keys.items():
            verb = "requires" if len(names) == 1 else "require"
            wanted = join_names(takers, len(takers), " or ") or "an importer that is not installed"
            yield "file", f"{join_names(names, len(names), ' and ')} {verb} {wanted}, got {self.file}", ""


@dataclass(frozen=True)
class CalibrationEntry:
    """`[calibration]`."""

    initial: tuple[str | ImageEntry, ...] = key(
        "a calibration file, or a list of them; later files take precedence, but for what their format cannot state, "
        "such as limits or extrapolation. Two files that define a table "
        "differently are an error, unless the project states or fits the axes in which they differ. "
        'An image is `{ a2l = "ecu.a2l", hex = "ecu.hex" }`, also within a list; `hex` may '
        "be Intel HEX or S-records, and `a2l` may be omitted if the A2L file has the name of the image or is the only "
        "one next to it",
        (),
        form=InitialForm(),
        holds="calibration file",
    )
    variant: str = key(
        'which values to use of labels that have several variants: `"Engine=2"`. Results are written to this variant; '
        "the others are kept",
        "",
        holds="variant",
        default_text="the first",
    )
    output: tuple[str, ...] = key(
        'formats to write: `"dcm"`, `"csv"` (INCA\'s CVX), `"cdfx"`, `"xlsx"`, `"m"` and `"mat"` (MATLAB), `"json"`, '
        '`"msq"` if `initial` is a tune, `"par"` if it is a parameter file of CANape, `"esdl"` or `"axl"` if the '
        'function is such a file, or `"hex"` and `"s19"` if `initial` has such an image: a copy of it with the fitted '
        "values. `parameters.json` is always written. A parameter whose name a format cannot represent, such as a "
        "block path with spaces in DCM, is omitted from that file, and `kennfeld check` reports it beforehand",
        (),
        form=OutputForm(),
    )
    results: tuple[str, ...] = key(
        'further results: `"mf4"`, `"mat"` and `"csv"` write the [simulation for other '
        'tools](results.md#simulation-for-other-tools), and `"lab"` writes `changed.lab`, a list of the parameters '
        'that have changed. `"changed"` writes these with their values, and no others, in the formats of `output`: '
        "`changed.dcm`",
        (),
        form=ResultsForm(),
    )
    free: tuple[str, ...] = key(
        'which parameters to fit, by pattern; `"@airpath.lab"` is a [label list](formats.md#label-lists) of INCA or '
        "CANape",
        ("*",),
        holds="parameter",
    )
    rounding: RoundingMethod | None = key(
        '[rounds the result](how-to/rounding.md) to what a control unit can store: `"joint"` all values together, so '
        'that they make up for each other; `"nearest"` each on its own. Bounds, locks, pins and shapes hold',
        None,
        default_text="not rounded",
    )
    storage: str = key(
        "an A2L file: the steps, offsets and limits of labels and breakpoints, by their conversions and data types",
        "",
        holds="file",
        default_text="that of the image in `initial`",
    )
    max_shift: float = key("the largest distance of a rounded value from the fit, in steps", MAX_SHIFT, least=1)

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield settings of the rounding without it."""
        for name in ("storage", "max_shift"):
            if name in present and "rounding" not in present:
                yield name, f"{name} requires rounding", 'Write rounding = "joint".'

    @property
    def files(self) -> tuple[str, ...]:
        """The initial files, without those that describe images."""
        return tuple(item if isinstance(item, str) else item.hex for item in self.initial)

    @property
    def descriptions(self) -> Mapping[str, str]:
        """The A2L file of each image that names one."""
        return {item.hex: item.a2l for item in self.initial if isinstance(item, ImageEntry) and item.a2l}


@dataclass(frozen=True)
class RegionEntry:
    """One entry of `regions`."""

    where: str = key("a condition over channels", holds="condition", missing=_REGION_EXAMPLE)
    weight: float = key("weight of the samples that satisfy it", least=0, missing=_REGION_EXAMPLE)


@dataclass(frozen=True)
class CriterionEntry:
    """One `[[criterion]]`."""

    location: Location
    node: str = key("the node to fit to the target", holds="node", missing='Write node = "...".')
    target: TargetEntry = key(
        '`{ channel = "Torque" }`, `{ node = "Other" }`, or a number; a bare name is a channel or, if there is none, a '
        "node. A dataset without the channel is not scored; this causes a warning unless the dataset has the channel "
        "of another criterion",
        form=TargetForm(),
        missing='Write target = { channel = "..." }.',
    )
    weight: float = key("factor on the squared errors; 0 switches off", 1.0, least=0)
    scale: float = key("errors are divided by it, in the channel's unit", 1.0, above=0)
    loss: Literal["square", RobustLoss] = key(f"{_ROBUST} reduce the influence of outliers", "square")
    delta: float = key("error at which this reduction begins, in units of `scale`", 1.0, above=0)
    weight_channel: str = key(
        "a channel with the weight of each sample, >= 0; missing values count as 0", "", holds="channel"
    )
    regions: tuple[RegionEntry, ...] = key(
        '`[{ where = "Speed > 3000", weight = 2.0 }]`: a weight for the samples that satisfy a condition over channels',
        (),
        word="region",
        remedy=_REGION_EXAMPLE,
    )

    def problems(self, present: Mapping[str, Any]) -> Iterator[KeyProblem]:
        """Yield a delta without effect; an invalid loss may have been meant as one that has a delta."""
        if self.loss == "square" == present.get("loss", "square") and "delta" in present:
            remedy = f"Write loss = {_ROBUST.replace('`', '')}."
            yield "delta", f"delta requires the loss {' or '.join(ROBUST_LOSSES)}", remedy


@dataclass(frozen=True)
class LimitEntry:
    """One `[[limit]]`."""

    location: Location
    node: str = key(
        'a node, or an expression over nodes, inputs and channels: `"abs(n_set - n)"`. It may call the tables of the '
        'project: `"MapDrag(Speed, 100) - MapDrag(Speed, 20)"`',
        holds="node",
        missing='Write node = "...", a node or an expression.',
    )
    lower: float = key("the lower bound", -math.inf, name="min", default_text="none")
    upper: float = key("the upper bound; one of the two, or both", math.inf, name="max", default_text="none")
    where: str = key(
        "a condition over inputs and channels; the limit applies to the samples that satisfy it", "", holds="condition"
    )

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield missing and reversed bounds."""
        if not {"min", "max"} & set(present):
            yield "max", "min and max are missing", "Write max = ... or min = ..."
        if self.lower > self.upper:
            yield "min", f"min = {self.lower:g} exceeds max = {self.upper:g}", "Swap them."


@dataclass(frozen=True)
class TermEntry:
    """One term of an `[[equality]]`."""

    parameter: str = key("the parameter", holds="parameter", missing='Write parameter = "...".')
    at: tuple[float, ...] | None = key(
        "the coordinates, one per axis", None, form=CoordinatesForm(), default_text="the sum of all values"
    )
    factor: float = key("factor of the value", 1.0)


@dataclass(frozen=True)
class EqualityEntry:
    """One `[[equality]]`."""

    location: Location
    terms: tuple[TermEntry, ...] = key(
        '`[{ parameter = "A", at = [0] }, { parameter = "B", at = [0], factor = -1 }]`; without `at`, a term is the '
        "sum of all values of its parameter",
        word="term",
        fault="must be a list of terms",
        remedy=_TERMS_EXAMPLE,
        shows=True,
        fills=True,
        missing=_TERMS_EXAMPLE,
    )
    value: float = key("the sum of the terms", 0.0)


@dataclass(frozen=True)
class StepEntry:
    """One `[[step]]`; None where a key is missing. Names of parameters may be patterns."""

    location: Location
    name: str = key("name of the step in the trace", "", default_text="`step 1`, ...")
    free: tuple[str, ...] | None = key(
        "patterns of the parameters that this step fits, or label lists as in `[calibration]`; the others are fixed",
        None,
        holds="parameter",
        default_text="by `[calibration]`",
    )
    lock: Mapping[str, Lock] | None = key(
        '`{ MapA = true, MapB = "no-data", MapC = [{ x = [700, 1000] }] }` replaces the locks of these parameters; '
        "`false` unlocks",
        None,
        form=TableOfForm(LockForm()),
        by="parameter",
        default_text="by parameter",
    )
    smoothness: Factor | Mapping[str, Factor | Mapping[str, Factor]] | None = key(
        'a factor for all tables, or `{ MapA = 1, MapB = { x = 1, y = 0.3 } }` for these. `"auto"` instead of a number '
        "chooses it in this step, on its grid",
        None,
        form=EitherForm(FACTOR, TableOfForm(FACTORS)),
        by="parameter",
        default_text="by parameter",
    )
    grid_reduction: int | Mapping[str, int | Mapping[str, int]] | None = key(
        "keep every nth breakpoint of the tables that are fitted: `2`, or `{ MapA = 2, MapB = { x = 2, y = 3 } }`",
        None,
        form=EitherForm(_REDUCTION, TableOfForm(_REDUCTIONS)),
        by="parameter",
        default_text="1",
    )
    criteria: tuple[str | int, ...] | Mapping[str | int, float] | None = key(
        'the criteria to use: nodes, or numbers from 1 in the order of the file, `["TorquePredict", 2]`; or with '
        "weights, `{ TorquePredict = 1, other = 0.1 }`. All others are off",
        None,
        form=StepCriteriaForm(),
        holds="node",
        by="node",
        default_text="all",
    )
    max_iterations: int | None = key(
        "maximum number of iterations of one descent", None, least=1, default_text="by `[optimizer]`"
    )
    tolerance: float | None = key(
        "relative change of the cost at which a descent ends", None, above=0, default_text="by `[optimizer]`"
    )
    continuation: Literal["auto", "off"] | None = key("as in `[optimizer]`", None, default_text="by `[optimizer]`")


@dataclass(frozen=True)
class OptimizerEntry(SearchSettings):
    """`[optimizer]`."""

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield a budget of another method."""
        if self.method != "global" and "max_evaluations" in present:
            message = f"max_evaluations requires the method global, got {self.method}"
            yield "max_evaluations", message, 'Write method = "global", or max_iterations.'


@dataclass(frozen=True)
class ClusterEntry:
    """`[cluster]`."""

    scheduler: str = key(
        'address of a Dask scheduler, `"tcp://host:8786"`, or the file that it wrote with `--scheduler-file`', ""
    )
    workers: int | None = key(
        "without a scheduler: number of processes on this machine that evaluate partitions",
        None,
        least=1,
        default_text="1",
    )
    partition: int | None = key(
        "evaluates the data in [partitions](cluster.md#partitions) of about this many samples; 0 reads all data into "
        "this process",
        None,
        least=0,
        default_text="1000000 with a scheduler, else 0",
    )
    folder: str = key(
        "where prepared partitions are kept, on a disk that the workers share or on one of each; safe to delete",
        ".kennfeld/partitions",
        holds="folder",
    )
    folder_size: float = key(
        "size limit of this folder; the least recently used are removed", 200.0, above=0, unit="GB"
    )
    tls_authority: str = key("for a scheduler at `tls://`: file of the certificate authority", "", holds="file")
    tls_certificate: str = key("file of the own certificate", "", holds="file")
    tls_key: str = key("file of its key", "", holds="file")

    @property
    def partition_size(self) -> int:
        """Samples of a partition; 0 if data are not evaluated in partitions."""
        if self.partition is None:
            return DEFAULT_PARTITION if self.scheduler else 0
        return self.partition

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield keys that contradict each other."""
        if self.scheduler and "workers" in present:
            yield "workers", "workers contradicts scheduler, whose workers are used", "Remove one."
        for name in ("tls_authority", "tls_certificate", "tls_key"):
            if name in present and not self.scheduler:
                yield name, f"{name} requires a scheduler", 'Write scheduler = "tls://...", or remove it.'


@dataclass(frozen=True)
class ReportEntry:
    """`[report]`."""

    title: str = key("heading of the report", "", default_text="the name of the project")
    author: str = key("who made the calibration", "")
    comment: str = key("text below the heading; an empty line begins a new paragraph", "", holds="paragraphs")


class ChannelsForm(TableOfForm):
    """Channels of inputs. A table `calculated` among them is an alternative spelling of `[calculated]`."""

    def read(self, section: Section, key: str) -> dict[str, str] | None:
        table = section.values[key]
        if isinstance(table, dict) and isinstance(table.get(_INNER), dict):
            rest = {name: value for name, value in table.items() if name != _INNER}
            section = section.with_values({key: rest})
        return super().read(section, key)

    def json_schema(self) -> dict[str, Any]:
        schema = super().json_schema()
        return schema | {"properties": {_INNER: {"anyOf": [{"type": "string"}, schema]}}}


@dataclass(frozen=True, eq=False, kw_only=True)
class SectionsFile:
    """A file of sections; `lines` are those of its keys, by path."""

    path: Path
    lines: dict[str, int] = field(repr=False)

    @property
    def folder(self) -> Path:
        """The folder that paths in the file are relative to."""
        return self.path.parent

    def location(self, *keys: str | int) -> Location:
        """Return the location of a section or key.

        The path `"dataset", 2, "files"` is shown as `kennfeld.toml line 9 [[dataset]] 2 files`.
        """
        section, *inner = keys
        form = form_of(keys_of(type(self))[str(section)])
        heading = f"[[{section}]]" if isinstance(form, EntriesForm) else f"[{section}]"
        # the heading of an entry has its name: [parameters.MapTorque]
        if isinstance(form, NamedEntriesForm) and inner:
            heading = f"[{section}.{inner.pop(0)}]"
        location = KeyLocation(self.path.name, keys=keys, lines=self.lines)
        for part in (heading, *inner):
            location = location.within(str(part))
        return location

    def alike(self, name: str) -> list[str]:
        """Return the files beside a missing one that have its ending, as the file names them."""
        return [(Path(name).parent / other).as_posix() for other in files_alike(self.folder / name)]


@dataclass(frozen=True, eq=False, kw_only=True)
class ProjectFile(SectionsFile):
    """Contents of a project file, its sections in the documented order."""

    unsaved: Mapping[str, str] = field(default_factory=dict, repr=False)  # texts that replace those of files, by name
    model: ModelEntry = key("the function, and how its time is stepped", missing='Write [model] and file = "....kf".')
    channels: Mapping[str, str] = key(
        "the channel of each input that has another name in the recordings",
        factory=dict,
        form=ChannelsForm(TextForm()),
        holds="channel",
        by="input",
    )
    calculated: Mapping[str, str] = key(
        "channels that are calculated by a [formula](formula.md) over other channels",
        factory=dict,
        holds="formula",
        by="calculated channel",
    )
    units: Mapping[str, str] = key(
        "the unit of each channel whose recording has none, or a wrong one; channels are converted to the units of the "
        "function",
        factory=dict,
        holds="unit",
        by="channel",
    )
    datasets: tuple[DatasetEntry, ...] = key(
        "recordings that are prepared alike", name="dataset", missing='Write [[dataset]] and files = ["..."].'
    )
    calibration: CalibrationEntry = key("calibration files to start from and to write", CalibrationEntry())
    surrogates: Mapping[str, str] = key(
        "the file of each data-driven model of the formula text", factory=dict, holds="surrogate file", by="surrogate"
    )
    functions: Mapping[str, str] = key(
        "the [file of each function](functions.md) that the formula text calls and that is not formula text itself",
        factory=dict,
        holds="file of functions",
        by="function",
    )
    axes: Mapping[str, GroupAxisEntry] = key(
        "group axes, which several tables share", factory=dict, form=NamedEntriesForm(GroupAxisEntry)
    )
    parameters: Mapping[str, ParameterEntry] = key(
        "tables, curves and numbers that are fitted", factory=dict, form=NamedEntriesForm(ParameterEntry)
    )
    criteria: tuple[CriterionEntry, ...] = key(
        "what the fit minimises", name="criterion", missing='Write [[criterion]], node = "..." and target = "...".'
    )
    limits: tuple[LimitEntry, ...] = key("bounds on nodes at every training sample", (), name="limit")
    equalities: tuple[EqualityEntry, ...] = key("sums of values that are given exactly", (), name="equality")
    steps: tuple[StepEntry, ...] = key("searches in sequence, each from the result of the one before", (), name="step")
    optimizer: OptimizerEntry = key("the search", OptimizerEntry())
    cluster: ClusterEntry = key("[large data and several machines](cluster.md)", ClusterEntry())
    report: ReportEntry = key("the head of the report", ReportEntry())
    design: DesignEntry = key("[what to measure next](how-to/measure-next.md)", factory=DesignEntry)

    @property
    def name(self) -> str:
        """The name of the file, or of its folder if it is called `kennfeld.toml`."""
        return self.path.resolve().parent.name if self.path.stem == "kennfeld" else self.path.stem

    def import_request(self, initial: ParameterSet | None = None) -> ImportRequest:
        """Return what to import as the function, if it is in a file of another tool.

        Args:
            initial: values from calibration files.
        """
        entry = self.model
        file, choice = split_reference(entry.file)
        options = ImportOptions(
            entry.step,
            tuple(self.folder / name for name in entry.folders),
            entry.subsystem,
            tuple(self.folder / name for name in entry.parameters),
            tuple(entry.bind.items()),
            entry.class_name,
            entry.methods,
            entry.startup,
            entry.task,
            entry.outputs,
            entry.limit_assignments,
            "" if entry.target == "lp64" else entry.target,
            entry.float32,
        )
        values = {name: None if section.axes else section.initial for name, section in self.parameters.items()}
        # a name with a colon is a field of a block, `Path:Field`, which is a parameter because the project names it
        fixed = ((name, _as_tuples(value)) for name, value in values.items() if value is not None or ":" in name)
        return ImportRequest(self.folder / file, options, choice, tuple(fixed), initial)


def _as_tuples(value: Float | None) -> Any:
    """Return an array as nested tuples, which requests can be compared by."""

    def nested(item: Any) -> Any:
        return tuple(map(nested, item)) if isinstance(item, list) else item

    return None if value is None else nested(np.asarray(value).tolist())


def open_sections(path: Path, text: str | None = None) -> Section:
    """Return the tables of a file, or of another text for it. Raises `InputError` if it is not valid TOML."""
    text = read_text(path) if text is None else text
    tables = parse_toml(path.name, text)
    return Section(tables, KeyLocation(path.name, lines={}), Findings(), line_of=TomlKeys(text).line)


def read_project(path: Path, unsaved: Mapping[str, str] | None = None) -> ProjectFile:
    """Read a project file.

    Args:
        path: the file.
        unsaved: texts that replace those of the project file and of formula files, by name.

    Raises:
        InputError: every problem of the file itself.
    """
    unsaved = unsaved or {}
    root = open_sections(path, unsaved.get(path.name))
    path = path.absolute()  # the present folder may be another one when the files of the project are read
    if is_training(root.values):
        message = "this is a training file, not a project"
        raise InputError.of(root.location, message, "Run `kennfeld surrogate train`.")
    file: ProjectFile = read_entry(ProjectFile, root, path=path, lines=root.location.lines, unsaved=unsaved)
    used = used_entries(file.datasets or ())
    if file.datasets and not used:
        root.report("dataset", "all datasets are off", 'Write use = "training" in one of them.')
    # before `finish`, which raises its findings together with the others
    more = _calculated_channels(root, file.calculated)
    root.findings.finish()
    return replace(file, calculated={**more, **file.calculated}, datasets=used)


def read_partly(path: Path, tables: Mapping[str, Any]) -> ProjectFile:
    """Return what the tables of a project file say as far as they are valid; the rest is as if it were not there."""
    section = Section(dict(tables), KeyLocation(path.name, lines={}), Findings())
    file: ProjectFile = read_entry(ProjectFile, section, path=path, lines={}, unsaved={})
    return replace(file, datasets=used_entries(file.datasets or ()))


def _calculated_channels(root: Section, calculated: Collection[str]) -> dict[str, str]:
    """Return the formulas of `[channels.calculated]` and report names that `[calculated]` has, too."""
    channels = root.values.get("channels")
    if not isinstance(channels, dict) or not isinstance(channels.get(_INNER), dict):
        return {}
    section = root.inner(channels, "[channels]", "channels")
    for name in channels[_INNER]:
        if name in calculated:
            location = f"{_INNER} {name}"
            fix = Fix.remove(("channels", _INNER, name))
            section.report(location, "duplicate of the channel in [calculated]", "Remove one.", [fix])
    return TableOfForm(TextForm()).read(section, _INNER) or {}

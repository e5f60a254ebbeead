"""The keys of a run: what it starts from, how it searches and where, and what it writes."""

from collections.abc import Collection, Iterator, Mapping
from typing import Literal

from kennfeld.base.errors import Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.file_keys import KeyProblem, key
from kennfeld.domain.search_settings import SearchSettings
from kennfeld.domain.storage import MAX_SHIFT, RoundingMethod
from kennfeld.project.forms import EitherForm, IntegerForm, TableOfForm
from kennfeld.project.table_schema import FACTOR, FACTORS, Factor
from kennfeld.project.value_forms import (
    DIRECTIONS,
    ImageEntry,
    InitialForm,
    Lock,
    LockForm,
    OutputForm,
    ResultsForm,
    StepCriteriaForm,
)

DEFAULT_PARTITION = 1_000_000  # samples, on a cluster
_REDUCTION = IntegerForm(least=1)
_REDUCTIONS = EitherForm(_REDUCTION, TableOfForm(_REDUCTION, names=DIRECTIONS))


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

"""Values of a project file; `sections.py` reads them from its text."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from kennfeld.arrays import Float
from kennfeld.errors import Finding
from kennfeld.parameters import Extrapolation
from kennfeld.preprocessing.recipe import DatasetEntry

DIRECTIONS = ("x", "y", "z", "w")
SIMULINK = (".slx", ".mdl")
PROTECTED = ".slxp"
MAX_STARTS = 10_000  # equals that of `optimize.Options`, which takes long to load
Factor = float | Literal["auto"]
Range = Mapping[str, tuple[float, float]]  # by direction, both ends included
Lock = bool | Literal["no-data"] | tuple[Range, ...]


@dataclass(frozen=True)
class ModelEntry:
    """`[model]`; the fields after `step` are for Simulink models."""

    file: str
    step: float | None = None
    subsystem: str = ""
    parameters: tuple[str, ...] = ()  # files with values of its variables
    bind: Mapping[str, str] = field(default_factory=dict)  # block: channel or formula
    folders: tuple[str, ...] = ()  # of libraries and referenced models, in addition to its own


@dataclass(frozen=True)
class Freedom:
    """Constraints on breakpoints that are fitted, see `Axis`."""

    min_distance: float | None = None
    range: tuple[float, float] | None = None


@dataclass(frozen=True)
class AxisEntry:
    """Source of the breakpoints of an axis, at most one of `breakpoints`, `group` and `quantiles`.

    `breakpoints` are given or evenly spaced; `group` names a group axis; `quantiles` is a number of quantiles of the
    training data. Without any, they come from the initial files. With `freedom` they are fitted.
    """

    place: str
    input: str = ""
    breakpoints: tuple[float, ...] = ()
    group: str = ""
    quantiles: int = 0
    freedom: Freedom | None = None

    @property
    def inherits(self) -> bool:
        """If the breakpoints are those of the initial files."""
        return not (self.breakpoints or self.group or self.quantiles) and self.freedom is not None


@dataclass(frozen=True)
class PinEntry:
    """One entry of `pin`."""

    at: tuple[float, ...]
    value: float


@dataclass(frozen=True, eq=False)
class ParameterEntry:
    """One `[parameters.NAME]`; None where a key is missing."""

    place: str
    name: str
    axes: Mapping[str, AxisEntry]
    unit: str | None = None
    description: str | None = None
    initial: Float | None = None
    free: bool | None = None
    bounds: tuple[Float, Float] | None = None
    smoothness: Factor | Mapping[str, Factor] | None = None
    lock: Lock = False
    pins: tuple[PinEntry, ...] = ()
    gradient: Range = field(default_factory=dict)
    curvature: Range = field(default_factory=dict)
    extrapolation: Extrapolation | None = None


@dataclass(frozen=True)
class TargetEntry:
    """Target of a criterion; a bare name is a channel, else a node."""

    kind: Literal["name", "channel", "node", "number"]
    name: str = ""
    value: float = 0.0


@dataclass(frozen=True)
class RegionEntry:
    """One entry of `regions`."""

    where: str
    weight: float


@dataclass(frozen=True)
class CriterionEntry:
    """One `[[criterion]]`."""

    place: str
    node: str
    target: TargetEntry
    weight: float = 1.0
    loss: Literal["square", "huber", "soft_l1"] = "square"
    delta: float = 1.0
    scale: float = 1.0
    weight_channel: str = ""
    regions: tuple[RegionEntry, ...] = ()


@dataclass(frozen=True)
class LimitEntry:
    """One `[[limit]]`."""

    place: str
    node: str
    lower: float
    upper: float
    where: str = ""


@dataclass(frozen=True)
class TermEntry:
    """One term of an `[[equality]]`; without coordinates, the sum of all values."""

    parameter: str
    at: tuple[float, ...] | None
    factor: float


@dataclass(frozen=True)
class EqualityEntry:
    """One `[[equality]]`."""

    place: str
    terms: tuple[TermEntry, ...]
    value: float


@dataclass(frozen=True)
class CalibrationEntry:
    """`[calibration]`; `output` are file extensions."""

    initial: tuple[str, ...] = ()
    descriptions: Mapping[str, str] = field(default_factory=dict)  # the A2L file of each image
    variant: str = ""
    output: tuple[str, ...] = ()
    free: tuple[str, ...] = ("*",)


@dataclass(frozen=True)
class OptimizerEntry:
    """`[optimizer]`."""

    max_iterations: int = 200
    tolerance: float = 1e-8
    continuation: Literal["auto", "off"] = "auto"
    method: Literal["gauss-newton", "global"] = "gauss-newton"
    max_evaluations: int = 0
    starts: int = 1
    seed: int = 0
    spread: float = 0.5
    save_every: int = 0


@dataclass(frozen=True)
class StepEntry:
    """One `[[step]]`; None where a key is missing. Names of parameters may be patterns."""

    place: str
    name: str = ""
    free: tuple[str, ...] | None = None
    lock: Mapping[str, Lock] | None = None
    smoothness: Factor | Mapping[str, Factor | Mapping[str, Factor]] | None = None
    grid_reduction: float | Mapping[str, float | Mapping[str, float]] | None = None
    criteria: tuple[str | int, ...] | Mapping[str | int, float] | None = None
    max_iterations: int | None = None
    tolerance: float | None = None
    continuation: Literal["auto", "off"] | None = None


@dataclass(frozen=True, eq=False)
class ProjectFile:
    """Contents of a project file; `findings` are the warnings about it."""

    path: Path
    name: str
    model: ModelEntry
    channels: Mapping[str, str]
    calculated: Mapping[str, str]
    datasets: tuple[DatasetEntry, ...]
    calibration: CalibrationEntry
    axes: Mapping[str, AxisEntry]
    parameters: Mapping[str, ParameterEntry]
    criteria: tuple[CriterionEntry, ...]
    optimizer: OptimizerEntry
    limits: tuple[LimitEntry, ...] = ()
    equalities: tuple[EqualityEntry, ...] = ()
    steps: tuple[StepEntry, ...] = ()
    surrogates: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    @property
    def folder(self) -> Path:
        """The folder that paths in the file are relative to."""
        return self.path.parent

    def place(self, part: str) -> str:
        """Return the location of a part, as in `kennfeld.toml [model] file`."""
        return f"{self.path.name} {part}"

    def siblings(self, path: Path) -> list[str]:
        """Return the names of the files in the folder of a path."""
        return [other.name for other in path.parent.iterdir() if other.is_file()] if path.parent.is_dir() else []

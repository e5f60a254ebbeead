"""Report of an ESDL import: what is calculated and calibrated, and what is not supported."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from kennfeld.base.errors import Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.models.model import Model
from kennfeld.models.quantities import CalibratableParameter, Quantity


@dataclass(frozen=True)
class StateSummary:
    """A variable that keeps its value from step to step, and its first value, None if it is calculated."""

    name: str
    initial: float | None


@dataclass(frozen=True)
class TaskSummary:
    """A task that runs at a period of its own: its period and first run in s, and its methods in their order."""

    name: str
    period: float
    delay: float
    methods: tuple[str, ...]


@dataclass(frozen=True)
class EsdlReport:
    """Result of an ESDL import.

    Attributes:
        classes: labels of the imported classes.
        methods: the methods of a step in their order, as labels; `startup` those that run once before.
        step: time step in s, None for that of the data.
        tasks: the tasks, if there are several, in the order in which they run.
        inputs: inputs of the function; likewise `outputs`.
        parameters: what can be calibrated.
        states: variables that keep their values.
        findings: what is not supported, with file and line; the import has a model if there are none.
        remarks: findings on anything else of note.
        missing: packages that are imported and have no files.
        sources: files of the classes and data interfaces that take part.
    """

    classes: tuple[str, ...]
    methods: tuple[str, ...] = ()
    startup: tuple[str, ...] = ()
    step: float | None = None
    tasks: tuple[TaskSummary, ...] = ()
    inputs: tuple[Quantity, ...] = ()
    outputs: tuple[Quantity, ...] = ()
    parameters: tuple[CalibratableParameter, ...] = ()
    states: tuple[StateSummary, ...] = ()
    findings: tuple[Finding, ...] = ()
    remarks: tuple[Finding, ...] = ()
    missing: tuple[str, ...] = ()
    sources: tuple[Path, ...] = ()

    @property
    def whole(self) -> bool:
        """True if the whole function is supported."""
        return not self.findings

    def as_dict(self) -> dict[str, Any]:
        """Return the report as JSON-compatible containers."""
        texts = {"findings": [*map(str, self.findings)], "remarks": [*map(str, self.remarks)]}
        texts["sources"] = [*map(str, self.sources)]
        return asdict(self) | texts | {"whole": self.whole}


@dataclass(frozen=True)
class EsdlImport:
    """The model, None if a part of it is not supported, and the report."""

    model: Model | None
    report: EsdlReport

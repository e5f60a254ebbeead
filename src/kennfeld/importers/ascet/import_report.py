"""Report of an ESDL import: what is calculated and calibrated, and what is not supported."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from kennfeld.base.errors import Finding
from kennfeld.base.formatting import count_noun, number_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.file_info import Table
from kennfeld.models.import_report import ImportReport, StateSummary
from kennfeld.models.importer import ImportResult
from kennfeld.models.quantities import CalibratableParameter, Quantity


@dataclass(frozen=True)
class TaskSummary:
    """A task that runs at a period of its own: its period and first run in s, and its methods in their order."""

    name: str
    period: float
    delay: float
    methods: tuple[str, ...]


@dataclass(frozen=True)
class EsdlReport(ImportReport):
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
    def files(self) -> tuple[Path, ...]:
        """The files of the classes and data interfaces."""
        return self.sources

    @property
    def tables(self) -> list[Table]:
        """States, and what is not supported."""
        states = ((s.name, "calculated" if s.initial is None else number_text(s.initial)) for s in self.states)
        unsupported = ((str(f.location), f.message, f.remedy) for f in self.findings)
        return [
            [("state", "first value"), *states],
            [("not supported", "why", "remedy"), *unsupported],
        ]

    @property
    def sentences(self) -> list[str]:
        """Sentences on what a step calls, whether it can be calibrated, and what behaves differently than in ASCET."""
        step = f"every {number_text(self.step)} s" if self.step is not None else "in each step of the data"
        startup = [f"calls once before: {', '.join(self.startup)}"] if self.startup else []
        problems = count_noun(len(self.findings), "finding")
        coverage = "can be calibrated" if self.whole else f"cannot be calibrated: {problems} above"
        return [
            *([_task_note(task) for task in self.tasks] or [f"calls {step}: {', '.join(self.methods)}"]),
            *startup,
            coverage,
            *self.remark_sentences,
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return the report as JSON-compatible containers."""
        texts = {"findings": [*map(str, self.findings)], "remarks": [*map(str, self.remarks)]}
        texts["sources"] = [*map(str, self.sources)]
        return asdict(self) | texts | {"whole": self.whole}


@dataclass(frozen=True)
class EsdlImport(ImportResult):
    """Result of the import of a class or of tasks."""

    report: EsdlReport


def _task_note(task: TaskSummary) -> str:
    delay = f", first at {number_text(task.delay)} s" if task.delay else ""
    return f"{task.name} calls every {number_text(task.period)} s{delay}: {', '.join(task.methods)}"

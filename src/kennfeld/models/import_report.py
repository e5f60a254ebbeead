"""Reports on imports: the part that all importers share."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

from kennfeld.base.errors import Finding, InputError
from kennfeld.base.formatting import number_text, shorten, size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.file_info import FileInfo, Table, plain
from kennfeld.models.model_function import ModelFunction
from kennfeld.models.quantities import CalibratableParameter, Quantity, calibratable

MAX_REMARKS = 20  # on one import


class NamedPort(Protocol):
    """An input or output of a model."""

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...


@dataclass(frozen=True)
class StateSummary:
    """A variable that keeps its value from step to step, and its first value, None if it is calculated."""

    name: str
    initial: float | None


class ImportReport(ABC):
    """Result of an import. An importer derives a class that says what its users look for.

    Attributes:
        inputs: inputs of the function; likewise `outputs`.
        parameters: what can be calibrated.
        step: time step in s, None for that of the data.
        findings: what is not supported; the import has a model if there are none.
        remarks: findings on anything else of note.
    """

    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    parameters: tuple[CalibratableParameter, ...]
    step: float | None
    remarks: tuple[Finding, ...]

    @property
    @abstractmethod
    def findings(self) -> tuple[Finding, ...]:
        """The parts that are not supported."""

    @property
    def whole(self) -> bool:
        """True if the whole function is supported."""
        return not self.findings

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of which source text takes part, without the named one."""
        return ()

    @property
    @abstractmethod
    def tables(self) -> list[Table]:
        """Tables for a person, which follow those of inputs, outputs and parameters."""

    @property
    @abstractmethod
    def sentences(self) -> list[str]:
        """Sentences for a person: what is imported, and what behaves differently from the source."""

    @abstractmethod
    def as_dict(self) -> dict[str, Any]:
        """Return the report as JSON-compatible containers."""

    @property
    def remark_sentences(self) -> list[str]:
        """The remarks as sentences, of very many the first ones."""
        return shorten([str(remark) for remark in self.remarks], MAX_REMARKS, " remarks; --json lists them")


@dataclass(frozen=True)
class FunctionReport(ImportReport):
    """The report on a function that is imported as a whole or not at all."""

    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    parameters: tuple[CalibratableParameter, ...]
    step: float | None
    remarks: tuple[Finding, ...]
    findings: tuple[Finding, ...] = ()

    @staticmethod
    def of(function: ModelFunction) -> "FunctionReport":
        """Return the report on a function that was read."""
        return FunctionReport(
            tuple(Quantity(each.name, each.unit) for each in function.inputs),
            tuple(Quantity(each.name, each.unit) for each in function.outputs),
            tuple(map(calibratable, function.values.parameters)),
            function.step,
            function.remarks,
        )

    @property
    def tables(self) -> list[Table]:
        """None: all is in those of inputs, outputs and parameters."""
        return []

    @property
    def sentences(self) -> list[str]:
        """The remarks."""
        return self.remark_sentences

    def as_dict(self) -> dict[str, Any]:
        """Return the report as JSON-compatible containers."""
        texts = {"findings": [*map(str, self.findings)], "remarks": [*map(str, self.remarks)]}
        return asdict(self) | texts | {"whole": self.whole}


def describe_import(
    outline: FileInfo, inspect: Callable[[], ImportReport], *, chosen: bool, is_part: bool = False
) -> FileInfo:
    """Return an outline with what can be calibrated and what prevents it.

    Args:
        outline: what the file holds, without importing it.
        inspect: returns the report; raises `InputError` if the file cannot be imported.
        chosen: whether the user set an option. If it does not fit, it is an error; otherwise, why the file cannot be
            imported is one of the notes.
        is_part: whether the import is of a part of the file, which has other inputs and outputs than the outline.
    """
    try:
        report = inspect()
    except InputError as error:
        if chosen:
            raise
        return FileInfo(outline.summary, outline.tables, [*outline.notes, *map(str, error.findings)], outline.as_json)
    tables = _with_ports(outline.tables, report, is_known=report.whole or is_part)
    return FileInfo(
        outline.summary,
        [*tables, parameter_table(report.parameters), *report.tables],
        # the report and the outline may have the same sentence
        list(dict.fromkeys([*report.sentences, *outline.notes])),
        {**outline.as_json, "import": plain(report.as_dict())},
    )


def _with_ports(tables: Sequence[Table], report: ImportReport, *, is_known: bool) -> Sequence[Table]:
    """Return tables with those of inputs and outputs; an outline has its own as long as those of an import are unknown.

    Those of an import have the names that a project uses.
    """
    ports = port_tables(report.inputs, report.outputs)
    others = [table for table in tables if table[0] not in (ports[0][0], ports[1][0])]
    if len(others) == len(tables):
        return [*tables, *ports]
    return [*ports, *others] if is_known else tables


def port_tables(inputs: Sequence[NamedPort], outputs: Sequence[NamedPort]) -> list[Table]:
    """Return the tables of inputs and outputs."""
    return [
        [("input", "unit"), *((port.name, port.unit) for port in inputs)],
        [("output", "unit"), *((port.name, port.unit) for port in outputs)],
    ]


def parameter_table(parameters: Sequence[CalibratableParameter]) -> Table:
    """Return a row for each parameter of an imported model."""
    rows: list[Sequence[str]] = [("parameter", "kind", "size", "value", "unit", "limits", "value from")]
    for p in parameters:
        value = range_text(p.smallest, p.largest)
        source = f"{p.source}, locked" if p.locked else p.source
        rows.append((p.name, p.kind, size_text(p.shape), value, p.unit, limits_text(p.lower, p.upper), source))
    return rows


def range_text(smallest: float, largest: float) -> str:
    """Return the range of values, or the value if there is one only."""
    return f"{smallest:.6g}" + (f" to {largest:.6g}" if largest != smallest else "")


def limits_text(lower: float | None, upper: float | None) -> str:
    """Return limits in words; empty if there are none."""
    if lower is None and upper is None:
        return ""
    if upper is None:
        return f"from {number_text(lower)}"
    return f"up to {number_text(upper)}" if lower is None else f"{number_text(lower)} to {number_text(upper)}"

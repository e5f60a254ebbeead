"""The block diagram of an imported system as a tree, with the state of each block."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Literal

from kennfeld.base.errors import ArgumentError, Finding, InputError, Location
from kennfeld.base.garbage_collection import no_collection
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.import_report import SimulinkReport
from kennfeld.importers.simulink.loaded_model import LoadedModel
from kennfeld.importers.simulink.model_import import ModelImport
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.reader.model_tree import ModelBlock, System
from kennfeld.importers.simulink.variables.model_variables import ParameterSource
from kennfeld.models.model import Model

State = Literal["supported", "bound", "undefined", "unsupported", "unused", "unreached"]
MAX_DETAIL = 40  # characters
_DETAILS = {  # the field that says most about a block of a type
    "BusSelector": "OutputSignals",
    "Constant": "Value",
    "DataStoreRead": "DataStoreName",
    "DataStoreWrite": "DataStoreName",
    "Delay": "DelayLength",
    "DiscreteIntegrator": "InitialCondition",
    "DiscreteTransferFcn": "Denominator",
    "Fcn": "Expr",
    "From": "GotoTag",
    "Gain": "Gain",
    "Goto": "GotoTag",
    "If": "IfExpression",
    "Inport": "Unit",
    "Integrator": "InitialCondition",
    "Logic": "Operator",
    "Lookup": "Table",
    "Lookup2D": "Table",
    "Lookup_n-D": "Table",
    "Math": "Operator",
    "Memory": "InitialCondition",
    "MinMax": "Function",
    "Outport": "Unit",
    "Product": "Inputs",
    "RateLimiter": "RisingSlewLimit",
    "Reference": "SourceType",
    "RelationalOperator": "Operator",
    "Rounding": "Operator",
    "Saturate": "UpperLimit",
    "Sum": "Inputs",
    "Switch": "Threshold",
    "TransferFcn": "Denominator",
    "TransportDelay": "DelayTime",
    "Trigonometry": "Operator",
    "UnitDelay": "InitialCondition",
}


@dataclass(frozen=True)
class DiagramBlock:
    """A block of the tree; the blocks of a subsystem follow it, one level deeper.

    Attributes:
        path: path from the imported system; a slash within a name is doubled.
        name: its name.
        type: the type of the block, or of the mask or chart.
        depth: number of subsystems around it.
        inner: number of blocks directly within it, 0 if it is not a subsystem.
        field: the field that says most about it, empty if there is none.
        detail: that field as written.
        state: whether it can be imported; `unused` if it is not supported, but no output depends on it.
    """

    path: str
    name: str
    type: str
    depth: int
    inner: int
    field: str
    detail: str
    state: State


@dataclass(frozen=True, eq=False)
class Diagram:
    """A Simulink file, as far as it can be imported.

    Attributes:
        name: name of the model.
        version: release that wrote the file.
        blocks: the blocks of the imported system.
        subsystems: paths of all subsystems of the file.
        report: the report of the import; None if it failed before.
        model: the model; None if an output is not supported.
        findings: why there is no report.
    """

    name: str
    version: str
    blocks: tuple[DiagramBlock, ...]
    subsystems: tuple[str, ...]
    report: SimulinkReport | None
    model: Model | None = None
    findings: tuple[Finding, ...] = ()


@no_collection()
def read_diagram(
    path: str | Path,
    subsystem: str | None = None,
    parameters: Iterable[ParameterSource] = (),
    bind: Mapping[str, str] | None = None,
    promote: Collection[str] = (),
    folders: Iterable[str | Path] = (),
    step: float | None = None,
    float32: bool = False,
) -> Diagram:
    """Read a file and import it as far as possible; the arguments are those of `simulink`.

    Raises:
        InputError: the file cannot be read, or the subsystem is unknown.
    """
    loaded = LoadedModel.of(path, parameters, folders)
    system, scope, prefix = loaded.system(subsystem)
    report, model, findings = None, None, tuple[Finding, ...]()
    try:
        cuts = loaded.cuts(bind or {}, prefix)
        result = ModelImport(loaded, system, scope, cuts, frozenset(promote), step, float32).inspect()
        report, model = result.report, result.model
    except InputError as error:
        findings = error.findings
    except ArgumentError as error:
        findings = (Finding(Location(loaded.path.name), str(error)),)
    states = _states(report, cuts if report is not None else {})
    start = len(prefix) + 1 if prefix else 0
    document = loaded.document
    return Diagram(
        document.name,
        document.version,
        tuple(_blocks(system, start, states)),
        tuple(block.path for block in document.root.every() if block.system is not None),
        report,
        model,
        findings,
    )


def _states(report: SimulinkReport | None, cuts: Mapping[str, str]) -> dict[str, State]:
    """Return the state of each block that is not simply supported, by path."""
    states: dict[str, State] = dict.fromkeys(report.unreached if report is not None else (), "unreached")
    for block in report.unsupported if report is not None else ():
        states[block.path] = "undefined" if block.undefined else "unsupported" if block.stops else "unused"
    for loop in report.loops if report is not None else ():
        states |= dict.fromkeys(loop, "unsupported")
    bound: Iterable[str] = (key.rpartition(":")[0] if key.rpartition(":")[2].isdecimal() else key for key in cuts)
    return states | dict.fromkeys(bound, "bound")


def _blocks(system: System, start: int, states: Mapping[str, State]) -> Iterator[DiagramBlock]:
    waiting = [(block, 0) for block in reversed(system.blocks)]
    while waiting:
        block, depth = waiting.pop()
        inner = block.system.blocks if block.system is not None else ()
        path = block.path[start:]
        field, detail = _detail(block)
        state = states.get(path, "supported")
        yield DiagramBlock(path, block.name, _kind(block), depth, len(inner), field, detail, state)
        waiting += [(each, depth + 1) for each in reversed(inner)]


def _kind(block: ModelBlock) -> str:
    if block.script:
        return "MATLAB Function"
    if block.chart is not None:
        return block.chart.kind
    masked = block.mask.type if block.mask is not None else ""
    return masked or (block.reference.type if block.reference is not None else "") or block.type


def _detail(block: ModelBlock) -> tuple[str, str]:
    """Return the field that says most about a block, and its text; both empty if the file does not give it."""
    field = _DETAILS.get(block.type, "")
    text = " ".join((block.value(field) or "").split())
    if not text or (block.type in ("Inport", "Outport") and match_word(text, ["inherit"]) is not None):
        return "", ""
    return field, text if len(text) <= MAX_DETAIL else f"{text[: MAX_DETAIL - 3]}..."

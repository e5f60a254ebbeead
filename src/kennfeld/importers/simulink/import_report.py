"""Import report: supported and unsupported blocks with reasons, substitutions, and parameters."""

import os
from collections.abc import Callable
from dataclasses import asdict, field, replace
from pathlib import Path
from typing import Any, Literal

from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import count_noun, join_names, number_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import file_name
from kennfeld.files.file_info import Table
from kennfeld.models.import_report import ImportReport
from kennfeld.models.quantities import CalibratableParameter, Quantity, UndefinedParameter

TYPES_IGNORED = "data types are ignored, except for limits that saturate: all values are physical, in double precision"
TYPES_ROUNDED = "integer types are ignored, except for limits that saturate: all values are physical"

_MAX_PATHS = 3  # of blocks in a cell
_MAX_NAMED = 3  # variables in a sentence
_MAX_UP = 3  # folders above the present one in a path
_MAX_LISTED = 20  # further variables
_MAX_UNDEFINED = 6  # variables with a finding of their own
_SECTIONS = "To define them in a project file, replace nan with values in:"
_ADVICE = "Define the variables with --parameters: scripts (.m), .mat, .sldd or calibration files."
_DEFINE = (
    "Define it in a script, a .mat, .sldd or calibration file given as parameters, or by initial in the project's "
    "[parameters.NAME]; kennfeld info prints these sections."
)
_LITERALS = 'A locked literal is fitted if the project has a section for it: [parameters."{}"].'
_LOOP_REMEDY = "Insert a Unit Delay into the loop, or bind one of its blocks."


@dataclass(frozen=True)
class UnsupportedBlock:
    """A block that is not supported; `stops` is true if an output of the model depends on it.

    `undefined` names the undefined variables, if these are the reason.
    """

    path: str
    type: str
    why: str
    remedy: str
    stops: bool
    undefined: tuple[str, ...] = ()

    @property
    def finding(self) -> Finding:
        """The block as a finding of the file."""
        remedy = self.remedy or f'Bind it: bind = {{ "{self.path}" = "channel or formula" }}.'
        return Finding(Location(path=self.path), self.why, remedy)


@dataclass(frozen=True)
class VariableFile:
    """A file of the project that supplies what the import lacks.

    Attributes:
        path: the file.
        key: the key of `[model]` that takes it: `parameters` takes the file, `folders` the folder that contains it.
        names: variables without a value that it defines.
        needed_by: the script, model or block that names it; empty if none does.
        others: further files that define the same variables.
    """

    path: Path
    key: Literal["parameters", "folders"]
    names: tuple[str, ...] = ()
    needed_by: str = ""
    others: tuple[Path, ...] = ()

    @property
    def values(self) -> tuple[Path, ...]:
        """The paths to add to the key: the first, or one of the others instead."""
        return (self.path, *self.others) if self.key == "parameters" else (self.path.parent,)

    def message(self, shown: Callable[[Path], str]) -> str:
        """Return what the file supplies, with paths as `shown` writes them."""
        variables = f"{join_names(self.names, _MAX_NAMED)} {'is' if len(self.names) == 1 else 'are'} set in"
        if not self.needed_by:
            return f"{variables} {shown(self.values[0])}"
        message = f"needs {self.path.name}, which is in {shown(self.path.parent)}"
        return f"{message}; {variables} it" if self.names else message

    @property
    def finding(self) -> Finding:
        """The proposal as a finding with the option that accepts it."""
        option = {"parameters": "--parameters", "folders": "--folder"}[self.key]
        value, *others = map(_shown, self.values)
        quoted = f'"{value}"' if " " in value else value
        remedy = f"Add it with {option} {quoted}, or to {self.key} under [model] of a project."
        if others:
            remedy += f" Also in {join_names(others)}: choose one."
        return Finding(Location(self.needed_by), self.message(_shown), remedy)


def _shown(path: Path) -> str:
    """Return a path from the present folder, if that is near."""
    try:
        near = Path(os.path.relpath(path))
    except ValueError:  # on another drive
        return str(path)
    return str(near if near.parts.count("..") <= _MAX_UP else path)


@dataclass(frozen=True)
class ImportableSubsystem:
    """A subsystem that can be imported on its own: number of blocks, inputs and outputs."""

    path: str
    blocks: int
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True)
class SimulinkReport(ImportReport):
    """Result of the import of a Simulink model, block by block.

    Attributes:
        total: number of blocks that compute something.
        supported: number of them that are supported.
        unsupported: the blocks that are not, with reasons.
        loops: algebraic loops, each as block paths.
        substitutions: sentences on differences from Simulink.
        remarks: findings on anything else of note; of severity "remark" for skipped parts of a script, such as plots.
        sources: origin of the value of each parameter.
        frozen: expressions whose variables are constant, with the reason.
        solver: name of the solver.
        step: time step in s, None for that of the data.
        parameters: what can be calibrated.
        inputs: inputs of the function if `whole`; likewise `outputs`.
        subsystems: subsystems that can be imported on their own, if requested.
        reasons: by variable, why scripts could not assign it a value.
        definitions: what to define, if variables are undefined.
        missing_files: files that were not found, with the scripts that load or run them or the models that use them.
        proposals: files of the project that define undefined variables or are missing files.
        stopped: errors that prevent lowering altogether.
        unreached: paths of blocks whose inputs come from unsupported ones; they count as neither.
        results: paths of the blocks whose signals are the outputs: outports; without any, blocks that record or
            display signals.
        has_outports: True if they are outports.
    """

    total: int
    supported: int
    unsupported: tuple[UnsupportedBlock, ...]
    loops: tuple[tuple[str, ...], ...]
    substitutions: tuple[str, ...]
    remarks: tuple[Finding, ...]
    sources: dict[str, str]
    frozen: dict[str, str]
    solver: str
    step: float | None
    parameters: tuple[CalibratableParameter, ...] = ()
    inputs: tuple[Quantity, ...] = ()
    outputs: tuple[Quantity, ...] = ()
    subsystems: tuple[ImportableSubsystem, ...] = ()
    reasons: dict[str, str] = field(default_factory=dict)
    definitions: tuple[UndefinedParameter, ...] = ()
    missing_files: dict[str, str] = field(default_factory=dict)
    proposals: tuple[VariableFile, ...] = ()
    stopped: tuple[Finding, ...] = ()
    unreached: tuple[str, ...] = ()
    results: tuple[str, ...] = ()
    has_outports: bool = True

    @property
    def whole(self) -> bool:
        """True if all outputs are supported."""
        return not self.stopped and not self.loops and not any(block.stops for block in self.unsupported)

    @property
    def tables(self) -> list[Table]:
        """Unsupported blocks, variables without a value, and subsystems that can be imported."""
        undefined = ((name, str(len(paths)), join_names(paths, _MAX_PATHS)) for name, paths in self.undefined.items())
        unsupported = [("not supported", "type", "why", "remedy", "stops an output")]
        for blocks in self.groups:
            first = blocks[0]
            paths = join_names([block.path for block in blocks], 1)
            unsupported.append((paths, first.type, first.why, first.finding.remedy, "yes" if first.stops else "no"))
        subsystems = ((s.path, str(s.blocks), ", ".join(s.inputs), ", ".join(s.outputs)) for s in self.subsystems)
        return [
            unsupported,
            [("variable without a value", "blocks", "needed by"), *undefined],
            [("can be imported by itself", "blocks", "inputs", "outputs"), *subsystems],
        ]

    @property
    def sentences(self) -> list[str]:
        """Sentences on how much of the model can be calibrated, and what behaves differently than in Simulink."""
        step = "the step of the data" if self.step is None else f"a step of {number_text(self.step)} s"
        unreached = f", {len(self.unreached)} not reached behind others" if self.unreached else ""
        return [
            f"{self.supported} of {count_noun(self.total, 'block')} supported{unreached}; {self._coverage}",
            *map(str, self.stopped),
            *(f"algebraic loop: {' -> '.join(loop[:10])}" for loop in self.loops),
            *map(str, self._supplies),
            *([_ADVICE] if self.unsupplied else []),
            *[_LITERALS.format(parameter.name) for parameter in self.parameters if parameter.locked][:1],
            f"runs with {step}",
            *self.substitutions,
            *self.fixed,
            *self.remark_sentences,
            *([f"{_SECTIONS}\n\n{self._sections(self.unsupplied)}"] if self.unsupplied else []),
        ]

    @property
    def _coverage(self) -> str:
        if not self.results:
            return "it has no outputs"
        if not self.whole:
            return "not all outputs can be calibrated"
        if self.has_outports:
            return "all outputs can be calibrated"
        return f"it has no outport: its outputs, what {join_names(self.results, _MAX_PATHS)} gets, can be calibrated"

    @property
    def project_sections(self) -> str:
        """The undefined variables as sections of a project file, with `nan` for values; "" if there are none."""
        return self._sections(self.definitions)

    def _sections(self, definitions: tuple[UndefinedParameter, ...]) -> str:
        if not definitions:
            return ""
        absent = [f"# {source} {_missing_text(name)}" for name, source in self.missing_files.items()]
        return "\n".join([*absent, *(parameter.project_section for parameter in definitions)])

    @property
    def _supplied(self) -> set[str]:
        return {name for proposal in self.proposals for name in proposal.names}

    @property
    def unsupplied(self) -> tuple[UndefinedParameter, ...]:
        """The undefined variables that no file of the project is known to define."""
        supplied = self._supplied
        return tuple(parameter for parameter in self.definitions if parameter.name not in supplied)

    @property
    def fixed(self) -> tuple[str, ...]:
        """A sentence for each expression whose variables are constant."""
        frozen = {" ".join(text.split())[:100]: why for text, why in self.frozen.items()}
        return tuple(f"{text} is constant, and so are its variables: {why}" for text, why in frozen.items())

    @property
    def notes(self) -> tuple[Finding, ...]:
        """Remarks for a user who calibrates the model."""
        substitutions = (text for text in self.substitutions if text not in (TYPES_IGNORED, TYPES_ROUNDED))
        sentences = (Finding(Location(), text, severity="remark") for text in (*substitutions, *self.fixed))
        return (*sentences, *(replace(f, severity="remark") for f in self.remarks if f.severity != "remark"))

    def as_dict(self) -> dict[str, Any]:
        """Return the report as JSON-compatible containers."""
        stopped = [asdict(finding) | {"location": str(finding.location)} for finding in self.stopped]
        proposals = [
            asdict(each) | {"path": str(each.path), "others": [*map(str, each.others)]} for each in self.proposals
        ]
        return asdict(self) | {
            "proposals": proposals,
            "remarks": [*map(str, self.remarks)],
            "stopped": stopped,
            "whole": self.whole,
        }

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Reasons why outputs are not supported.

        First the files that supply what is missing and those that were not found, because others follow from these;
        then blocks, loops, and undefined variables that no file is known to define, each once.
        """
        others = (_merge_findings(blocks) for blocks in self.groups if blocks[0].stops)
        loops = (Finding(Location(path=loop[0]), _describe_loop(loop), _LOOP_REMEDY) for loop in self.loops)
        return (*self.stopped, *self._supplies, *self.missing, *others, *loops, *self._undefined_findings)

    @property
    def _supplies(self) -> tuple[Finding, ...]:
        return tuple(proposal.finding for proposal in self.proposals)

    @property
    def missing(self) -> tuple[Finding, ...]:
        """Files that were not found anywhere in the project, if variables are undefined."""
        located = {proposal.path.name for proposal in self.proposals if proposal.needed_by}
        absent = {name: source for name, source in self.missing_files.items() if file_name(name) not in located}
        return tuple(_missing_finding(*names) for names in absent.items()) if self.undefined else ()

    @property
    def _undefined_findings(self) -> tuple[Finding, ...]:
        supplied = self._supplied
        names = {name: paths for name, paths in self.undefined.items() if name not in supplied}
        first = tuple(names.items())[:_MAX_UNDEFINED]
        rest = tuple(names)[_MAX_UNDEFINED:]
        each = (_undefined_finding(name, paths, self._reason(name)) for name, paths in first)
        message = f"undefined, as are {join_names(rest[1:], _MAX_LISTED)}" if rest[1:] else "undefined"
        return (*each, *([Finding(Location(f"variable {rest[0]}"), message, _DEFINE)] if rest else []))

    def _reason(self, name: str) -> str:
        return self.reasons.get(name) or self.reasons.get(name.partition(".")[0], "")

    @property
    def groups(self) -> tuple[tuple[UnsupportedBlock, ...], ...]:
        """Unsupported blocks that do not lack a variable, grouped by reason."""
        groups: dict[tuple[str, str, bool], list[UnsupportedBlock]] = {}
        for block in self.unsupported:
            if not block.undefined:
                groups.setdefault((block.why, block.remedy, block.stops), []).append(block)
        return tuple(tuple(blocks) for blocks in groups.values())

    @property
    def undefined(self) -> dict[str, tuple[str, ...]]:
        """Undefined variables with the paths of the blocks that use them."""
        names = dict.fromkeys(name for block in self.unsupported for name in block.undefined)
        return {name: tuple(block.path for block in self.unsupported if name in block.undefined) for name in names}


def _merge_findings(blocks: tuple[UnsupportedBlock, ...]) -> Finding:
    first = blocks[0].finding
    if len(blocks) == 1:
        return first
    return replace(first, location=Location(path=f"{first.location} and {len(blocks) - 1} more"))


def _missing_text(name: str) -> str:
    return f"needs {name}, which was not found"


def _missing_finding(name: str, source: str) -> Finding:
    remedy = "Place it in the same folder, or add its folder to folders: variables may be defined there."
    return Finding(Location(source), _missing_text(name), remedy)


def _undefined_finding(name: str, paths: tuple[str, ...], why: str) -> Finding:
    who = f"used by {paths[0]}" if len(paths) == 1 else f"used by {paths[0]} and {len(paths) - 1} more"
    return Finding(Location(f"variable {name}"), f"undefined{f' ({why})' if why else ''}; {who}", _DEFINE)


def _describe_loop(loop: tuple[str, ...]) -> str:
    names = " -> ".join([*loop, loop[0]]) if len(loop) < 12 else f"{' -> '.join(loop[:10])} -> ... -> {loop[0]}"
    return f"algebraic loop: {names}"

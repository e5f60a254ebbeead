"""Missing terms of a project: the search over all channels of its recordings, patches of its files, and their undo."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.analysis.missing.proposal import TermProposal, TermProposals
from kennfeld.analysis.missing.proposing import SearchScope, Watch, find_terms
from kennfeld.analysis.missing.refit import Addition
from kennfeld.analysis.missing.text_patch import difference, quoted_name, with_term
from kennfeld.base.arrays import Float
from kennfeld.base.atomic_files import write_whole
from kennfeld.base.content_digest import digest_of
from kennfeld.base.errors import ArgumentError, Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import below
from kennfeld.calfiles import read as read_parameters
from kennfeld.domain.free_axes import AxisKey, free_axes, with_breakpoints
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.measurement.reader import describe
from kennfeld.measurement.table_conversion import ChannelDescription, TableDescription
from kennfeld.measurement.time_column import is_named_time
from kennfeld.models.formula.frontend import text_of
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.multistart import run
from kennfeld.preprocessing.recordings import count_before, matching_recordings
from kennfeld.project.document import ProjectDocument
from kennfeld.project.results import FOLDER

if TYPE_CHECKING:
    from kennfeld.project.project import Project

UNDO = "proposals.json"
_BOM = "\ufeff"


def propose(
    project: "Project",
    scope: SearchScope,
    report: Callable[[str], None],
    values: ParameterSet | None = None,
    watch: Watch | None = None,
) -> TermProposals:
    """Return the terms that the function of a project lacks, with the patches of its files.

    Args:
        project: the project.
        scope: what takes part.
        report: called with lines of text on the progress.
        values: the calibration; by default that of the last run in the results folder.
        watch: called with what is found so far, see `find_terms`.

    Raises:
        InputError: the project has errors.
    """
    scope.check()
    problem, remarks = _with_more_channels(project, scope.channels)
    values = values or calibrated_values(project, problem)
    if values is None:
        report("calibrating, as the results folder has no values of this function")
        remarks.append("Calibrated first, as the results folder has no values of this function.")
        result = run(problem, project.options)
        values = result.parameters
    started = replace(problem, parameters=values)
    terms = find_terms(started, scope, project.options, report, watch)
    patched = tuple(replace(proposal, patch=_patch_text(project, problem, proposal)) for proposal in terms.proposals)
    return replace(terms, proposals=patched, remarks=(*remarks, *terms.remarks))


def calibrated_values(project: "Project", problem: Problem) -> ParameterSet | None:
    """Return the values of the last run, if it was of a function with the same parameters."""
    path = project.path.parent / FOLDER / "parameters.json"
    if not path.is_file():
        return None
    with suppress(InputError, ArgumentError):
        values = read_parameters(path)
        names = [name for name in problem.free_names if name in values]
        if len(names) < len(problem.free_names):
            return None
        pairs = [(problem.parameters[name], values[name]) for name in names]
        if any(own.values.shape != other.values.shape for own, other in pairs):
            return None
        # limits are those of the project, and so are breakpoints that are not fitted
        own = problem.parameters.with_parameters(*(own.with_values(other.values.ravel()) for own, other in pairs))
        return with_breakpoints(own, dict(_moved(problem.parameters, values)))
    return None


def _moved(parameters: ParameterSet, values: ParameterSet) -> Iterator[tuple[AxisKey, Float]]:
    """Yield the fitted breakpoints of free axes."""
    for key, axis in free_axes(parameters).items():
        name, direction = axis.places[0]
        if name in values:
            yield key, values[name].axes[direction].breakpoints


def _with_more_channels(project: "Project", patterns: Sequence[str]) -> tuple[Problem, list[str]]:
    """Return the problem with all channels that match, and what there is to say about them."""
    problem = project.problem()
    known = {name for data in problem.datasets for name in data}
    offered = offered_channels(project)
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in (*known, *offered, *problem.model.graph.inputs)):
            message = f"channels: the training data have no channel {pattern}. {nearest(pattern, offered)}"
            raise ArgumentError(message.strip())
    names = tuple(n for n in offered if n not in known and any(fnmatchcase(n, pattern) for pattern in patterns))
    if not names:
        return problem, []
    wider = project.reading(names).problem_or_none()
    if wider is None:
        return problem, ["Further channels of the recordings cannot be read together with those of the function."]
    if [data.samples for data in wider.datasets] != [data.samples for data in problem.datasets]:
        text = "Further channels were recorded at other times than those of the function. Write raster = ... (in s)."
        return problem, [text]
    return wider, []


def offered_channels(project: "Project", read: Callable[[str], Sequence[str]] | None = None) -> list[str]:
    """Return the names of all channels of the first file of each training dataset, and of calculated ones.

    Args:
        project: the project.
        read: returns the channels of a file; by default `channels_of_file`.
    """
    names: dict[str, None] = dict.fromkeys(project.file.calculated)
    for entry in project.file.datasets:
        files = matching_recordings(project.file.folder, entry.files)
        if entry.use != "training" or not files:
            continue
        with suppress(InputError):
            names |= dict.fromkeys((read or channels_of_file)(files[0]))
    return list(names)


def channels_of_file(path: str) -> list[str]:
    """Return the names of the channels of a recording that are not its time."""
    tables = describe(path).tables
    return [channel.name for table in tables for channel in table.channels if not _is_time(channel, table)]


def _is_time(channel: ChannelDescription, table: TableDescription) -> bool:
    """Return if a column is the time of a recording only as long as nobody asks for it as a channel, as `t`."""
    named = table.time is not None and table.time.channel == channel.name
    return named and not is_named_time(channel.name, channel.unit)


@dataclass(frozen=True)
class Patch:
    """The texts of the function and of the project file with a term.

    Attributes:
        function: path of the formula text; None if the term cannot be written into it.
        function_text: with the term.
        project_text: with the section of the new parameter.
        parts: the changes as text.
        reason: why the term cannot be written into the function, as a clause; "" if it can.
    """

    function: Path | None
    function_text: str
    project_text: str
    parts: str
    reason: str = ""


def patch(
    project: "Project", problem: Problem, proposal: TermProposal, texts: Mapping[str, str] | None = None
) -> Patch:
    """Return the files of a project with a term.

    Args:
        project: the project.
        problem: its problem.
        proposal: the term.
        texts: contents of the project file and of formula text that are not saved, by name; by default as on disk.
    """
    addition, graph, texts = proposal.addition, problem.model.graph, texts or {}
    assert addition is not None
    name, file = project.path.name, project.file.model.file
    document = ProjectDocument(texts[name], project.path) if name in texts else ProjectDocument.read(project.path)
    before = document.text
    if addition.parameter is not None:
        document.set(("parameters", addition.parameter.name), _section(project, proposal))
    toml = difference(before, document.text, name)
    function = project.path.parent / file
    as_text = f"{sentence(proposal)}\n{toml}".strip()
    if function.suffix.casefold() != ".kf":
        return Patch(None, "", document.text, as_text, f"{file} is not formula text, into which terms are written")
    text = texts[file].removeprefix(_BOM) if file in texts else text_of(function)
    changed = with_term(text, addition, graph.inputs, {*graph.names, *graph.inputs, *graph.parameters})
    if changed is None:
        node = addition.term.node
        reason = f"{file} has no equation of its own for {node}, or others read its earlier values as well"
        return Patch(None, "", document.text, as_text, reason)
    parts = [difference(text, changed, file), toml]
    return Patch(function, changed, document.text, "\n".join(part for part in parts if part))


def _patch_text(project: "Project", problem: Problem, proposal: TermProposal) -> str:
    return patch(project, problem, proposal).parts


def _section(project: "Project", proposal: TermProposal) -> dict[str, Any]:
    """Return the section of the new parameter, which starts without effect."""
    addition = proposal.addition
    assert addition is not None
    assert addition.parameter is not None
    term, parameter = addition.term, addition.parameter
    free = {} if any(fnmatchcase(parameter.name, each) for each in project.file.calibration.free) else {"free": True}
    if term.kind == "offset":
        return {"per": "recording", "initial": 0.0, **free, **_reference(project, addition)}
    if not parameter.axes:
        seconds = float(f"{proposal.term.seconds:.3g}")
        return {"unit": "s", "initial": seconds, **free}
    section: dict[str, Any] = {
        "x": {"input": term.channel, "breakpoints": list(term.breakpoints)},
        **({"y": {"input": term.second, "breakpoints": list(term.second_breakpoints)}} if term.second else {}),
        "initial": float(parameter.values.flat[0]),
        **free,
    }
    if addition.smoothness:
        section["smoothness"] = addition.smoothness
    if addition.pin is not None:
        section["pin"] = [{"at": list(addition.pin.at), "value": addition.pin.value}]
    if lines := _locked_lines(parameter):
        section["lock"] = lines
    return section


def _locked_lines(parameter: Parameter) -> list[dict[str, list[float]]]:
    """Return the locked lines of a map, or its locked value, as ranges of its axes."""
    if len(parameter.axes) != 2 or not parameter.locked.any():
        return []
    x, y = (axis.breakpoints.tolist() for axis in parameter.axes)
    rows, columns = np.flatnonzero(parameter.locked.all(axis=1)), np.flatnonzero(parameter.locked.all(axis=0))
    lines = [{"x": [x[at], x[at]]} for at in rows] + [{"y": [y[at], y[at]]} for at in columns]
    return lines or [{"x": [x[i], x[i]], "y": [y[j], y[j]]} for i, j in np.argwhere(parameter.locked).tolist()]


def _reference(project: "Project", addition: Addition) -> dict[str, Any]:
    """Return the lock of the first fitted recording, if the function itself can take over a mean of all offsets."""
    if not addition.constraints:
        return {}
    file = project.file
    first = next(each for each in file.datasets if each.is_fitted and matching_recordings(file.folder, each.files))
    number = 1 + count_before(file, first)
    return {"lock": [{"x": [number, number]}]}


def sentence(proposal: TermProposal) -> str:
    """Return a term as a line of formula text, for functions that are not formula text."""
    addition = proposal.addition
    assert addition is not None
    node, term = quoted_name(proposal.term.node), addition.term
    label = "" if addition.parameter is None else addition.parameter.name
    inputs = ", ".join(map(quoted_name, term.channels))
    right = {
        "add": f"{node} + {label}({inputs})",
        "multiply": f"{node} * {label}({inputs})",
        "lag": f"PT1({node}, {label})",
        "offset": f"{node} + {label}",
        "delay": f"delay({node}, {term.steps}, {node})",
    }[term.kind]
    place = f"  # {proposal.location}" if proposal.location else ""
    return f"{node} = {right}{place}"


def apply(project: "Project", proposal: TermProposal) -> tuple[Path, ...]:
    """Write a term into the formula text and the project file, both or none, and remember what they were.

    Returns:
        The files that were written.

    Raises:
        InputError: the function is not formula text, or a file cannot be written.
    """
    change = patch(project, project.problem(), proposal)
    if change.function is None:
        raise _not_written(project, proposal, change.reason)
    texts = {change.function: change.function_text, project.path: change.project_text}
    # without the mark, as texts are read from files
    unsaved = {project.file.model.file: change.function_text, project.path.name: change.project_text.removeprefix(_BOM)}
    _require_valid(project, unsaved)
    before = {path: path.read_bytes().decode("utf-8") for path in texts}
    mark = _BOM if before[change.function].startswith(_BOM) else ""
    texts[change.function] = mark + texts[change.function]
    files = [
        {"path": _relative(project, path), "before": before[path], "after": digest_of(texts[path])} for path in texts
    ]
    record = {"text": proposal.change, "files": files}
    stack = _undo_file(project)
    _write_all(texts, before)
    try:
        with convert_errors(stack, "cannot be written"):
            stack.parent.mkdir(parents=True, exist_ok=True)
            write_whole(stack, json.dumps([*_records(stack), record], ensure_ascii=False))
    except InputError:
        _write_all(before, texts)  # no term without a way back
        raise
    return tuple(texts)


def _not_written(project: "Project", proposal: TermProposal, reason: str) -> InputError:
    """Return the error for a term that cannot be written, with the place where it is to be added."""
    place = project.file.location("model", "file")
    node = f"node {proposal.term.node}" + (f" ({proposal.location})" if proposal.location else "")
    line = sentence(proposal).split("  # ")[0]
    remedy = f"{proposal.change} where the function was made: {node}. As formula text: {line}."
    if proposal.parameter is not None:
        remedy += " The patch of kennfeld propose --json has the section of its parameter."
    return InputError.of(place, f"{reason}; nothing was changed", remedy)


def _relative(project: "Project", path: Path) -> str:
    """Return a path as seen from the project, whose folder may be moved."""
    folder = project.path.parent
    return str(path.relative_to(folder) if path.is_relative_to(folder) else path)


def _require_valid(project: "Project", unsaved: Mapping[str, str]) -> None:
    """Raise `InputError` if the project with other texts has errors."""
    findings = type(project).read(project.path, unsaved).check()
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors:
        raise InputError([Finding(Location("proposal"), "cannot be added to the project"), *errors])


def _write_all(texts: Mapping[Path, str], before: Mapping[Path, str]) -> None:
    """Write all files or none."""
    written: list[Path] = []
    try:
        for path, text in texts.items():
            with convert_errors(path, "cannot be written"):
                write_whole(path, text, durable=True, follow=True)
            written.append(path)
    except InputError:
        for path in written:
            write_whole(path, before[path], durable=True, follow=True)
        raise


def undo(project: "Project") -> tuple[str, tuple[Path, ...]]:
    """Restore the files as they were before the last term was applied.

    Returns:
        The term in words, and the files.

    Raises:
        InputError: there is none, or a file has been changed since.
    """
    stack = _undo_file(project)
    records = _records(stack)
    if not records:
        raise InputError.of(Location(project.path.name), "no proposal was applied that could be undone")
    record = records.pop()
    texts = {project.path.parent / file["path"]: file["before"] for file in record["files"]}
    present = {path: _present_text(path) for path in texts}
    for path, file in zip(texts, record["files"], strict=True):
        if digest_of(present[path]) != file["after"]:
            message = "the file was changed after the proposal was applied"
            raise InputError.of(Location.of_file(path), message, "Undo the changes by hand, or with version control.")
    _write_all(texts, present)
    with convert_errors(stack, "cannot be written"):
        write_whole(stack, json.dumps(records, ensure_ascii=False))
    return str(record["text"]), tuple(texts)


def _present_text(path: Path) -> str:
    with convert_errors(path, "cannot be read"):
        return path.read_bytes().decode("utf-8", "replace")


def _undo_file(project: "Project") -> Path:
    path = project.path.parent / ".kennfeld" / project.path.stem / UNDO
    with convert_errors(path, "cannot be written"):
        return below(project.path.parent, path)


def _records(stack: Path) -> list[dict[str, Any]]:
    if not stack.is_file():
        return []
    with suppress(ValueError, OSError):
        content = json.loads(stack.read_text(encoding="utf-8"))
        return content if isinstance(content, list) else []
    return []

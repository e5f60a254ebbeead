"""Contents of the app's screen of a Simulink model: its blocks, its formula text, and what stops its import."""

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

from kennfeld.base.file_state import note_opened, while_unchanged
from kennfeld.importers.simulink.diagram import Diagram, read_diagram
from kennfeld.importers.simulink.formula_export import formula_lines
from kennfeld.importers.simulink.import_report import ImportableSubsystem, SimulinkReport, VariableFile
from kennfeld.importers.simulink.importable_subsystems import find_subsystems
from kennfeld.importers.simulink.importing import arguments_of
from kennfeld.importers.simulink.lowering.diagnostics import STEP_REMEDY
from kennfeld.models.import_view import problem_views, report_view
from kennfeld.models.importer import ImportRequest
from kennfeld.models.model import Model


def view(request: ImportRequest, folder: Path) -> dict[str, Any]:
    """Return the blocks of the imported part, its formula text, and what stops it.

    Raises:
        InputError: the model cannot be read.
    """
    own = _diagram(request, folder)
    return {
        "name": own.name,
        "version": own.version,
        "blocks": [asdict(block) for block in own.blocks],
        "subsystems": list(own.subsystems),
        "lines": [] if own.model is None else [asdict(line) for line in formula_lines(own.model, each_block=True)],
        "problems": problem_views(own.findings),
        **({} if own.report is None else _of_report(own.report, own.model, folder)),
    }


def _of_report(report: SimulinkReport, model: Model | None, folder: Path) -> dict[str, Any]:
    integrates = model is None or model.equations is not None  # without continuous states, no solver is used
    return report_view(report) | {
        "total": report.total,
        "supported": report.supported,
        "unreached": len(report.unreached),
        "solver": report.solver if integrates else "",
        "blocking": [
            {**asdict(block), "needsStep": block.remedy == STEP_REMEDY}
            for block in report.unsupported
            if not block.undefined
        ],
        "undefined": [
            {"name": name, "paths": list(paths), "reason": report.reasons.get(name, "")}
            for name, paths in report.undefined.items()
        ],
        "proposals": [_proposal(each, folder) for each in report.proposals],
        "loops": [list(loop) for loop in report.loops],
        "stopped": problem_views((*report.stopped, *report.missing)),
        "notes": [*report.substitutions, *report.fixed, *map(str, report.remarks)],
    }


def _proposal(proposal: VariableFile, folder: Path) -> dict[str, Any]:
    """Return a proposal with paths as the project file writes them."""

    def shown(path: Path) -> str:
        try:
            return Path(os.path.relpath(path, folder)).as_posix()
        except ValueError:  # on another drive
            return path.as_posix()

    text = f"{proposal.needed_by} {proposal.message(shown)}".strip()
    return {"key": proposal.key, "values": [*map(shown, proposal.values)], "text": text}


def parts(request: ImportRequest, folder: Path) -> list[dict[str, Any]]:
    """Return the subsystems that can be imported by themselves, largest first. Raises `InputError` for its file."""
    return [asdict(part) for part in _parts(request, folder)]


@while_unchanged(4)
def _diagram(request: ImportRequest, folder: Path) -> Diagram:
    """Import the model; files that have not changed are read once."""
    _note_folders(request, folder)
    return read_diagram(*arguments_of(request))


@while_unchanged(4)
def _parts(request: ImportRequest, folder: Path) -> tuple[ImportableSubsystem, ...]:
    _note_folders(request, folder)
    return find_subsystems(request.path, request.options.parameters, request.options.folders)


def _note_folders(request: ImportRequest, folder: Path) -> None:
    """Let what is imported depend on all files of the folders in which libraries and variables are searched."""
    for place in (folder, *request.options.folders):
        note_opened(place)

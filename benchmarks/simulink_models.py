"""Import of Simulink files: `python -m benchmarks.simulink_models FOLDER [GIVEN.json]` prints a table.

For each file whether it is whole, how many of its blocks are supported, what stops it, and its largest subsystem that
can be imported by itself. The second file says what is given to a model, all of it as wanted, files beside the JSON:
{"engine": {"values": {"K": 1.0}, "files": ["init.m"], "folders": ["libraries"], "bind": {"Sensor": "1.0"}}}.
"""

import json
import sys
from pathlib import Path
from typing import Any

from kennfeld.base.errors import InputError
from kennfeld.base.formatting import shorten
from kennfeld.importers.simulink.import_report import ImportReport
from kennfeld.importers.simulink.importable_subsystems import inspect_simulink
from kennfeld.importers.simulink.importing import import_simulink


def row(path: Path, settings: dict[str, Any], beside: Path) -> str:
    """One line of the table."""
    parameters = [*(beside / name for name in settings.get("files", ())), settings.get("values", {})]
    folders = [beside / name for name in settings.get("folders", ())]
    try:
        report = _bound(path, parameters, folders, settings.get("bind"))
        parts = () if report.whole else inspect_simulink(path, parameters=parameters, folders=folders).subsystems
    except InputError as error:
        return f"| {path.name} | refused | | {error.findings[0]} | |"
    reasons = "; ".join(shorten([f"{finding.location}: {finding.message}" for finding in report.findings], 4))
    largest = f"{parts[0].path} ({parts[0].blocks} blocks)" if parts else ""
    kind = "whole" if report.whole else "partial"
    unreached = f", {len(report.unreached)} not reached" if report.unreached else ""
    return f"| {path.name} | {kind} | {report.supported} of {report.total}{unreached} | {reasons} | {largest} |"


def _bound(path: Path, parameters: list[Any], folders: list[Path], bind: dict[str, str] | None) -> ImportReport:
    """The report on a file with blocks replaced; without them where it cannot be built at all."""
    try:
        return import_simulink(path, parameters=parameters, bind=bind, folders=folders).report
    except InputError:
        return inspect_simulink(path, parameters=parameters, folders=folders)


def main() -> None:
    """Print the table."""
    folder = Path(sys.argv[1])
    file = Path(sys.argv[2]) if len(sys.argv) > 2 else None
    settings = json.loads(file.read_text(encoding="utf-8")) if file is not None else {}
    print("| file | | blocks | what stops it | largest subsystem that can be imported |\n|---|---|---|---|---|")
    for path in sorted(folder.iterdir()):
        if path.suffix in (".slx", ".mdl"):
            print(row(path, settings.get(path.stem, {}), file.parent if file is not None else folder))


if __name__ == "__main__":
    main()

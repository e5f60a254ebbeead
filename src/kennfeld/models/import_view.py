"""Contents of the app's screens of imported functions, as JSON-compatible containers."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from kennfeld.base.errors import Finding
from kennfeld.models.import_report import ImportReport


def report_view(report: ImportReport) -> dict[str, Any]:
    """Return what all reports have in common."""
    return {
        "whole": report.whole,
        "step": report.step,
        "inputs": [asdict(each) for each in report.inputs],
        "outputs": [asdict(each) for each in report.outputs],
        "parameters": [asdict(each) for each in report.parameters],
    }


def problem_views(findings: Sequence[Finding], files: Sequence[Path] = ()) -> list[dict[str, Any]]:
    """Return findings with their places, and the number of the file that each is about; -1 if it is none of these."""
    numbers = file_numbers(files)
    return [
        {
            "source": numbers.get(finding.location.file, -1),
            "line": finding.location.line,
            "place": finding.location.path,
            "message": finding.message,
            "remedy": finding.remedy,
            "text": str(finding),
        }
        for finding in findings
    ]


def file_numbers(files: Sequence[Path]) -> Mapping[str, int]:
    """Return the number of each file by its name, of several with one name the first."""
    return {path.name: number for number, path in reversed(list(enumerate(files)))}

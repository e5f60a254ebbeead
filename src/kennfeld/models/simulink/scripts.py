"""Parameter scripts: followed, never executed."""

from pathlib import Path

from kennfeld.errors import Finding
from kennfeld.models.simulink.variables import Variables

__all__ = ["run", "run_text"]


def run(found: Variables, path: Path) -> None:
    """Add the variables that a script makes."""
    found.findings.append(Finding(path.name, "scripts cannot be followed yet", "Give a .mat file with its variables."))


def run_text(found: Variables, text: str, name: str, folder: Path) -> None:
    """Add the variables that a text of MATLAB makes."""
    if text.strip():
        found.findings.append(
            Finding(name, "it is MATLAB code, which cannot be followed yet", "Give a .mat file.", severity="warning")
        )

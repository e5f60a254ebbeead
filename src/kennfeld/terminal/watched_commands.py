"""Tells which command lines are watched by another process, because they run code of files that a project names."""

import sys
from collections.abc import Sequence
from pathlib import Path

from kennfeld.base.watch_folder import DEFAULT_LIMIT

COMMANDS = ("check", "calibrate", "simulate", "report", "export", "design")  # that evaluate a project
APP = "app"
_UNEVALUATED = ("-h", "--help", "--no-run")


def call_limit(arguments: Sequence[str]) -> float | None:
    """Return how long a call of foreign code may take in s; None if the command does not have to be watched.

    The arguments are not parsed as the command will parse them: watching a command without need does no harm.
    """
    if getattr(sys, "frozen", False) or not sys.executable:  # there is no interpreter to start
        return None
    command, *others = arguments or [""]
    if command not in (APP, *COMMANDS) or set(_UNEVALUATED).intersection(others):
        return None
    projects = (_limit_of_project(Path(name)) for name in others if not name.startswith("-"))
    limits = [limit for limit in projects if limit is not None]
    if command == APP:
        limits = limits or [DEFAULT_LIMIT]  # a project may be opened, or may call foreign code, later
    return max(limits, default=None)


def _limit_of_project(path: Path) -> float | None:
    """Return the limit of a project; None if it calls no foreign code, or cannot be read."""
    import tomllib

    path = path / "kennfeld.toml" if path.is_dir() else path
    try:
        tables = tomllib.loads(path.read_text("utf-8-sig"))
        model = tables.get("model", {})
        references = [model.get("file", ""), *tables.get("functions", {}).values()]
    except (OSError, ValueError, AttributeError, RecursionError):  # the command reports it
        return None
    if not any(isinstance(name, str) and _runs(name) for name in references):
        return None
    limit = model.get("timeout")
    return float(limit) if isinstance(limit, int | float) and limit > 0 else DEFAULT_LIMIT


def _runs(reference: str) -> bool:
    if reference.lower().endswith(".kf"):
        return False  # the most frequent case, without loading the other kinds
    from kennfeld.models.function_files import importer_of_function

    importer = importer_of_function(reference)
    return importer is not None and importer.runs

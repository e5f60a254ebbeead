"""Projects that were opened before, each with a summary for the start page, in a file of the user's own folder."""

import hashlib
import json
import re
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import field
from pathlib import Path
from typing import Any

from kennfeld.base.atomic_files import write_whole
from kennfeld.base.lazy_dataclass import dataclass

MAX_PROJECTS = 20


@dataclass(frozen=True)
class RecentProject:
    """A project that was opened before.

    Attributes:
        path: its project file.
        opened: when it was opened, in s since 1970; 0 if unknown.
        summary: what the start page shows of it, as JSON.
    """

    path: Path
    opened: float = 0.0
    summary: Mapping[str, Any] = field(default_factory=dict)


def project_id(path: Path) -> str:
    """Return the name of a project in addresses of the page: that of its folder, with a digest of the whole path.

    >>> project_id(Path("/home/me/Engine torque/kennfeld.toml"))
    'Engine-torque-700ec4e4'
    """
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", path.parent.name).strip("-")[:40]
    return f"{name or 'project'}-{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"


def recent_file() -> Path:
    """Return where the list is kept."""
    return Path.home() / ".kennfeld" / "recent.json"


def recent_projects() -> list[RecentProject]:
    """Return the projects that still exist, the last one first; a damaged list is empty."""
    try:
        entries = json.loads(recent_file().read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    known = [_read(entry) for entry in entries] if isinstance(entries, list) else []
    return [each for each in known if each is not None and each.path.is_file()][:MAX_PROJECTS]


def _read(entry: object) -> RecentProject | None:
    # earlier versions kept paths alone
    if isinstance(entry, str):
        return RecentProject(Path(entry))
    if not isinstance(entry, dict) or not isinstance(entry.get("path"), str):
        return None
    opened, summary = entry.get("opened"), entry.get("summary")
    seconds = float(opened) if isinstance(opened, int | float) else 0.0
    return RecentProject(Path(entry["path"]), seconds, summary if isinstance(summary, dict) else {})


def remember(path: Path) -> None:
    """Put a project first in the list. A list that cannot be written is not an error."""
    path, known = path.resolve(), recent_projects()
    summary = next((each.summary for each in known if each.path == path), {})
    _write([RecentProject(path, time.time(), summary), *(each for each in known if each.path != path)])


def summarise(path: Path, summary: Mapping[str, Any]) -> None:
    """Keep the summary of a project of the list."""
    known = recent_projects()
    _write([RecentProject(each.path, each.opened, summary) if each.path == path else each for each in known])


def forget(path: Path) -> None:
    """Take a project out of the list; its files stay."""
    _write([each for each in recent_projects() if each.path != path])


def _write(projects: Sequence[RecentProject]) -> None:
    rows = [{"path": str(p.path), "opened": p.opened, "summary": dict(p.summary)} for p in projects[:MAX_PROJECTS]]
    with suppress(OSError):
        recent_file().parent.mkdir(parents=True, exist_ok=True)
        write_whole(recent_file(), json.dumps(rows))

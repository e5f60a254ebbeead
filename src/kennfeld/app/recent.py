"""Projects that were opened before, in a file of the user's own folder."""

import json
from contextlib import suppress
from pathlib import Path

from kennfeld.atomic_files import write_whole

MAX_PROJECTS = 20


def recent_file() -> Path:
    """Return where the list is kept."""
    return Path.home() / ".kennfeld" / "recent.json"


def recent_projects() -> list[Path]:
    """Return the projects that still exist, the last one first; a damaged list is empty."""
    try:
        paths = json.loads(recent_file().read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    known = [Path(path) for path in paths if isinstance(path, str)] if isinstance(paths, list) else []
    return [path for path in known if path.is_file()][:MAX_PROJECTS]


def remember(path: Path) -> None:
    """Put a project first in the list. A list that cannot be written is not an error."""
    path = path.resolve()
    paths = [path, *(other for other in recent_projects() if other != path)][:MAX_PROJECTS]
    with suppress(OSError):
        recent_file().parent.mkdir(parents=True, exist_ok=True)
        write_whole(recent_file(), json.dumps([str(each) for each in paths], indent=1))

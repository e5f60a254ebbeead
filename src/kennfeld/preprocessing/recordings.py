"""Finds the files that a dataset names."""

from collections.abc import Sequence
from pathlib import Path

from kennfeld.formatting import nearest

__all__ = ["CACHE", "default_name", "matching", "near"]

CACHE = Path(".kennfeld") / "cache"  # beside the project file; what was read of files that take long


def matching(folder: Path, pattern: str) -> list[str]:
    """The files that a pattern matches, sorted; a sheet behind a `#` stays with each."""
    whole, mark, sheet = pattern.rpartition("#")
    for part, rest in ((pattern, ""), (whole, f"#{sheet}")):
        if not part or (rest and not mark):
            continue
        if (folder / part).is_file():
            return [f"{folder / part}{rest}"]
        found = sorted(path for path in _globbed(folder, part) if path.is_file() and not _is_kept(path))
        if found:
            return [f"{path}{rest}" for path in found]
    return []


def _is_kept(path: Path) -> bool:
    """Whether a file is no recording, but what the cache keeps of one."""
    return path.parts[-3:-1] == CACHE.parts


def _globbed(folder: Path, pattern: str) -> list[Path]:
    start = Path(pattern)
    try:
        if start.is_absolute():
            return list(Path(start.anchor).glob(str(start.relative_to(start.anchor))))
        return list(folder.glob(pattern))
    except (ValueError, NotImplementedError, OSError, IndexError):  # what pathlib says of patterns it cannot use
        return []


def near(folder: Path, pattern: str) -> str:
    """The mend where a pattern matches nothing."""
    path = folder / pattern.partition("#")[0]
    if not path.parent.is_dir():
        return f"There is no folder {path.parent}."
    return nearest(path.name, (other.name for other in path.parent.iterdir())) or f"Paths start in {folder}."


def default_name(paths: Sequence[str], pattern: str) -> str:
    """The stem of the file; of several files, what their pattern says without its wildcards."""
    name = Path((paths[0] if len(paths) == 1 else pattern).partition("#")[0]).name
    stem = Path(name.removesuffix(".gz")).stem
    plain = stem.strip("*?_- .") if len(paths) > 1 else stem
    return plain or Path(paths[0]).stem

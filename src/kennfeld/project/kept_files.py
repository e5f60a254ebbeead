"""Files that are kept between runs only to save time: recordings that were read, and compiled code."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.machine_code.code_cache import cache_folder
from kennfeld.base.output_paths import is_link
from kennfeld.preprocessing.prepared_files import ENDING
from kennfeld.preprocessing.recordings import CACHE
from kennfeld.project.project import Project

_HEXADECIMAL = frozenset("0123456789abcdef")


@dataclass(frozen=True)
class KeptFiles:
    """The files of one kind in a folder; no others in it are counted or removed.

    Attributes:
        kind: what they keep.
        folder: where they are.
        files: those that are there now, with their sizes in bytes.
    """

    kind: str
    folder: Path
    files: tuple[tuple[Path, int], ...]

    @classmethod
    def of(cls, kind: str, folder: Path, *patterns: str) -> "KeptFiles":
        """Return the files whose names match a pattern and begin with a digest; links are left alone."""
        return cls(kind, folder, tuple(_files(folder, patterns)))

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(size for _, size in self.files)

    def remove(self) -> None:
        """Remove the files, as far as other processes, which may use or remove them as well, allow it."""
        for path, _ in self.files:
            with suppress(OSError):
                path.unlink(missing_ok=True)


def kept_files(path: Path | None = None) -> list[KeptFiles]:
    """Return what is kept for a project, and the compiled code of this user.

    Args:
        path: the project file, or its folder; without it only the compiled code.

    Raises:
        InputError: the project file cannot be read.
    """
    kept = []
    if path is not None:
        project = Project.read(path / "kennfeld.toml" if path.is_dir() else path)
        kept += [
            KeptFiles.of("recordings that were read", project.file.folder / CACHE, "*.parquet", "*.json"),
            KeptFiles.of("partitions", project.prepared_files.folder, f"*{ENDING}"),
        ]
    code = cache_folder()
    return kept if code is None else [*kept, KeptFiles.of("compiled code", code, "*")]


def _files(folder: Path, patterns: tuple[str, ...]) -> Iterator[tuple[Path, int]]:
    if is_link(folder):
        return
    for path in sorted({path for pattern in patterns for path in folder.glob(pattern)}):
        name = path.name.removeprefix(".")  # half written by a process that was killed
        digest = name.partition("-")[0].partition(".")[0]
        with suppress(OSError):
            if len(digest) >= 40 and set(digest) <= _HEXADECIMAL and path.is_file() and not is_link(path):
                yield path, path.stat().st_size

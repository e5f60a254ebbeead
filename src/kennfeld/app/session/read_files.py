"""The files that a project was read from, so that the session notices what other programs change in them."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from kennfeld.app.session.files_on_disk import DiskChange
from kennfeld.app.session.recorded_data import matching_files
from kennfeld.base.file_state import FileVersion, opened_files
from kennfeld.project.schema import ProjectFile


class ReadFiles:
    """The files that were opened when the project was read last, and those that its patterns matched.

    Args:
        folder: the folder of the project.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._opened: list[FileVersion] = []
        self._matching: tuple[ProjectFile, tuple[str, ...]] | None = None

    def forget(self) -> None:
        """Forget all files: their changes are known."""
        self._opened, self._matching = [], None

    @contextmanager
    def note(self) -> Iterator[None]:
        """Note the files that are opened within the block, in place of those before; none is matched yet."""
        self._matching = None
        with opened_files() as opened:
            yield
        self._opened = [FileVersion.seen(*item) for item in opened.items() if not item[0].is_dir()]

    def note_matching(self, file: ProjectFile) -> None:
        """Note the files that the patterns of a project match now."""
        self._matching = file, matching_files(file)

    def note_written(self, path: Path) -> None:
        """Note that the session wrote a file itself, which is not a change by another program."""
        self._opened = [file.now() if file.path == path else file for file in self._opened]

    def versions(self, own: Collection[Path]) -> tuple[tuple[object, ...], ...]:
        """Return what tells the files from others under their paths, but for the `own` ones."""
        return tuple(sorted((str(file.path), file.times) for file in self._opened if file.path not in own))

    def changes(self, own: Collection[Path]) -> list[DiskChange]:
        """Return the files, but for the `own` ones, that have changed since the project was read from them.

        Those that match a pattern of the project now, or do not any more, are among them.
        """
        opened = [file for file in self._opened if file.path not in own and not file.is_present]
        changes = {file.path: DiskChange.of(file.path, self._folder, file) for file in opened}
        if self._matching is not None:
            file, before = self._matching
            for path in sorted(set(before).symmetric_difference(matching_files(file))):
                own_path = Path(path).absolute()
                changes.setdefault(own_path, DiskChange.of(own_path, self._folder))
        return list(changes.values())

"""A project and its files on disk: saving, changes by other programs, and edits that survive a crash."""

from collections.abc import Collection

from kennfeld.app.session.edited_project import EditedProject
from kennfeld.app.session.edited_values import moved_axes
from kennfeld.app.session.files_on_disk import Conflict, DiskChange, text_or_none
from kennfeld.app.session.saved_values import VALUES, KeyChange, naming_changes, values_to_save, write_edits
from kennfeld.app.session.state import Restore, SessionState, SetKeys, inverse
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.domain.parameter_set import ParameterSet


class SavedProject(EditedProject):
    """A project that is being edited, with what is saved of it."""

    @property
    def conflicts(self) -> list[Conflict]:
        """The files that saving would replace although another program has changed them since they were read."""
        names, values = [*self._edited_texts(self.state)], self._changed_values()
        if values is not None:
            names += [VALUES, *([self.path.name] if self._naming(self.state.values) else [])]
        return self._files.conflicts(names, self.state.texts)

    def save(self, *, replace: bool = False) -> None:
        """Write edited texts, and values that differ from the initial files.

        Values are written to `VALUES` beside the project, which then is the last of the initial files.

        Args:
            replace: also write files that another program has changed since they were read.

        Raises:
            InputError: a file cannot be written, or another program has changed it.
        """
        # before anything is written
        if not replace and (conflicts := self.conflicts):
            message = "another program has changed it since it was read"
            raise InputError(Finding(Location(each.file), message, "Compare both first.") for each in conflicts)
        values = self._changed_values()
        if values is not None:
            # changes the text of the project file, which is written below
            self._name_values(self.state.values)
        folder = self.path.parent
        write_edits(folder, self._edited_texts(self.state), values)
        if values is not None:
            self._read_files.note_written(folder / VALUES)
        self.saved = self.state
        self._files.read(self.state.texts)
        self._renew(texts=True)
        self.recovery.remove()

    @property
    def changed_on_disk(self) -> bool:
        """True if another program has changed a text since it was read or saved, or another file of the project."""
        return bool(self.disk_changes)

    @property
    def disk_changes(self) -> tuple[DiskChange, ...]:
        """The files of the project that another program has changed since they were read or saved, and how."""
        return (*self._files.changed(self.state.texts), *self._data_changes())

    def reload(self) -> None:
        """Take over the texts on disk, as a command that can be undone."""
        folder = self.path.parent
        texts = {name: text_or_none(folder / name) for name in self.state.texts}
        self._files.read(texts)
        self._forget_changes()
        # what is on disk is the saved state, also after an undo
        self.saved = SessionState({name: text for name, text in texts.items() if text is not None}, self.saved.values)
        if texts != self.state.texts:
            self.do(Restore("Read from disk", texts=texts))
        else:
            self.refresh()

    def recover(self, *, discard: bool = False) -> None:
        """Take over the edits of a session that ended without saving, or forget them; nothing if there are none."""
        if not self.recoverable:
            return
        kept, self.recoverable = None if discard else self.recovery.read(), False
        self.recovery.remove()
        if kept is not None:
            self._files.known.update(kept.known)  # what has changed meanwhile is a conflict
            self.do(kept.edits, tables=kept.tables)

    def discard(self) -> None:
        """Take back everything that is not saved, as a command that can be undone."""
        self.do(inverse(self.saved, self.state, "Discarded the edits"))
        self.saved = self.state
        self.recovery.remove()

    def _changed_values(self) -> ParameterSet | None:
        """Return what `VALUES` is to hold: the edited parameters, and those saved before; None if none are edited."""
        if self.view is None:
            return None
        return values_to_save(self.state.values, self.view.now.parameters, self.settings, self.path.parent)

    def _name_values(self, names: Collection[str]) -> None:
        """Make the file of values the last of the initial files, and remove keys that would override its values."""
        if changes := self._naming(names):
            self.history.amend(SetKeys("Saved", self.path.name, changes))

    def _naming(self, names: Collection[str]) -> list[KeyChange]:
        """Return the changes of the project file by which values of these parameters are read from their file."""
        start, now = (each.parameters for each in (self.require_view().start, self.require_view().now))
        return naming_changes(self.settings, [name for name in names if name in now], moved_axes(start, now))

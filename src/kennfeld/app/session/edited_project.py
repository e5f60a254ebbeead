"""A project that is being edited: the history of its texts and values, and the model that follows every edit."""

import itertools
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from kennfeld.app.session.activity import Activity, StoppedError
from kennfeld.app.session.consents import require_scheduler, undecided_requests, undecided_scheduler
from kennfeld.app.session.files_on_disk import DiskChange, FilesOnDisk, read_exactly
from kennfeld.app.session.initial_files import initial_names
from kennfeld.app.session.live_model import LiveModel, LiveScore
from kennfeld.app.session.partitioned_data import count_samples
from kennfeld.app.session.project_function import FunctionReader, formula_file
from kennfeld.app.session.project_recordings import ProjectRecordings
from kennfeld.app.session.read_files import ReadFiles
from kennfeld.app.session.recovery import Recovery
from kennfeld.app.session.saved_values import VALUES
from kennfeld.app.session.state import Command, History, SessionState, SetKeys, same_values
from kennfeld.app.session.view import View
from kennfeld.base.dask_runner import DaskRunner
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.models import Model
from kennfeld.models.code_consent import ConsentRequest, allow
from kennfeld.project import Project
from kennfeld.project.document import ProjectDocument

_T = TypeVar("_T")  # Python 3.11

_REVISIONS = itertools.count(time.time_ns() // 1000)  # never the same, also after a restart


class EditedProject:
    """A project with the edits of its texts and values, evaluated after each of them.

    Args:
        path: the project file.
        activity: told of what takes a while, such as the reading of recordings.
    """

    def __init__(self, path: Path, activity: Activity | None = None) -> None:
        self.path, self._activity = path, activity or Activity()
        self.history = History(SessionState({path.name: read_exactly(path)}))
        self.saved = self.history.state
        self._files = FilesOnDisk(path.parent, self.saved.texts, VALUES)
        self.project: Project | None = None
        self.findings: tuple[Finding, ...] = ()
        self._own_findings: tuple[Finding, ...] = ()  # of the project, without its edited values
        self.view: View | None = None  # of the last texts without errors
        self.stale = False  # the texts have errors since
        self.undecided: tuple[ConsentRequest, ...] = ()  # what may not run or be used yet
        self._read_files = ReadFiles(path.parent)
        # files that have been read again, but not because the user asked for it
        self._read_again: tuple[Finding, ...] = ()
        self._function = FunctionReader(path)
        self._held: dict[str, str] = {}  # texts of files before a command replaced them
        self._recordings = ProjectRecordings(self._activity)
        self.interrupted = False  # the user has stopped the reading of the recordings
        self.last: tuple[LiveScore, ...] = ()  # before the last change, whatever was evaluated since
        self.revision = next(_REVISIONS)  # changes with the values and the texts
        self.text_revision = self.revision  # changes with the texts
        self.seconds = 0.0  # that the last edit took to compute
        self._settings: tuple[str, dict[str, Any]] | None = None  # of the last text
        self.recoverable = self.recovery.exists  # a session ended without saving
        self._assemble()

    @property
    def state(self) -> SessionState:
        """The present state."""
        return self.history.state

    @property
    def parameters(self) -> ParameterSet:
        """The present values of all parameters. Raises `InputError` if the project cannot be read."""
        return self.require_view().now.parameters

    def require_view(self) -> View:
        """Return the view of the project. Raises `InputError` with all findings if it cannot be read."""
        if self.view is None:
            raise InputError(self.findings)
        return self.view

    def do(self, command: Command, drag: str = "", tables: Mapping[str, Parameter] | None = None) -> None:
        """Apply a command and recompute what depends on it. Commands of one `drag` are one entry of the history.

        `tables` are those for which the values of the command were given; by default the present ones.
        """
        joined = self.history.joins(drag)

        def change() -> None:
            before = self.state.texts.keys()
            self.history.do(command, drag, tables)
            self._hold_replaced(self.state.texts.keys() - before)

        self._change(change, joined=joined)

    def _hold_replaced(self, names: Collection[str]) -> None:
        """Let earlier states hold files that a command has replaced for the first time."""
        self._files.note(names)
        texts = {name: text for name in names if (text := self._files.known[name]) is not None}
        if texts:
            self._held |= texts
            self.saved = self.history.hold(texts, self.saved)

    def key_command(self, title: str, changes: Sequence[tuple[Sequence[str | int], Any]]) -> SetKeys:
        """Return a command that sets keys of the project file; a value that was saved gets its notation back."""
        name = self.path.name
        return SetKeys(title, name, changes, self.saved.texts.get(name, ""))

    def undo(self) -> str:
        """Take the last command back; return its title."""
        return self._change(self.history.undo)

    def redo(self) -> str:
        """Bring back what was undone; return its title."""
        return self._change(self.history.redo)

    def _change(self, change: Callable[[], _T], *, joined: bool = False) -> _T:
        """Change the history, recompute what depends on the state, and keep unsaved edits.

        Scores are compared with those before the change; if `joined`, with those before the drag that it belongs to.
        """
        scores = () if self.view is None else self.view.now.scores
        before, outcome = self.state, change()
        self._files.note(self.state.texts)
        self._follow(before)
        if not joined:
            self.last = scores
        if self.view is not None and not self.stale:
            now, values = self.view.now.parameters, self.state.values
            self.history.note_tables({name: now[name] for name in values if name in now})
        # edits of an earlier session wait in the file until the user decides on them
        if not self.recoverable:
            self.recovery.write(self.saved, self.state, self._files.known)
        return outcome

    def require_evaluable(self) -> View:
        """Return the view of the project as it is on disk and edited.

        Raises:
            InputError: the project has errors, or files have changed since they were read.
        """
        if changes := self._data_changes():
            # what a run is based on is not exchanged without a word
            remedy = "Read the files again first."
            raise InputError(
                Finding(Location(each.file), f"{each.change} since it was read", remedy) for each in changes
            )
        if self.stale:
            raise InputError(self.findings)
        return self.require_view()

    @property
    def subject(self) -> tuple[object, ...]:
        """The values, texts and files that an outcome is about; equal to that of a state to which an undo leads."""
        # a text that is held because a later state replaces it is that of the file
        texts = {name: text for name, text in self.state.texts.items() if text != self._held.get(name)}
        return replace(self.state, texts=texts), self._read_files.versions({self.path.parent / name for name in texts})

    @property
    def unsaved_texts(self) -> dict[str, str]:
        """Return the texts that differ from the saved ones, as they are read from files: without mark and with LF."""
        return self._unsaved_texts(self.state)

    def _unsaved_texts(self, state: SessionState) -> dict[str, str]:
        edited = self._edited_texts(state)
        return {name: text.removeprefix("\ufeff").replace("\r\n", "\n") for name, text in edited.items()}

    def _edited_texts(self, state: SessionState) -> dict[str, str]:
        return {name: text for name, text in state.texts.items() if text != self.saved.texts.get(name)}

    def note_shown(self, file: str, text: str) -> None:
        """Note the text of a file that a page shows, from which its edits begin."""
        if file not in self.state.texts:
            self._files.known[file] = text

    def text_of(self, file: str) -> str:
        """Return the text of a file of the project as edited, or as it is on disk."""
        return self.state.texts[file] if file in self.state.texts else read_exactly(self.path.parent / file)

    @property
    def settings(self) -> dict[str, Any]:
        """The tables of the project file, also if they are incomplete; empty if the text is not valid TOML."""
        text = self.state.texts[self.path.name]
        if self._settings is None or self._settings[0] != text:  # every page asks after every edit
            try:
                self._settings = text, ProjectDocument(text, self.path).get()
            except InputError:
                self._settings = text, {}
        return self._settings[1]

    @property
    def has_edits(self) -> bool:
        """True if something is not saved."""
        return self.state != self.saved

    @property
    def formula_file(self) -> str:
        """Name of the formula file, empty if the function is something else."""
        return formula_file(self.settings)

    @property
    def function(self) -> Model | None:
        """The function; of formula text also if its parameters are not defined yet. None if it cannot be read."""
        if self.view is not None and not self.stale:
            return self.view.model.problem.model
        file = self.formula_file
        try:
            if file:
                return self._function.of_text(self.settings, self.text_of(file))
        except InputError:
            return None
        # code that may not run yet does not run for the names of its inputs either
        return None if self.undecided else self._function.imported(self.settings, self.text_revision)

    def read_trial(self, command: Command) -> Project:
        """Read the project as it would be after a command, with the recordings that are known.

        Raises:
            InputError: it would have errors.
        """
        texts = self._unsaved_texts(command.apply(self.state))
        return self._recordings.provide(Project.read(self.path, texts))

    @property
    def initial_names(self) -> list[str]:
        """Names of the parameters that the initial files provide."""
        if self.view is not None and not self.stale:
            return list(self.view.start.parameters)
        return list(initial_names(self.settings, self.path).names)

    def _data_changes(self) -> list[DiskChange]:
        """Return the files, but for texts that are edited here, that have changed since the project was read."""
        return self._read_files.changes({self.path.parent / name for name in self.saved.texts})

    @property
    def recovery(self) -> Recovery:
        """The file that keeps unsaved edits."""
        return Recovery(self.path)

    def _renew(self, *, texts: bool = False) -> None:
        """Mark the values, and if `texts` the texts, as others than those that pages have seen."""
        self.revision = next(_REVISIONS)
        if texts:
            self.text_revision = self.revision

    def _follow(self, before: SessionState) -> None:
        """Recompute after the state has changed."""
        # other texts are another problem; other values are evaluated with the one that stands
        if before.texts != self.state.texts:
            self._assemble()
        elif not same_values(before.values, self.state.values):
            self._evaluate()

    def refresh(self) -> None:
        """Read the project again, after files that it names have changed."""
        self._forget_changes()
        self._assemble()

    def _forget_changes(self) -> None:
        """Forget what has changed on disk since the project was read: the user knows."""
        self._read_files.forget()
        self._read_again = ()

    def allow_code(self, digests: Collection[str]) -> None:
        """Keep that the user allows files with these contents to run, or these addresses, and evaluate the project."""
        for request in self.undecided:
            if request.digest in digests:
                allow(request.digest)
        self.refresh()

    def _assemble(self) -> None:
        """Read the project again and build its model; files that change meanwhile are found changed."""
        self._read_again += tuple(
            Finding(
                Location(each.file),
                f"{each.change} since the project was opened, and was read again",
                severity="warning",
            )
            for each in self._data_changes()
        )
        with self._read_files.note():
            self._read_project()

    def _read_project(self) -> None:
        self._renew(texts=True)
        self.undecided, self.interrupted = (), False
        try:
            project = Project.read(self.path, self.unsaved_texts)
            self._read_files.note_matching(project.file)
            # before code of the function runs, and before recordings at an address are read
            self._require_consent(project)
            project = self._recordings.provide(project)
            self.project, self._own_findings = project, (*self._read_again, *project.check())
            self.findings = self._own_findings
            problem = project.problem()
            self._activity.say(f"Evaluating the function over {sum(data.samples for data in problem.datasets)} samples")
            self.view, self.stale = View(LiveModel(problem), self._recordings.further_channels), False
        except StoppedError:
            message = "the recordings were not read, as you stopped it"
            finding = Finding(Location(self.path.name), message, "Read them to go on.")
            self.findings, self.stale, self.interrupted = (finding,), True, True
            return
        except InputError as error:
            # the last view stays, so that pages go on showing something while a text is being edited
            self.findings, self.stale = (*error.findings, *self._formula_errors(error.findings)), True
            return
        if self.state.values:
            self._evaluate()

    def _formula_errors(self, known: Collection[Finding]) -> tuple[Finding, ...]:
        """Return what is wrong in formula text beside what is known; nothing if its file cannot be read."""
        file = self.formula_file
        with suppress(InputError):
            return self._function.errors(self.settings, self.text_of(file), known) if file else ()
        return ()

    def _require_consent(self, project: Project) -> None:
        """Raise `InputError` if the project runs code, or reads from addresses, that the user has not allowed.

        The scheduler is asked for at the same time; it is joined by runs only.
        """
        file = self.formula_file
        undecided = undecided_requests(project, self.text_of(file) if file else None)
        self.undecided = (*undecided, *undecided_scheduler(project.file, project.cluster_address))
        if undecided:
            raise InputError(request.finding for request in self.undecided)

    @contextmanager
    def evaluated(self) -> Iterator[Project]:
        """Yield the project for an evaluation of all samples, with partitions on the cluster of `[cluster]`.

        Raises:
            InputError: the project cannot be read, or the cluster cannot be joined.
        """
        self.require_view()
        assert self.project is not None
        address = self.project.cluster_address
        if address is None or not self.project.is_partitioned:
            yield self.project
            return
        require_scheduler(self.project.file, address)
        runner = DaskRunner.start(address)
        try:
            yield self.project.evaluated_by(runner)
        finally:
            runner.close()

    @property
    def reads_partitions(self) -> bool:
        """True if the project file asks for partitions, also if it has errors."""
        cluster = self.settings.get("cluster")
        if not isinstance(cluster, dict):
            return False
        return bool(cluster.get("partition", cluster.get("scheduler")))

    @property
    def excerpt(self) -> tuple[int, int] | None:
        """Number of samples that the session holds, and that of all partitions; None if it holds all."""
        problem = None if self.view is None else self.view.model.problem
        if problem is None or problem.partitions is None:
            return None
        own, whole = sum(data.samples for data in problem.datasets), count_samples(problem)
        return (own, whole) if own < whole else None

    def _evaluate(self) -> None:
        """Evaluate the model at the present values."""
        self._renew()
        if self.view is not None:
            began = time.perf_counter()
            findings = self.view.follow(self.state.values, self.state.tables)
            if not self.stale:
                self.findings = (*self._own_findings, *findings)
            self.seconds = time.perf_counter() - began

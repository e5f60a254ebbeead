"""An open project: its history, the model that follows every edit, and its runs."""

import itertools
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from kennfeld.analysis.validation_result import CrossValidation
from kennfeld.app.session.activity import Activity, StoppedError
from kennfeld.app.session.consents import require_scheduler, undecided_requests, undecided_scheduler
from kennfeld.app.session.edited_values import moved_axes, moved_breakpoints
from kennfeld.app.session.files_on_disk import Conflict, DiskChange, FilesOnDisk, read_exactly, text_or_none
from kennfeld.app.session.initial_files import initial_names
from kennfeld.app.session.job_runner import JobRunner
from kennfeld.app.session.live_model import LiveModel, LiveScore
from kennfeld.app.session.part_fit import FittedPart, part_options, part_problem
from kennfeld.app.session.partitioned_data import count_samples
from kennfeld.app.session.project_function import FunctionReader, formula_file
from kennfeld.app.session.project_recordings import ProjectRecordings
from kennfeld.app.session.read_files import ReadFiles
from kennfeld.app.session.recovery import Recovery
from kennfeld.app.session.reference_set import ReferenceSet
from kennfeld.app.session.rounding import SetRounding
from kennfeld.app.session.run_checkpoints import RunCheckpoints
from kennfeld.app.session.run_job import Ended, RunTask, Validation
from kennfeld.app.session.runs import Job, Run, ValidationRun
from kennfeld.app.session.saved_values import VALUES, KeyChange, naming_changes, values_to_save, write_edits
from kennfeld.app.session.side_work import SideWork
from kennfeld.app.session.state import (
    Command,
    History,
    Restore,
    SessionState,
    SetKeys,
    SetTables,
    SetValues,
    inverse,
    same_values,
)
from kennfeld.app.session.surrogate_training import SurrogateTraining
from kennfeld.app.session.value_edits import ValueEdit
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Float
from kennfeld.base.dask_runner import DaskRunner
from kennfeld.base.errors import ArgumentError, Finding, InputError, Location
from kennfeld.domain.free_axes import AXIS_LABEL
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.models import Model
from kennfeld.models.code_consent import ConsentRequest, allow
from kennfeld.project import Project
from kennfeld.project.document import ProjectDocument

_T = TypeVar("_T")  # Python 3.11

_REVISIONS = itertools.count(time.time_ns() // 1000)  # never the same, also after a restart


class Session:
    """One open project.

    All methods are called from one thread.

    Args:
        path: the project file.
        changed: called from another thread when a running job has reported something, for `pump` to handle.
        activity: called with the progress of what takes a while, such as the reading of recordings.
    """

    def __init__(
        self, path: Path, changed: Callable[[], object] = lambda: None, activity: Activity | None = None
    ) -> None:
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
        self._read_again: tuple[
            Finding, ...
        ] = ()  # files that have been read again, but not because the user asked for it
        self._function = FunctionReader(path)
        self._held: dict[str, str] = {}  # texts of files before a command replaced them
        self._recordings = ProjectRecordings(self._activity)
        self.interrupted = False  # the user has stopped the reading of the recordings
        self.last: tuple[LiveScore, ...] = ()  # before the last change, whatever was evaluated since
        self.revision = next(_REVISIONS)  # changes with the values and the texts
        self.text_revision = self.revision  # changes with the texts
        self.seconds = 0.0  # that the last edit took to compute
        self.runs: list[Run] = []
        self.validations: list[ValidationRun] = []
        # what present values are compared with, see `reference_set`
        self.chosen_reference: ReferenceSet | None = None
        # by set and method, with the revision that they belong to
        self.roundings: dict[tuple[str, str, str], tuple[int, SetRounding]] = {}
        self._runner = JobRunner(changed)
        self.training = SurrogateTraining(changed)
        # their outcomes are those of `term_search` and `design_work`, which know this module
        self.term_search: SideWork[Any] = SideWork(changed)
        self.design_work: SideWork[Any] = SideWork(changed)
        self.waiting: list[ValueEdit] = []  # edits that were made during the running calibration
        self._settings: tuple[str, dict[str, Any]] | None = None  # of the last text
        self.recoverable = self.recovery.exists  # a session ended without saving
        self._assemble()

    @property
    def state(self) -> SessionState:
        """The present state."""
        return self.history.state

    @property
    def job(self) -> Job:
        """The running or last calibration or cross-validation, as it is shown."""
        return self._runner.job

    @property
    def parameters(self) -> ParameterSet:
        """The present values of all parameters. Raises `InputError` if the project cannot be read."""
        return self.require_view().now.parameters

    @property
    def validation(self) -> CrossValidation | None:
        """The last cross-validation, None if there was none."""
        return self.validations[-1].result if self.validations else None

    def require_view(self) -> View:
        """Return the view of the project. Raises `InputError` with all findings if it cannot be read."""
        if self.view is None:
            raise InputError(self.findings)
        return self.view

    @property
    def last_whole_run(self) -> Run | None:
        """The last run in which all values were free; None if there was none."""
        return next((run for run in reversed(self.runs) if not run.part), None)

    def compare_with(self, reference: ReferenceSet | None) -> None:
        """Compare the present values with a set; None takes the last run, or the start."""
        self.chosen_reference = reference
        self.revision = next(_REVISIONS)

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

    def edit(self, edit: ValueEdit) -> None:
        """Edit values of a parameter; during a calibration, whose values replace the present ones, at its end.

        Raises:
            ArgumentError: there is no such parameter, or it has fewer values.
        """
        if edit.name not in self.parameters:
            raise ArgumentError(f"{edit.name[:100]} is not a parameter of the project")
        if self.project is not None and edit.name in self.project.surrogates:
            raise ArgumentError(f"{edit.name} is a surrogate, whose values are trained, not edited")
        values = edit.apply(self.parameters[edit.name])
        if not self.is_calibrating:
            self.do(SetValues(edit.title, edit.name, values), edit.drag)
            return
        joined = self.waiting[-1].joined(edit) if self.waiting else None
        self.waiting[len(self.waiting) - bool(joined) :] = [joined or edit]
        self.revision = next(_REVISIONS)

    def undo(self) -> str:
        """Take the last command back, or the last edit that waits for the end of a calibration; return its title."""
        if self.waiting:
            self.revision = next(_REVISIONS)
            return self.waiting.pop().title
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

    def run(
        self,
        *,
        resume: bool = False,
        workers: int | None = None,
        validation: Validation | None = None,
        part: FittedPart | None = None,
    ) -> None:
        """Start a calibration or a cross-validation from the present values.

        Args:
            resume: continue an interrupted run from its checkpoints.
            workers: number of processes for several starts, by default one per core.
            validation: cross-validate instead of calibrating.
            part: fit these values only; all others are held.

        Raises:
            ArgumentError: a run is in progress, or nothing of the part may be fitted.
            InputError: the project has errors, or there is no checkpoint.
        """
        if self._runner.running is not None:
            raise ArgumentError("a run is in progress; stop it first")
        view = self.require_evaluable()
        assert self.project is not None
        problem = replace(view.model.problem, parameters=view.now.parameters)
        options = replace(self.project.options, workers=workers)
        if part is not None:
            last = self.last_whole_run
            problem = part_problem(problem, part, None if last is None else last.result)
            options = part_options(options)
        points = self.checkpoints.points().states if resume else {}
        joins = self.project.is_partitioned or bool(self.project.file.cluster.scheduler)
        cluster = self.project.cluster_address if joins else None
        require_scheduler(self.project.file, cluster)
        saves = None if validation or part else self.checkpoints
        task = RunTask(problem, options, saves, points, validation, cluster)
        self._runner.start(task, "" if part is None else part.title)

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
    def checkpoints(self) -> RunCheckpoints:
        """Where runs are kept, so that an interrupted one can be resumed."""
        return RunCheckpoints(self.path, 0 if self.project is None else self.project.file.optimizer.save_every)

    @property
    def resumable(self) -> str:
        """A sentence on an interrupted run that can be resumed; empty if there is none."""
        starts = 1 if self.project is None else self.project.file.optimizer.starts
        return self.checkpoints.describe(starts, died=self.job.state == "failed")

    def stop(self) -> None:
        """Stop the running calibration at its best values."""
        self._runner.stop()

    def close(self) -> None:
        """End a running calibration, training or search."""
        for work in self._works:
            work.stop()
        self._runner.kill()

    def pump(self) -> None:
        """Handle the reports of the running job, training and searches."""
        self.term_search.pump()
        self.design_work.pump()
        if self.training.pump():
            self.refresh()
        for end in self._runner.ended():
            self._end(end)
            self._apply_waiting()
            if changes := self._data_changes():
                changed = "; ".join(map(str, changes))
                self.job.message += f" Since its data were read, files have changed: {changed}."

    def _end(self, end: Ended) -> None:
        """Take over the values of a run that has ended."""
        job = self.job
        job.preview = {}
        if end.validation is not None:
            self.validations.append(ValidationRun(len(self.runs), end.validation))
            self.revision = next(_REVISIONS)
            job.state, job.message = "validated", " ".join(end.validation.summary())
            return
        if end.result is None:
            job.state, job.message = "failed", end.reason or " ".join(map(str, end.findings))
            return
        result, view = end.result, self.require_view()
        # the whole trace in place of the steps that were reported, some of which were skipped
        job.state, job.message, job.trace = result.status, result.message, list(result.trace)
        run = Run(len(self.runs) + 1, view.now.parameters, result, job.problem, end.extrapolation, part=job.part)
        self.runs.append(run)
        if run.part:
            job.message += f" Only {run.part} was fitted."
        elif result.converged:
            self.checkpoints.remove()
        self.revision = next(_REVISIONS)
        free = view.model.problem.free_names
        tables = {name: result.parameters[name] for name in free if name in result.parameters}
        title = f"Run {run.number}: {run.part}" if run.part else f"Run {run.number}"
        self.do(SetTables(title, self.values_of(result.parameters, tables)), tables=tables)

    def _apply_waiting(self) -> None:
        """Apply the edits that were made during the run to its values; say which of them no table takes any more."""
        waiting, self.waiting = self.waiting, []
        failed = []
        for edit in waiting:
            try:
                self.edit(edit)
            except (ArgumentError, InputError) as error:
                failed.append(f"{edit.title} was not applied: {error}.")
        if waiting:
            done = len(waiting) - len(failed)
            count = f"{done} edit{'' if done == 1 else 's'} that waited {'was' if done == 1 else 'were'} applied."
            self.job.message = " ".join([self.job.message, count, *failed])

    def values_of(self, parameters: ParameterSet, names: Collection[str]) -> dict[str, Float | None]:
        """Return the values of parameters, with the breakpoints of free axes in place of those of an earlier run."""
        values = {name: parameters[name].values for name in names}
        # None for each, which takes away breakpoints that this run does not have
        earlier = dict.fromkeys(name for name in self.state.values if name.startswith(AXIS_LABEL))
        return {**earlier, **values, **moved_breakpoints(parameters)}

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
    def is_calibrating(self) -> bool:
        """True while a calibration runs, at whose end its values become the present ones."""
        return self._runner.is_calibrating

    @property
    def is_busy(self) -> bool:
        """True while a calibration, a training or a search runs."""
        return self._runner.running is not None or any(work.state == "running" for work in self._works)

    @property
    def _works(self) -> tuple[SurrogateTraining | SideWork[Any], ...]:
        """The work beside the calibration."""
        return self.training, self.term_search, self.design_work

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
        self.revision = self.text_revision = next(_REVISIONS)
        self.recovery.remove()

    @property
    def changed_on_disk(self) -> bool:
        """True if another program has changed a text since it was read or saved, or another file of the project."""
        return bool(self.disk_changes)

    @property
    def disk_changes(self) -> tuple[DiskChange, ...]:
        """The files of the project that another program has changed since they were read or saved, and how."""
        return (*self._files.changed(self.state.texts), *self._data_changes())

    def _data_changes(self) -> list[DiskChange]:
        """Return the files, but for texts that are edited here, that have changed since the project was read."""
        return self._read_files.changes({self.path.parent / name for name in self.saved.texts})

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

    @property
    def recovery(self) -> Recovery:
        """The file that keeps unsaved edits."""
        return Recovery(self.path)

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

    def _follow(self, before: SessionState) -> None:
        """Recompute after the state has changed."""
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
        self.revision = self.text_revision = next(_REVISIONS)
        self.undecided, self.interrupted = (), False
        try:
            project = Project.read(self.path, self.unsaved_texts)
            self._read_files.note_matching(project.file)
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
        self.revision = next(_REVISIONS)
        if self.view is not None:
            began = time.perf_counter()
            findings = self.view.follow(self.state.values, self.state.tables)
            if not self.stale:
                self.findings = (*self._own_findings, *findings)
            self.seconds = time.perf_counter() - began

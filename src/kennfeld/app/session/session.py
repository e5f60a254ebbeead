"""An open project with its runs: calibrations, cross-validations, and the work beside them."""

from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

from kennfeld.analysis.validation_result import CrossValidation
from kennfeld.app.session.activity import Activity
from kennfeld.app.session.consents import require_scheduler
from kennfeld.app.session.edited_values import moved_breakpoints
from kennfeld.app.session.job_runner import JobRunner
from kennfeld.app.session.part_fit import FittedPart, part_options, part_problem
from kennfeld.app.session.reference_set import ReferenceSet
from kennfeld.app.session.rounding import SetRounding
from kennfeld.app.session.run_checkpoints import RunCheckpoints
from kennfeld.app.session.run_job import Ended, RunTask, Validation
from kennfeld.app.session.runs import Job, Run, ValidationRun
from kennfeld.app.session.saved_project import SavedProject
from kennfeld.app.session.side_work import SideWork
from kennfeld.app.session.state import SetTables, SetValues
from kennfeld.app.session.surrogate_training import SurrogateTraining
from kennfeld.app.session.value_edits import ValueEdit
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.domain.free_axes import AXIS_LABEL
from kennfeld.domain.parameter_set import ParameterSet


class Session(SavedProject):
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
        super().__init__(path, activity)
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
        self.checked_proposals: object = None  # what the proposals in the results folder were compared with last
        self.design_work: SideWork[Any] = SideWork(changed)
        self.waiting: list[ValueEdit] = []  # edits that were made during the running calibration

    @property
    def job(self) -> Job:
        """The running or last calibration or cross-validation, as it is shown."""
        return self._runner.job

    @property
    def validation(self) -> CrossValidation | None:
        """The last cross-validation, None if there was none."""
        return self.validations[-1].result if self.validations else None

    @property
    def last_whole_run(self) -> Run | None:
        """The last run in which all values were free; None if there was none."""
        return next((run for run in reversed(self.runs) if not run.part), None)

    def compare_with(self, reference: ReferenceSet | None) -> None:
        """Compare the present values with a set; None takes the last run, or the start."""
        self.chosen_reference = reference
        self._renew()

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
        self._renew()

    def undo(self) -> str:
        """Take the last command back, or the last edit that waits for the end of a calibration; return its title."""
        # these edits are the newest ones, though no entry of the history has them yet
        if self.waiting:
            self._renew()
            return self.waiting.pop().title
        return super().undo()

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
        # from what the user sees, with edits that are not saved
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

    @property
    def checkpoints(self) -> RunCheckpoints:
        """The checkpoints of runs, from which an interrupted one can be resumed."""
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
        # what was trained is a file of the project
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
            self._renew()
            job.state, job.message = "validated", " ".join(end.validation.summary())
            return
        if end.result is None:
            job.state, job.message = "failed", end.reason or " ".join(map(str, end.findings))
            return
        result, view = end.result, self.require_view()
        # the whole trace in place of the steps that were reported, some of which were skipped
        job.state, job.message, job.trace = result.status, result.message, list(result.trace)
        number, before = len(self.runs) + 1, view.now.parameters
        run = Run(number, before, result, job.problem, end.extrapolation, part=job.part, seconds=job.seconds)
        self.runs.append(run)
        if run.part:
            job.message += f" Only {run.part} was fitted."
        # any other run can be resumed from them
        elif result.converged:
            self.checkpoints.remove()
        self._renew()
        free = view.model.problem.free_names
        tables = {name: result.parameters[name] for name in free if name in result.parameters}
        title = f"Run {run.number}: {run.part}" if run.part else f"Run {run.number}"
        # a command as those of the user are, so that a run can be undone
        self.do(SetTables(title, self.values_of(result.parameters, tables)), tables=tables)

    def _apply_waiting(self) -> None:
        """Apply the edits that were made during the run to its values; say which of them no table takes any more."""
        waiting, self.waiting = self.waiting, []
        failed = []
        for edit in waiting:
            # an edit of the project may have left a table with fewer values meanwhile
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

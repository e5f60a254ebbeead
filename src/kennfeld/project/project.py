"""A project: a file that defines the function, its data, and how to calibrate it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, fields, replace
from functools import cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from kennfeld.base.consent_gate import require_address
from kennfeld.base.errors import Finding, FindingList, InputError, renamed, warn
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import below, is_below
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.search_settings import SearchSettings
from kennfeld.models.importer_registry import importer_of
from kennfeld.project.schema import ProjectFile, read_project

if TYPE_CHECKING:
    from kennfeld.analysis.missing.proposal import TermProposal, TermProposals
    from kennfeld.analysis.missing.terms import Form
    from kennfeld.base.dask_runner import ClusterAddress
    from kennfeld.base.task_runner import TaskRunner
    from kennfeld.optimize.fit.result import Result
    from kennfeld.optimize.problem.options import Options
    from kennfeld.optimize.problem.problem import Problem
    from kennfeld.preprocessing.pipeline import Loader
    from kennfeld.preprocessing.prepared_files import PreparedFiles
    from kennfeld.preprocessing.recordings import ReadingWatch
    from kennfeld.project.checkpoints import Saves
    from kennfeld.project.problem_builder import ProjectProblem
    from kennfeld.project.simulation import Simulation

_DESIGN = "kennfeld.design"  # lies above this package, and is loaded by its name when it is first used


def _ignore(line: str) -> None:
    """Take a line about progress that nobody reads."""


@dataclass(frozen=True, eq=False)
class Project:
    """A project file: check, calibrate and simulate it.

    Model, data and calibration files are read once, when first needed.

    Attributes:
        path: the project file.
        name: the name of the project.
        formats: formats in which a calibration writes its parameters.
        file: the content of the project file.
        load: reads the recordings.
        report: called with lines of text on the progress.
        watch: receives the progress of reading recordings.
        further_channels: channels that are read although the function does not need them, if recordings have them.

    >>> project = Project.read("kennfeld.toml")
    >>> project.check()
    []
    >>> project.calibrate().status
    'converged'
    """

    path: Path
    name: str
    formats: tuple[str, ...]
    file: ProjectFile = field(repr=False)
    # a factory, so that the class itself has no attribute `load` that is None
    load: "Loader | None" = field(default_factory=lambda: None, repr=False)
    report: Callable[[str], None] = field(default=_ignore, repr=False)
    watch: "ReadingWatch | None" = field(default=None, repr=False)  # of the reading of recordings
    further_channels: tuple[str, ...] = field(default=(), repr=False)

    @classmethod
    def read(cls, path: str | Path, unsaved: Mapping[str, str] | None = None, load: "Loader | None" = None) -> Self:
        """Read a project file, but not the files that it names.

        Args:
            path: the TOML file.
            unsaved: texts that replace those of the project file and of formula files, by name.
            load: reads the recordings; by default, the files that the project names.

        Raises:
            InputError: all problems of the project file.
        """
        file = read_project(Path(path), unsaved)
        return cls(file.path, file.name, file.calibration.output, file, load)

    def __getstate__(self) -> dict[str, Any]:
        # files that were read are kept, processes that evaluate partitions are not
        return {name: value for name, value in self.__dict__.items() if name != "_runner"}

    @property
    def options(self) -> "Options":
        """Settings of the optimizer."""
        from kennfeld.optimize.problem.options import Options

        shared = {part.name: getattr(self.file.optimizer, part.name) for part in fields(SearchSettings)}
        # options alone must not read all files
        steps = self._assembly.steps if self.file.steps else ()
        # with a loader of its own, such as that of the app, the data are in this process
        joins = bool(self.file.cluster.scheduler) and self.load is None
        return Options(**shared, steps=steps, cluster=self._runner if joins else None)

    @property
    def surrogates(self) -> tuple[str, ...]:
        """Names of the surrogates."""
        return tuple(self.file.surrogates)

    @property
    def further_results(self) -> tuple[str, ...]:
        """File extensions of the further results of a calibration."""
        return self.file.calibration.results

    @property
    def is_partitioned(self) -> bool:
        """True if data are evaluated in partitions; their simulation is not a part of the results."""
        if self.load is not None:
            from kennfeld.project.partitioned_loading import PartitionedLoading

            return isinstance(self.load, PartitionedLoading)
        return bool(self.file.cluster.partition_size)

    def change_of_function(self, parameters: ParameterSet, ending: str) -> ParameterSet:
        """Return parameters as a change of the function's file, if files with this ending are copies of it.

        An initial file with the ending takes precedence.
        """
        function, initial = self.file.model.file, self.file.calibration.files
        own = importer_of(function) is not None and function.lower().endswith(ending)
        if not own or any(name.lower().endswith(ending) for name in initial) or self._assembly.problem is None:
            return parameters
        return parameters.from_origin(self._assembly.problem.model.values.origin)

    @property
    def seconds_read(self) -> float:
        """Time spent on reading model, data and calibration files, in s; 0 before they are read."""
        return self._assembly.seconds if "_assembly" in self.__dict__ else 0.0

    @cached_property
    def _assembly(self) -> "ProjectProblem":
        from kennfeld.project.problem_builder import assemble

        if self.load is not None:
            return assemble(self.file, self.load, self.further_channels)
        if self.is_partitioned:
            return self._assembled_in_partitions()
        from kennfeld.preprocessing.pipeline import load_datasets

        return assemble(self.file, partial(load_datasets, watch=self.watch), self.further_channels)

    def _assembled_in_partitions(self) -> "ProjectProblem":
        from kennfeld.project.partitioned_loading import PartitionedLoading
        from kennfeld.project.problem_builder import assemble, failed

        size = self.file.cluster.partition_size
        try:
            loading = PartitionedLoading(self.file.path.name, self._runner, self.prepared_files, size)
        except InputError as error:
            return failed(error.findings)
        return assemble(self.file, loading, self.further_channels)

    @property
    def prepared_files(self) -> "PreparedFiles":
        """The folder of prepared recordings. Raises `InputError` if it is reached by a link, or is not allowed."""
        from kennfeld.preprocessing.prepared_files import PreparedFiles

        cluster = self.file.cluster
        folder = (self.file.folder / cluster.folder).absolute()
        place = self.file.location("cluster", "folder")
        if not is_below(self.file.folder, folder):
            require_address("folder", cluster.folder)
        with convert_errors(str(place), f"{cluster.folder} cannot be written", "Name another folder."):
            below(self.file.folder, folder)
        return PreparedFiles(folder, round(1e9 * cluster.folder_size))

    @cached_property
    def _runner(self) -> "TaskRunner":
        """The evaluation of partitions: in this process, in processes that are started here, or on a cluster."""
        from kennfeld.base.dask_runner import DaskRunner
        from kennfeld.base.task_runner import SerialRunner

        address = self.cluster_address
        return SerialRunner() if address is None else DaskRunner.start(address, self.report)

    @property
    def cluster_address(self) -> "ClusterAddress | None":
        """The cluster of `[cluster]`; None if partitions are evaluated in this process."""
        from kennfeld.base.dask_runner import ClusterAddress

        cluster, folder = self.file.cluster, self.file.folder
        if not cluster.scheduler and (cluster.workers or 1) == 1:
            return None
        names = (cluster.tls_authority, cluster.tls_certificate, cluster.tls_key)
        certificates = tuple(str(folder / name) if name else "" for name in names)
        scheduler = cluster.scheduler
        # a scheduler file of Dask, relative to the project as all files are
        if scheduler and "://" not in scheduler and (folder / scheduler).is_file():
            scheduler = str(folder / scheduler)
        return ClusterAddress(scheduler, cluster.workers or 1, certificates)  # type: ignore[arg-type]

    def evaluated_by(self, runner: "TaskRunner") -> Self:
        """Return the same project with its partitions evaluated by another runner; files are not read again."""
        assembly = self._assembly
        if assembly.problem is None or assembly.problem.partitions is None:
            return self
        project = replace(self)
        partitions = replace(assembly.problem.partitions, runner=runner)
        # a cached property is set, so that files are not read again
        project.__dict__["_assembly"] = replace(assembly, problem=replace(assembly.problem, partitions=partitions))
        return project

    def on_cluster(
        self,
        scheduler: str | None = None,
        workers: int | None = None,
        report: Callable[[str], None] = _ignore,
    ) -> Self:
        """Return the same project on another cluster than `[cluster]` names.

        Args:
            scheduler: address of a Dask scheduler.
            workers: number of processes on this machine, if there is no scheduler.
            report: takes lines about what the cluster does.
        """
        cluster = self.file.cluster
        if scheduler is not None:
            cluster = replace(cluster, scheduler=scheduler, workers=None)
        elif workers is not None and not cluster.scheduler:
            cluster = replace(cluster, workers=workers)
        return replace(self, file=replace(self.file, cluster=cluster), report=report)

    def on_no_cluster(self) -> Self:
        """Return the same project evaluated in this process only."""
        return replace(self, file=replace(self.file, cluster=replace(self.file.cluster, scheduler="", workers=1)))

    def on_no_scheduler(self) -> Self:
        """Return the same project without its scheduler, in processes of this machine if it asks for several."""
        cluster = self.file.cluster
        partition = cluster.partition_size
        # the size is stated, as its default depends on the scheduler
        here = replace(cluster, scheduler="", partition=partition) if cluster.scheduler else cluster
        return replace(self, file=replace(self.file, cluster=here))

    def close(self) -> None:
        """End the processes that evaluate partitions, or leave the cluster."""
        if "_runner" in self.__dict__:
            self._runner.close()
            del self.__dict__["_runner"]

    def check(self) -> FindingList:
        """Return all problems of the project and of the files that it names, errors and warnings, without raising."""
        from kennfeld.project.checks import find_warnings

        assembly = self._assembly
        findings = list(assembly.findings)
        if assembly.problem is not None:
            findings += find_warnings(self.file, assembly.problem, assembly.locations)
        return FindingList(dict.fromkeys(findings))

    def seen_test_data(self) -> list[Finding]:
        """Return a warning for each test dataset with files or samples of the training data.

        Raises `InputError` like `problem`.
        """
        from kennfeld.project.seen_data import seen_test_data

        return seen_test_data(self.file, self.problem(), self._assembly.locations)

    def problem(self) -> "Problem":
        """Return the calibration problem. Raises `InputError` with all findings if one of them is an error."""
        assembly = self._assembly
        if assembly.problem is None:
            raise InputError(assembly.findings)
        return assembly.problem

    def calibrate(
        self,
        progress: Callable[[Any], None] | None = None,
        *,
        folder: str | Path | None = None,
        workers: int | None = None,
        resume: bool = False,
        max_seconds: float | None = None,
    ) -> "Result":
        """Fit the free parameters to the training data.

        Args:
            progress: called with each accepted step; may raise `Stop`.
            folder: the results folder, by default `results` next to the project file. Checkpoints go to its subfolder
                `saves` if `save_every` is set.
            workers: number of processes for several starts, by default one per core.
            resume: resume from the checkpoints.
            max_seconds: replaces that of the project.

        Returns:
            The result, also of a fit that did not converge.

        Raises:
            InputError: the project has errors, or there is no checkpoint to resume from.
        """
        from kennfeld.optimize.fit.result import Seconds
        from kennfeld.optimize.search.multistart import run

        problem, options = self.problem(), replace(self.options, workers=workers)
        if max_seconds is not None:
            options = replace(options, max_seconds=max_seconds)
        seconds = Seconds(read=self.seconds_read)
        if not (resume or options.save_every):
            return run(problem, options, progress, seconds)
        from kennfeld.project.checkpoints import ResumePoints

        saves = self.saves(folder)
        points = saves.resume_points() if resume else ResumePoints()
        if not resume:
            saves.begin()
        result = run(
            problem,
            options,
            progress,
            seconds,
            keep=lambda saved: saves.keep(saved, problem.parameters),
            resumed=points.states,
        )
        findings = [*points.findings, *([saves.missed] if saves.missed else [])]
        return replace(result, message=" ".join([result.message, *(f"{finding}." for finding in findings)]))

    def propose(
        self,
        *,
        channels: Sequence[str] = ("*",),
        nodes: Sequence[str] = ("*",),
        kinds: "Sequence[Form]" = ("add", "multiply", "map", "lag", "delay", "offset"),
        least: float = 0.0,
        progress: Callable[[str], None] | None = None,
        report: Callable[[str], None] | None = None,
    ) -> "TermProposals":
        """Find terms that the function lacks: which channel of the recordings or lag, and at which node.

        The values are those of the last run in `results`, if there are any; else the project is calibrated first.
        Nothing is written.

        Args:
            channels: glob patterns of the channels that take part; by default all of the recordings.
            nodes: glob patterns of the nodes that take part.
            kinds: `add`, `multiply`, `map` of two channels, `lag`, `delay`, `offset` of each recording.
            least: effect that a proposal must explain on held-out data, in the unit of the target.
            progress: called with lines of text.
            report: former name of `progress`.

        Returns:
            The proposals, the best one first, each with a patch of the formula text and the project file.

        Raises:
            InputError: the project has errors.
        """
        from kennfeld.analysis.missing.proposing import SearchScope
        from kennfeld.project.missing_terms import propose

        progress = renamed(progress, report, "progress", "report")
        return propose(self, SearchScope(channels, nodes, kinds, least), progress or (lambda line: None))

    def apply(self, proposal: "TermProposal") -> tuple[Path, ...]:
        """Write a proposal of `propose` into the formula text and the project file; returns both paths.

        Raises:
            InputError: the function is not formula text, or a file cannot be written.
        """
        from kennfeld.project.missing_terms import apply

        return apply(self, proposal)

    def reading(self, names: tuple[str, ...]) -> Self:
        """Return the same project with further channels read from its recordings, if these have them."""
        return replace(self, further_channels=names)

    def problem_or_none(self) -> "Problem | None":
        """Return the calibration problem; None if the project has errors."""
        return self._assembly.problem

    def design(self, **words: Any) -> Any:
        """Calibrate the project and find out what to measure next.

        Args:
            words: the arguments of `kennfeld.design` after the first one: `n`, `segments` or `reduce`, `candidates`
                and others, and settings that override `[design]`.

        Returns:
            The `kennfeld.design.Design`.

        Raises:
            InputError: the project has errors, or candidates cannot be used.
        """
        return import_module(_DESIGN).design(self, **words)

    def saves(self, folder: str | Path | None = None) -> "Saves":
        """Return the checkpoints in a results folder, by default `results` next to the project file."""
        from kennfeld.project.checkpoints import Saves
        from kennfeld.project.results import results_folder

        return Saves(results_folder(self.path, folder), self.path)

    def read_values(self, path: str | Path) -> ParameterSet:
        """Read a calibration file, an image by the A2L file of the project's own images.

        What its format cannot state, such as extrapolation, is that of the project once the values are simulated.

        Raises:
            InputError: the file cannot be read.

        Warns:
            InputWarning: part of the file was skipped, so that the project's own values remain there.
        """
        parameters, findings = self.read_values_with_findings(path)
        warn(finding for finding in findings if finding.severity == "warning")
        return parameters

    def read_values_with_findings(self, path: str | Path) -> tuple[ParameterSet, tuple[Finding, ...]]:
        """Read the values as `read_values` does; return the findings on what was skipped in place of warnings."""
        from kennfeld.calfiles import read_with_findings
        from kennfeld.files.calibrations import IMAGE_ENDINGS

        path, calibration = Path(path), self.file.calibration
        # an A2L file beside the image precedes those of the project
        own = path.with_suffix(".a2l")
        if path.suffix.lower() not in IMAGE_ENDINGS or own.is_file():
            return read_with_findings(path)
        beside = (str(Path(name).with_suffix(".a2l")) for name in calibration.files if name.endswith(IMAGE_ENDINGS))
        named = calibration.descriptions.values() or beside
        known = {self.file.folder / name for name in named if (self.file.folder / name).is_file()}
        # of several A2L files it is not known which one describes the image
        return read_with_findings(path, next(iter(known)) if len(known) == 1 else None)

    def simulate(
        self, parameters: ParameterSet | None = None, shifts: Mapping[str, Mapping[str, float]] | None = None
    ) -> list[Dataset]:
        """Evaluate the function over every dataset.

        Args:
            parameters: replace those of the same name; by default the initial values are used.
            shifts: estimated shifts by dataset and channel, as in `Result.shifts`.

        Returns:
            All named nodes and the target channels, a dataset each. Samples at which an input has no value are left
            out; a warning, also in the `findings` of the dataset, states which.

        Raises:
            InputError: the project has errors, a table does not fit the function, or its data are in partitions.
        """
        from kennfeld.project.simulation import simulate_problem

        if self.is_partitioned:
            message = "data in partitions are not simulated as a whole"
            remedy = "Use Project.simulation, part by part, or write partition = 0, with fewer files."
            raise InputError.of(self.file.location("cluster"), message, remedy)
        datasets = simulate_problem(self._simulated(shifts), parameters)
        warn(finding for data in datasets for finding in data.findings)
        return datasets

    def simulation(
        self,
        parameters: ParameterSet | None = None,
        shifts: Mapping[str, Mapping[str, float]] | None = None,
        *,
        deviation: bool = False,
    ) -> "Simulation":
        """Return the same as `simulate`, to be computed part by part; data may be in partitions.

        With `deviation`, there is a channel with the predictive deviation of each surrogate,
        `engine (deviation)`. `save("after.mf4")` of the result writes a file for other tools.
        """
        from kennfeld.project.simulation import Simulation

        return Simulation(self._simulated(shifts), parameters, deviation=deviation)

    def _simulated(self, shifts: Mapping[str, Mapping[str, float]] | None) -> "Problem":
        if not shifts:
            return self.problem()
        from kennfeld.optimize.tuning.shift_estimation import apply_shifts

        return apply_shifts(self.problem(), shifts)

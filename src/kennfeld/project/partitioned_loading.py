"""Loading of the recordings of a project in partitions: each file is prepared where it will be evaluated.

This process receives an excerpt of each file, from which the problem is built and checked, and the length of each. What
depends on all samples, such as quantiles, is computed by passes over the partitions.
"""

import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.portable_pickle import pickle_content
from kennfeld.base.task_runner import TaskRunner
from kennfeld.graph.node import STEPS
from kennfeld.measurement.bus_databases import DatabaseFile
from kennfeld.optimize.problem.data_form import even_step
from kennfeld.optimize.problem.limit_nodes import keeps_pieces
from kennfeld.optimize.problem.partitions import (
    Partition,
    Partitions,
    Recordings,
    StoredDatasets,
    shared_content,
    split_files,
    with_worker,
)
from kennfeld.optimize.problem.problem import Problem
from kennfeld.preprocessing.calculated import Calculated
from kennfeld.preprocessing.joined_recordings import JoinedRecordings
from kennfeld.preprocessing.pipeline import LoadedData
from kennfeld.preprocessing.prepared_files import DatasetRecipe, PreparedFile, PreparedFiles, StoredSettings
from kennfeld.preprocessing.quantiles import DigitCounts, Digits, count_digits, quantiles
from kennfeld.preprocessing.recipe import DatasetEntry, DataSettings
from kennfeld.preprocessing.recording_sources import RecordingSource, find_sources
from kennfeld.preprocessing.recordings import ChannelRequest, default_name, find_databases
from kennfeld.preprocessing.units import check_stated_units
from kennfeld.project.data_column import DataColumn

EXCERPT = 200_000  # samples of all files
LEAST_EXCERPT = 100  # samples of each


@dataclass(frozen=True)
class FileSummary:
    """A prepared file without its samples.

    Attributes:
        file: as prepared, with an excerpt in place of its samples.
        samples: number of samples.
        scored: number of samples that are scored.
        starts: first samples of its pieces.
    """

    file: PreparedFile
    samples: int = 0
    scored: int = 0
    starts: tuple[int, ...] = ()


def summarise_file(shared: bytes, item: bytes, arguments: bytes) -> FileSummary:
    """Prepare a file, unless that was done before, and return its summary."""
    recordings, _ = shared_content(shared)
    number, source = pickle.loads(item)
    (excerpt,) = pickle.loads(arguments)
    file = recordings.files.file(recordings.recipes[number], source)
    data = file.dataset
    if data is None:
        return FileSummary(replace(file, findings=with_worker(file.findings)))
    sought = bool(recordings.recipes[number].entry.unknown_shifts)  # shifts of points count their order
    part = replace(file, dataset=file.excerpt(excerpt, neighbouring=sought))
    return FileSummary(part, data.samples, int(np.count_nonzero(data.counting)), tuple(data.piece_starts.tolist()))


def count_column(shared: bytes, item: bytes, arguments: bytes) -> DigitCounts:
    """Count the digits of a column over one partition; see `quantiles`."""
    recordings, _ = shared_content(shared)
    column, digits = pickle.loads(arguments)
    datasets = StoredDatasets(recordings, pickle.loads(item).parts)
    values = (column.values(data) for data in datasets)
    return count_digits((each for each in values if each is not None), digits)


def _load_databases(settings: DataSettings, entry: DatasetEntry, loaded: LoadedData) -> tuple[DatabaseFile, ...]:
    """Return the databases that decode the bus logs of a dataset, with their content, which workers may not have."""
    databases, findings = find_databases(settings.folder, entry)
    loaded.findings += findings
    try:
        return tuple(database.loaded() for database in databases)
    except InputError as error:
        loaded.findings += error.findings
        return ()


@dataclass(frozen=True)
class _DatasetFiles:
    """The files of one dataset."""

    entry: DatasetEntry
    sources: Sequence[RecordingSource]
    summaries: Sequence[FileSummary] = ()

    @property
    def is_fitted(self) -> bool:
        return self.entry.use == "training" and self.entry.weight > 0


class PartitionedLoading:
    """Prepares the recordings of a project in partitions; a `Loader`.

    Args:
        project: name of the project file.
        runner: prepares the files.
        files: folder of prepared files.
        size: samples of a partition.
    """

    def __init__(self, project: str, runner: TaskRunner, files: PreparedFiles, size: int) -> None:
        self._project, self._runner, self._files, self._size = project, runner, files, size
        self._recordings = Recordings((), files)
        self._datasets: list[_DatasetFiles] = []

    def __call__(self, settings: DataSettings, request: ChannelRequest, calculated: Calculated) -> LoadedData:
        """Return the datasets of a project with an excerpt of each file as samples."""
        loaded = LoadedData()
        stored = StoredSettings.of(self._project, settings)
        listed = [self._list_files(settings, entry, loaded) for entry in settings.datasets]
        recipes = [
            DatasetRecipe(stored, files.entry, request, databases=_load_databases(settings, files.entry, loaded))
            for files in listed
        ]
        recipes = self._with_units(recipes, listed)
        self._recordings = Recordings(tuple(recipes), self._files)
        self._datasets = self._summarise(listed)
        used: set[str] = set()
        for files in self._datasets:
            _add_dataset(loaded, files)
            used.update(name for summary in files.summaries for name in summary.file.used)
        loaded.findings = _merge_files(loaded.findings)
        if request.complete:
            loaded.findings += check_stated_units(settings, used, loaded.clocks, complete=loaded.complete)
        return loaded

    def _list_files(self, settings: DataSettings, entry: DatasetEntry, loaded: LoadedData) -> _DatasetFiles:
        sources: dict[RecordingSource, None] = {}
        for pattern in entry.files:
            try:
                matches = find_sources(settings.folder, pattern)
            except InputError as error:
                loaded.findings += error.findings
                continue
            if not matches:
                loaded.findings.append(Finding(entry.location.within("files"), f"{pattern} matches no file"))
            sources |= dict.fromkeys(matches)
        name = entry.name or default_name([source.address for source in sources], entry.files[0])
        return _DatasetFiles(replace(entry, name=name), tuple(sources))

    def _with_units(self, recipes: list[DatasetRecipe], listed: Sequence[_DatasetFiles]) -> list[DatasetRecipe]:
        """Return the recipes with the units of the first file, to which the others are converted."""
        first = next(((i, files.sources[0]) for i, files in enumerate(listed) if files.sources), None)
        if first is None:
            return recipes
        # only the units of the first file are wanted here: an excerpt of one sample is enough
        shared = pickle_content((Recordings(tuple(recipes), self._files), None))
        (summary,) = self._runner.map(summarise_file, shared, [pickle_content(first)], pickle_content((1,)))
        return [replace(recipe, units=dict(summary.file.units)) for recipe in recipes]

    def _summarise(self, listed: Sequence[_DatasetFiles]) -> list[_DatasetFiles]:
        items = [pickle_content((i, source)) for i, files in enumerate(listed) for source in files.sources]
        # excerpts of all files together stay of one size, whatever their number
        arguments = pickle_content((max(EXCERPT // max(len(items), 1), LEAST_EXCERPT),))
        shared = pickle_content((self._recordings, None))
        summaries = iter(self._runner.map(summarise_file, shared, items, arguments))
        return [replace(files, summaries=[next(summaries) for _ in files.sources]) for files in listed]

    def _partitions(self, *, fitted: bool, whole_pieces: bool) -> tuple[Partition, ...]:
        result: list[Partition] = []
        for number, files in enumerate(self._datasets):
            if files.is_fitted != fitted:
                continue
            pairs = [pair for pair in zip(files.sources, files.summaries, strict=True) if pair[1].samples]
            whole = whole_pieces or files.entry.warmup > 0  # a warm-up begins with a piece
            starts = [summary.starts if whole else () for _, summary in pairs]
            lengths = [summary.samples for _, summary in pairs]
            result += split_files(number, [source for source, _ in pairs], starts, lengths, self._size)
        return tuple(result)

    def partitions(self, problem: Problem) -> Partitions:
        """Return the data of a problem in partitions; those of a model or limit with memory consist of whole pieces."""
        whole = keeps_pieces(problem.model, problem.limits)
        training, test = (self._partitions(fitted=fitted, whole_pieces=whole) for fitted in (True, False))
        result = Partitions(self._recordings, training, test, self._runner)
        if problem.graph.clocks.isdisjoint(STEPS):
            return result
        steps = [*replace(problem, partitions=result).each(step_of)]
        # a step that differs between partitions by rounding alone is one step
        same = steps[0] is not None and all(step is not None and np.isclose(step, steps[0], 1e-6) for step in steps)
        return replace(result, step=steps[0] if same else None)

    def quantiles(self, column: DataColumn, probabilities: Float) -> Float:
        """Compute quantiles of a column over all training samples, Float[probabilities]; empty if it has no values."""
        partitions = self._partitions(fitted=True, whole_pieces=column.is_timed)
        shared = pickle_content((self._recordings, None))
        items = [pickle_content(partition) for partition in partitions]

        def run(digits: Digits) -> Iterator[DigitCounts]:
            return self._runner.map(count_column, shared, items, pickle_content((column, digits)))

        return quantiles(run, probabilities)


def step_of(problem: Problem) -> float | None:
    """Return the time step of the training data in s, None if it is not the same everywhere."""
    return even_step(problem.training)


def _add_dataset(loaded: LoadedData, files: _DatasetFiles) -> None:
    """Add a dataset of excerpts, and what was noticed in its files."""
    entry = files.entry
    for summary in files.summaries:
        loaded.findings += summary.file.findings
        loaded.offered |= dict.fromkeys(summary.file.offered)
        loaded.clocks |= set(summary.file.clocks)
    parts = [summary.file.dataset for summary in files.summaries if summary.file.dataset is not None]
    failed = any(summary.file.failed for summary in files.summaries)
    if failed or not parts:
        loaded.complete = False
        if files.sources and not failed:
            loaded.findings.append(Finding(entry.location.within("steady"), "no file has a plateau"))
        return
    recordings = JoinedRecordings(entry.name, entry, len(parts))
    for part in parts:
        # masks are joined below: one file may have none while another has
        recordings.add(replace(part, scored=None, recorded=None))
    loaded.findings += [*recordings.findings, *_unscored(files)]
    if entry.name in loaded.locations:
        message = f"duplicate dataset name {entry.name}"
        loaded.findings.append(Finding(entry.location.within("name"), message, "Give each dataset its own name."))
        return
    dataset = recordings.dataset()
    assert dataset is not None
    scored = None if all(part.scored is None for part in parts) else np.concatenate([part.counting for part in parts])
    loaded.datasets.append(replace(dataset, scored=scored))
    loaded.locations[entry.name] = entry.location
    if entry.unknown_shifts:
        loaded.unknown_shifts[entry.name] = entry.unknown_shifts


def _unscored(files: _DatasetFiles) -> Iterator[Finding]:
    """Yield the settings that leave no sample of any file."""
    entry = files.entry
    if any(summary.scored for summary in files.summaries):
        return
    if entry.where:
        yield Finding(entry.location.within("where"), f"{entry.where} is true at no sample", "Check the condition.")
    elif entry.warmup > 0:
        message = f"{entry.warmup:g} s is longer than every piece"
        yield Finding(entry.location.within("warmup"), message, "Reduce it.")


def _merge_files(findings: Sequence[Finding]) -> list[Finding]:
    """Return findings that differ in their file only as the first one, with the number of the others."""
    groups: dict[tuple[str, ...], list[Finding]] = {}
    for finding in dict.fromkeys(findings):
        place = finding.location
        key = (str(place.line), place.path, finding.message, finding.remedy, finding.severity)
        groups.setdefault(key, []).append(finding)
    return [_with_count(group) for group in groups.values()]


def _with_count(group: Sequence[Finding]) -> Finding:
    first = group[0]
    if len(group) == 1:
        return first
    others = len(group) - 1
    more = f"{first.location.file} and {others} more {'file' if others == 1 else 'files'}"
    return replace(first, location=replace(first.location, file=more))

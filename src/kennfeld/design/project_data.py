"""The data of a project with further ones: candidates, and the operation that matters, prepared as its own."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.base.arrays import Bool
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.fit.result import Progress, Seconds
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.multistart import run
from kennfeld.preprocessing.recipe import DatasetEntry
from kennfeld.preprocessing.recordings import find_recordings
from kennfeld.project import Project
from kennfeld.project.recording_parameters import names_per_recording, recording_numbers

CANDIDATES, USE = "candidates (--from)", "use of [design]"
UNFINISHED = 1e-3  # share of the cost that a fit takes off, from which it is worth a remark


@dataclass(frozen=True, eq=False)
class ProjectData:
    """The problem of a project, and further data that are prepared like its own.

    Attributes:
        project: the project, with the further data among its datasets.
        problem: its problem without them.
        candidates: what may be measured.
        use: the operation that matters; empty for training and test data.
        findings: remarks on what was read.
    """

    project: Project
    problem: Problem
    candidates: tuple[Dataset, ...]
    use: tuple[Dataset, ...]
    findings: tuple[Finding, ...] = ()

    @classmethod
    def of(cls, project: Project, candidates: Sequence[str], use: Sequence[str], use_weight: str = "") -> "ProjectData":
        """Read a project together with further files.

        Units, calculated channels, raster and shifts are those of its first dataset with training data. Paths of
        candidates are relative to the present folder, those of the use to that of the project. The channel `use_weight`
        weights the samples of the use.

        Raises:
            InputError: a file cannot be read, or has not all channels that the function reads.
        """
        file, findings = project.file, list[Finding]()
        first = next((entry for entry in file.datasets if entry.is_fitted), file.datasets[0])
        here = tuple(str(Path.cwd() / pattern) for pattern in candidates)
        further = [_entry(first, CANDIDATES, here)] if here else []
        further += [replace(_entry(first, USE, tuple(use)), weight_channel=use_weight)] if use else []
        if project.is_partitioned and project.load is None:
            message = "a design reads all data into this process, not in partitions"
            findings.append(Finding(file.location("cluster"), message, severity="remark"))
        cluster = replace(file.cluster, partition=0, scheduler="", workers=1) if project.load is None else file.cluster
        whole = replace(project, file=replace(file, datasets=(*file.datasets, *further), cluster=cluster))
        problem = whole.problem()
        own = tuple(data for data in problem.datasets if data.name not in (CANDIDATES, USE))
        named = {data.name: data for data in problem.datasets}
        return cls(
            whole,
            replace(problem, datasets=own, partitions=None),
            tuple(named[name] for name in (CANDIDATES,) if name in named),
            tuple(named[name] for name in (USE,) if name in named),
            tuple(findings),
        )

    def fit(
        self, progress: Progress | None = None, values: ParameterSet | None = None, *, near: bool = False
    ) -> tuple[FittedFunction, tuple[Finding, ...]]:
        """Calibrate the project and return the end of the fit.

        Args:
            progress: called after each accepted step.
            values: those that the fit begins from; by default the initial values. If it changes them, a remark says so.
            near: the values are those of a fit, so that one search from them is enough.
        """
        options = replace(self.project.options, cluster=None)
        if near:
            options = replace(options, starts=1, steps=(), continuation="off", save_every=0)
        problem = self.problem if values is None else replace(self.problem, parameters=values)
        result = run(problem, options, progress, Seconds(read=self.project.seconds_read))
        findings: list[Finding] = []
        if values is not None and result.cost_before - result.cost_after > UNFINISHED * result.cost_after:
            message = f"the values were fitted further first: cost {result.cost_before:.4g} -> {result.cost_after:.4g}"
            findings.append(Finding(Location("design"), message, severity="remark"))
        return FittedFunction.of(result, self._of_new_recordings()), tuple(findings)

    def _of_new_recordings(self) -> dict[str, Bool]:
        """Return by parameter with a value for each recording those of the candidates, which the fit holds."""
        numbers = recording_numbers(self.candidates)
        names = names_per_recording(self.project.file) & self.problem.parameters.keys()
        return {
            name: np.isin(self.problem.parameters[name].axes[0].breakpoints, numbers)
            for name in names
            if self.problem.parameters[name].axes
        }


def _entry(first: DatasetEntry, name: str, files: tuple[str, ...]) -> DatasetEntry:
    """Return the settings of further data, prepared like a dataset of the project but with all samples counting."""
    return replace(
        first, files=files, name=name, use="test", weight=1.0, where="", warmup=0.0, weight_channel="", steady=()
    )


def has_recordings(project: Project) -> bool:
    """Return True if a dataset of the project has any file, or its data are in memory."""
    if project.load is not None:
        return True
    for entry in project.file.datasets:
        for pattern in entry.files:
            try:
                if find_recordings(project.file.folder, pattern):
                    return True
            except InputError:
                return True  # what cannot be looked up is reported when it is read
    return False

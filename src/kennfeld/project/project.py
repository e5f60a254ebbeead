"""A project: one file that says what is calibrated, with which data, and how."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from kennfeld.dataset import Dataset
from kennfeld.errors import Finding, InputError
from kennfeld.parameters import ParameterSet
from kennfeld.project.schema import ProjectFile
from kennfeld.project.sections import read_project

if TYPE_CHECKING:  # the solver costs most of a second to import, and reading the file alone does not need it
    from kennfeld.optimize import Options, Problem, Result
    from kennfeld.project.assembly import Assembly
    from kennfeld.project.saves import Saves

__all__ = ["Project"]


@dataclass(frozen=True, eq=False)
class Project:
    """A project file that was read, and everything that can be done with it.

    Model, data and calibration files are read once, when they are needed first.

    >>> project = Project.read("kennfeld.toml")  # doctest: +SKIP
    >>> project.calibrate().status  # doctest: +SKIP
    'converged'
    """

    path: Path
    name: str
    formats: tuple[str, ...]
    findings: tuple[Finding, ...]
    file: ProjectFile = field(repr=False)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The project in a TOML file; the files that it names are not read yet.

        Raises `InputError` with every problem of the project file.
        """
        file = read_project(Path(path))
        return cls(file.path, file.name, file.calibration.output, file.findings, file)

    @property
    def options(self) -> "Options":
        """How to search."""
        from kennfeld.optimize import Options

        given = self.file.optimizer
        return Options(
            max_iterations=given.max_iterations,
            tolerance=given.tolerance,
            continuation=given.continuation,
            method=given.method,
            max_evaluations=given.max_evaluations,
            starts=given.starts,
            seed=given.seed,
            spread=given.spread,
            steps=self._assembly.steps if self.file.steps else (),
            save_every=given.save_every,
        )

    @property
    def surrogates(self) -> tuple[str, ...]:
        """The names of its data-driven models."""
        return tuple(self.file.surrogates)

    @property
    def seconds_read(self) -> float:
        """How long reading model, data and calibration files took; 0 before they are needed."""
        return self._assembly.seconds if "_assembly" in self.__dict__ else 0.0

    @cached_property
    def _assembly(self) -> "Assembly":
        from kennfeld.project.assembly import assemble

        return assemble(self.file)

    def check(self) -> list[Finding]:
        """Every problem of the project and of the files that it names, errors and warnings; never raises for them."""
        from kennfeld.project.checks import warnings_of

        assembly = self._assembly
        found = [*self.findings, *assembly.findings]
        if assembly.problem is not None:
            found += warnings_of(self.file, assembly.problem, assembly.places)
        return list(dict.fromkeys(found))

    def seen_test_data(self) -> list[Finding]:
        """Return a warning for each test dataset with files or samples that are training data too.

        Raises `InputError` like `problem`.
        """
        from kennfeld.project.seen_data import seen_test_data

        return seen_test_data(self.file, self.problem(), self._assembly.places)

    def problem(self) -> "Problem":
        """The calibration problem. Raises `InputError` with every finding where it cannot be made."""
        assembly = self._assembly
        if assembly.problem is None:
            raise InputError([*self.findings, *assembly.findings])
        return assembly.problem

    def calibrate(
        self,
        progress: Callable[[Any], None] | None = None,
        *,
        folder: str | Path | None = None,
        workers: int | None = None,
        resume: bool = False,
    ) -> "Result":
        """Find the best values; `progress` hears of each accepted step and may raise `Stop`.

        Several starts run in so many `workers`, by default one a core. States of the search go to `saves` in the
        results folder, by default `results` beside the project file, as `save_every` says; with `resume` the search
        goes on from there. Raises `InputError` like `problem`, and where there is nothing to resume; a fit that fails
        is a result too.
        """
        from dataclasses import replace

        from kennfeld.optimize import Seconds, run

        problem, options = self.problem(), replace(self.options, workers=workers)
        seconds = Seconds(read=self.seconds_read)
        if not (resume or options.save_every):
            return run(problem, options, progress, seconds)
        from kennfeld.project.saves import Found

        saves = self.saves(folder)
        found = saves.found() if resume else Found()
        if not resume:
            saves.begin()
        result = run(
            problem,
            options,
            progress,
            seconds,
            keep=lambda saved: saves.keep(saved, problem.parameters),
            resumed=found.states,
        )
        odd = [*found.findings, *([saves.missed] if saves.missed else [])]
        said = [result.message, *(f"{finding}." for finding in odd)]
        return replace(result, message=" ".join(said))

    def saves(self, folder: str | Path | None = None) -> "Saves":
        """The saved states in a results folder."""
        from kennfeld.project.saves import Saves

        return Saves(Path(folder or self.path.parent / "results"), self.path)

    def simulate(
        self, parameters: ParameterSet | None = None, shifts: Mapping[str, Mapping[str, float]] | None = None
    ) -> list[Dataset]:
        """All named nodes and the target channels, over every dataset.

        `parameters` replace those of the project where they have the same name; by default the start is simulated.
        `shifts` are those that a calibration found, by dataset and channel.
        Raises `InputError` like `problem`, and where a given table does not fit the function.
        """
        from kennfeld.project.simulation import simulations

        problem = self.problem()
        if shifts:
            from kennfeld.optimize.choice.lag import moved

            problem = moved(problem, shifts)
        return simulations(problem, parameters)

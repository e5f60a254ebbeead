"""A project: one file that says what is calibrated, with which data, and how.

Simulates a project's function over its datasets.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from kennfeld.dataset import Channel, Dataset
from kennfeld.errors import ArgumentError, Finding, InputError
from kennfeld.optimize import Problem
from kennfeld.optimize.quality import NodeSimulator
from kennfeld.parameter_set import ParameterSet
from kennfeld.project.initial_calibration import described
from kennfeld.project.schema import ProjectFile
from kennfeld.project.sections import read_project

if TYPE_CHECKING:
    from kennfeld.optimize import Options, Result
    from kennfeld.project.checkpoints import Saves
    from kennfeld.project.problem_builder import ProjectProblem

__all__ = ["Project", "replaced"]


def simulations(problem: Problem, parameters: ParameterSet | None) -> list[Dataset]:
    """The named nodes and the target channels over every dataset; a target called like a node gets a suffix."""
    values = replaced(problem, parameters)
    compiled = NodeSimulator(problem.model.graph, values)
    return [_one(problem, data, values, compiled) for data in problem.datasets]


def _one(problem: Problem, data: Dataset, values: ParameterSet, compiled: NodeSimulator) -> Dataset:
    bound = problem.bind(data)
    nodes = compiled.dataset(bound, values)
    bound = bound.shown
    names = dict.fromkeys(c.target.name for c in problem.criteria if c.target.kind == "channel")
    targets = [
        Channel(f"{name} (target)" if name in nodes else name, bound.channel(name), data[name].unit)
        for name in names
        if name in data
    ]
    return replace(nodes.with_channels(*targets), use=data.use, weight=data.weight, scored=bound.scored)


def replaced(problem: Problem, parameters: ParameterSet | None) -> ParameterSet:
    """The project's parameters with others of the same names; they may have other axes, but as many.

    Raises `InputError` where one does not fit the function.
    """
    if parameters is None:
        return problem.parameters
    needed = problem.model.graph.parameters
    wrong = [
        Finding("parameters", f"{name} is {described(parameters[name])}; the function gives it {count} coordinates")
        for name, count in needed.items()
        if name in parameters and parameters[name].coordinates != count
    ]
    if wrong:
        raise InputError(wrong)
    try:
        return problem.parameters.merged(parameters)
    except ArgumentError as error:
        raise InputError.of("parameters", str(error)) from None


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
    def _assembly(self) -> "ProjectProblem":
        from kennfeld.project.problem_builder import assemble

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
        from kennfeld.project.checkpoints import Found

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
        from kennfeld.project.checkpoints import Saves

        return Saves(Path(folder or self.path.parent / "results"), self.path)

    def simulate(
        self, parameters: ParameterSet | None = None, shifts: Mapping[str, Mapping[str, float]] | None = None
    ) -> list[Dataset]:
        """All named nodes and the target channels, over every dataset.

        `parameters` replace those of the project where they have the same name; by default the start is simulated.
        `shifts` are those that a calibration found, by dataset and channel.
        Raises `InputError` like `problem`, and where a given table does not fit the function.
        """
        problem = self.problem()
        if shifts:
            from kennfeld.optimize.tuning.shift_estimation import moved

            problem = moved(problem, shifts)
        return simulations(problem, parameters)

"""A project: one file that says what is calibrated, with which data, and how."""

from collections.abc import Callable
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
            given.max_iterations, given.tolerance, given.continuation, given.method, given.max_evaluations, given.seed
        )

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

    def problem(self) -> "Problem":
        """The calibration problem. Raises `InputError` with every finding where it cannot be made."""
        assembly = self._assembly
        if assembly.problem is None:
            raise InputError([*self.findings, *assembly.findings])
        return assembly.problem

    def calibrate(self, progress: Callable[[Any], None] | None = None) -> "Result":
        """Find the best values; `progress` hears of each accepted step and may raise `Stop`.

        Raises `InputError` like `problem`; a fit that fails is a result too.
        """
        from kennfeld.optimize import Seconds, run

        return run(self.problem(), self.options, progress, Seconds(read=self.seconds_read))

    def simulate(self, parameters: ParameterSet | None = None) -> list[Dataset]:
        """All named nodes and the target channels, over every dataset.

        `parameters` replace those of the project where they have the same name; by default the start is simulated.
        Raises `InputError` like `problem`, and where a given table does not fit the function.
        """
        from kennfeld.project.simulation import simulations

        return simulations(self.problem(), parameters)

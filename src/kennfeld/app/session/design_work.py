"""Designs of a session, what to measure next: the work, the maps of deviations, and the chosen operation in them."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.app.session.session import Session
from kennfeld.app.session.side_work import PartialOutcome, Tell, WorkStep
from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import InputError
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.design.api import ProjectDesign, Request, made_design
from kennfeld.design.design_result import Design
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.design.measured_kinds import measured_kinds
from kennfeld.design.point_design import points_dataset
from kennfeld.design.segments import cut_segments
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.traversal import coordinates_of
from kennfeld.optimize.fit.result import TraceLine
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.project import Project

MOST_PLACES = 1500  # recorded samples that are drawn
MOST_STEPS = 150  # of the way of a segment
EVERY = 2.0  # s between reports of the design so far, which a stop leaves


@dataclass(frozen=True, eq=False)
class DesignedTable:
    """A table with the deviations of its values, and the operation over its axes.

    Attributes:
        name: of the parameter, or of an axis with free breakpoints.
        unit: of its values.
        inputs: names of its axes.
        units: of these.
        axes: breakpoints of each.
        values: at the fit, Float[values].
        before: standard deviations now, Float[values]; inf if undetermined.
        after: as predicted.
        samples: that inform each value, Int[values]; empty if unknown.
        places: coordinates of recorded samples, Float[axes, places].
        ways: coordinates of each segment, Float[axes, steps], or of all points; empty if the axes are not known.
    """

    name: str
    unit: str
    inputs: tuple[str, ...]
    units: tuple[str, ...]
    axes: tuple[Float, ...]
    values: Float
    before: Float
    after: Float
    samples: Int
    places: Float
    ways: tuple[Float, ...]


@dataclass(frozen=True, eq=False)
class DesignFindings:
    """A design, with the pictures of its tables; none without a fit."""

    design: Design
    tables: tuple[DesignedTable, ...] = ()

    @property
    def detail(self) -> str:
        """The outcome in a few words."""
        design = self.design
        if design.segments:
            return count_noun(len(design.segments), "segment")
        if design.points:
            return count_noun(len(design.points), "point")
        if design.tables:
            return count_noun(len(design.tables), "manoeuvre")
        return f"{count_noun(len(design.drop), 'recording')} can go" if design.drop else "all recordings add"


@dataclass(frozen=True, eq=False)
class DesignTask:
    """The work, in a process of its own.

    Attributes:
        path: the project file.
        unsaved: texts that replace those of files.
        values: from which the fit begins; None for a project that cannot be evaluated.
        near: True if they are those of a fit.
        request: the question.
        candidates: recordings to choose from, absolute paths or patterns.
    """

    path: Path
    unsaved: Mapping[str, str]
    values: ParameterSet | None
    near: bool
    request: Request
    candidates: tuple[str, ...]

    def run(self, tell: Tell) -> DesignFindings:
        """Fit, choose, and draw."""

        def progress(line: TraceLine) -> None:
            tell(WorkStep(f"fitting the function: {line.stage}, step {line.iteration}"))

        reported = time.monotonic()

        def watch(made: Callable[[], Design] | None) -> bool:
            nonlocal reported
            if made is not None and time.monotonic() - reported >= EVERY:
                tell(PartialOutcome(DesignFindings(self._with_relative_files(made()))))
                reported = time.monotonic()
            return False

        project = Project.read(self.path, self.unsaved)
        tell(WorkStep("reading the recordings"))
        try:
            proposed = made_design(
                project,
                self.request,
                self.candidates,
                progress=progress,
                values=self.values,
                near=self.near,
                watch=watch,
            )
        finally:
            project.close()
        tell(WorkStep("drawing"))
        return DesignFindings(self._with_relative_files(proposed.design), tuple(_tables(proposed, project)))

    def _with_relative_files(self, design: Design) -> Design:
        """Name recordings as seen from the project."""
        segments = [replace(each, file=self._relative(each.file)) for each in design.segments]
        return replace(design, segments=tuple(segments), drop=tuple(map(self._relative, design.drop)))

    def _relative(self, file: str) -> str:
        folder = self.path.parent
        return Path(file).relative_to(folder).as_posix() if Path(file).is_relative_to(folder) else file


def _tables(proposed: ProjectDesign, project: Project) -> Iterator[DesignedTable]:
    fitted, design = proposed.fitted, proposed.design
    if fitted is None:
        return
    problem = fitted.problem
    chosen = _chosen(proposed, project.file.design.length)
    recorded = problem.fitted_datasets
    for name, after in design.after.items():
        if name not in problem.parameters:
            continue
        table = problem.parameters[name]
        inputs = tuple(coordinates_of(problem.model.graph, name)) if table.kind != "rbf" else ()
        known = bool(inputs) and all(inputs)
        places = np.concatenate([_coordinates(problem, data, inputs) for data in recorded], axis=1) if known else None
        yield DesignedTable(
            name=name,
            unit=table.unit,
            inputs=inputs,
            units=tuple(_unit(problem, each) for each in inputs),
            axes=tuple(axis.breakpoints for axis in table.axes),
            values=table.values.ravel(),
            before=np.asarray(design.before.get(name, np.full(after.shape, np.nan))).ravel(),
            after=np.asarray(after).ravel(),
            samples=_samples(fitted, name, table.size),
            places=np.zeros((2, 0)) if places is None else _thinned(places, MOST_PLACES),
            ways=tuple(_way(problem, data, lead, inputs) for data, lead in chosen) if known else (),
        )


def _unit(problem: Problem, name: str) -> str:
    """Return the unit of an input or a node; that of a channel as it is recorded."""
    channel = problem.channels.get(name, name)
    recorded = next((data[channel].unit for data in problem.datasets if channel in data), "")
    return recorded or problem.model.graph.units.get(name, "")


def _samples(fitted: FittedFunction, name: str, size: int) -> Int:
    counts = np.asarray(fitted.trust.samples.get(name, ()), dtype=np.int64).ravel()
    return counts if counts.size == size else np.zeros(0, dtype=np.int64)


def _chosen(proposed: ProjectDesign, length: float) -> list[tuple[Dataset, int]]:
    """Return each chosen segment as a dataset with the samples of its warm-up, or all chosen points as one."""
    design, fitted = proposed.design, proposed.fitted
    if design.run is not None and fitted is not None:
        return [(points_dataset(design.run.columns, measured_kinds(fitted)[0]), 0)]
    if not design.segments:
        return []
    timed = [data for data in proposed.candidates if data.time is not None]
    known = {(each.file, each.begin, each.end): each for each in cut_segments(timed, length, design.warmup)}
    picked = [known.get((each.file, each.begin, each.end)) for each in design.segments]
    return [(each.cut(timed[each.dataset]), each.first - each.lead) for each in picked if each is not None]


def _way(problem: Problem, data: Dataset, lead: int, inputs: Sequence[str]) -> Float:
    way = _coordinates(problem, data, inputs)[:, lead:]
    # points are few, and each counts
    return way if data.time is None else _thinned(way, MOST_STEPS)


def _coordinates(problem: Problem, data: Dataset, inputs: Sequence[str]) -> Float:
    """Return the coordinates of lookups over the samples of a dataset, Float[inputs, samples]."""
    bound = problem.bind(data)
    nodes = [name for name in inputs if name not in problem.model.graph.inputs]
    rows: dict[str, Float] = {}
    if nodes:
        values = NodeSimulator(problem.graph, problem.parameters, nodes).values(bound, problem.parameters)
        if bound.hold is not None:
            values = bound.hold.mean(values)
        rows = dict(zip(nodes, values, strict=True))
    for name in inputs:
        if name not in rows:
            rows[name] = bound.shown.channel(problem.channels.get(name, name))
    return np.array([rows[name] for name in inputs])


def _thinned(columns: Float, most: int) -> Float:
    count = columns.shape[1]
    if count <= most:
        return columns
    return columns[:, np.linspace(0, count - 1, most).round().astype(np.int64)]


def start_design(session: Session, request: Request, candidates: Sequence[str]) -> None:
    """Find out what to measure next, from the present values.

    A project that cannot be evaluated yet can have points that fill ranges.

    Raises:
        ArgumentError: a design is being computed.
        InputError: the request contradicts itself, or files have changed since they were read.
    """
    request.check()
    values = None
    if session.view is not None:
        session.require_evaluable()
        values = session.parameters
    elif session.undecided:
        raise InputError(session.findings)
    folder = session.path.parent
    # as `--from` in the folder of the project; an address stays as it is
    files = tuple(name if "://" in name else str(folder / name) for name in candidates)
    last = session.last_whole_run
    near = last is not None and last.result.converged
    task = DesignTask(session.path, session.unsaved_texts, values, near, request, files)
    session.design_work.start(task, session.subject)

"""The result of a design: what to measure, and what that is predicted to determine."""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import finite_or_none, nested_or_none
from kennfeld.design.bench_order import BenchRun
from kennfeld.design.comparison import DesignComparison, compare
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.design.manoeuvres import TimeTable
from kennfeld.domain.file_spans import short_names
from kennfeld.optimize.fit.result import Result, aligned

MOST_ROWS = 8  # points that a text shows


@dataclass(frozen=True)
class ChosenSegment:
    """A piece of a recording or a planned manoeuvre to drive.

    Attributes:
        file: the recording.
        begin: time stamp in it at which the piece begins to count, in s; the warm-up comes before.
        end: time stamp of its end.
        settles: the values that it determines and the other pieces do not.
    """

    file: str
    begin: float
    end: float
    settles: str = ""


@dataclass(frozen=True, eq=False)
class Design:
    """A list of what to measure next, and what it is predicted to determine.

    Attributes:
        points: steady points by channel, in the order of the bench.
        segments: pieces of recordings to drive, the first determines most.
        drop: recordings that add nothing, the first is missed least.
        before: standard deviation of each value now, by parameter; inf if undetermined.
        after: the same as predicted.
        least: the least that it may be predicted to be by values that the fit does not exclude; empty if unknown.
        most: the greatest.
        unsettled: for what the data do not determine, a sentence on what the design leaves open.
        sentences: further predictions.
        findings: warnings and remarks.
        warmup: time before each segment in which the function settles, in s.
        run: the points with blocks, replicates and the time between them; None without points.
        tables: planned manoeuvres.
        factor: predicted mean variance of prediction over the use, relative to that now; NaN if it is unknown.
        course: the same after each segment and those before it.
        noise: standard deviation of the noise of each node, on which the prediction is based.
        stopped: of a search that was stopped, how many were chosen, and how many would have been; None for others.
        stop_warning: the one of `findings` that says so.

    >>> from kennfeld import design
    >>> levels = design(n=4, ranges={"speed": (800, 6000)}, method="factorial")
    >>> [round(point["speed"], 1) for point in levels.points]
    [800.0, 2533.3, 4266.7, 6000.0]
    """

    points: tuple[Mapping[str, float], ...] = ()
    segments: tuple[ChosenSegment, ...] = ()
    drop: tuple[str, ...] = ()
    before: Mapping[str, Float] = field(default_factory=dict, repr=False)
    after: Mapping[str, Float] = field(default_factory=dict, repr=False)
    least: Mapping[str, Float] = field(default_factory=dict, repr=False)
    most: Mapping[str, Float] = field(default_factory=dict, repr=False)
    unsettled: tuple[str, ...] = ()
    sentences: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    warmup: float = 0.0
    run: BenchRun | None = field(default=None, repr=False)
    tables: tuple[TimeTable, ...] = field(default=(), repr=False)
    factor: float = float("nan")
    course: tuple[float, ...] = field(default=(), repr=False)
    noise: Mapping[str, float] = field(default_factory=dict, repr=False)
    stopped: tuple[int, int] | None = None
    stop_warning: Finding | None = field(default=None, repr=False)

    @classmethod
    def read(cls, path: str | Path) -> "Design":
        """Read a design that was saved as .json, for `compare`; its order and planned manoeuvres are not in the file.

        Raises:
            InputError: the file cannot be read, or holds no design around a fit.
        """
        place = Location(str(path))
        with convert_errors(Path(path), "cannot be read"):
            text = Path(path).read_text(encoding="utf-8")
        try:
            content = json.loads(text)
            return cls(
                points=tuple(content["points"]),
                segments=tuple(ChosenSegment(**segment) for segment in content["segments"]),
                drop=tuple(content["drop"]),
                before=_deviations(content["deviation"]["before"]),
                after=_deviations(content["deviation"]["after"]),
                # files of earlier versions have no range
                least=_deviations(content["deviation"].get("least", {})),
                most=_deviations(content["deviation"].get("most", {})),
                unsettled=tuple(content["unsettled"]),
                sentences=tuple(content["sentences"]),
                warmup=content["warmup"],
                factor=float("nan") if content["variance"] is None else content["variance"],
                noise={node: value for node, value in content.get("noise", {}).items() if value is not None},
            )
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            remedy = "Name the .json file that kennfeld design -o has written."
            raise InputError.of(place, "is not a design", remedy) from error

    def compare(self, result: Result) -> DesignComparison:
        """Compare the predicted deviations with those of a fit of all data, the measured ones included.

        Raises:
            InputError: the design was made without a fit, or for tables of another size.
        """
        return compare(self.before, self.after, self.noise, FittedFunction.of(result), self.most)

    def as_json(self) -> dict[str, Any]:
        """Return the content of `kennfeld design --json`; numbers that are not finite are None."""
        return {
            "points": [dict(point) for point in self.points],
            "segments": [vars(segment) for segment in self.segments],
            "drop": list(self.drop),
            "deviation": {name: _nested(getattr(self, name)) for name in ("before", "after", "least", "most")},
            "noise": {node: finite_or_none(value) for node, value in self.noise.items()},
            "unsettled": list(self.unsettled),
            "warmup": self.warmup,
            "variance": finite_or_none(self.factor),
            "sentences": list(self.sentences),
            "findings": [str(finding) for finding in self.findings],
        }

    def table(self) -> list[tuple[str, ...]]:
        """Return segments, recordings to drop, or points as rows of text with a heading."""
        if self.segments:
            short = short_names([segment.file for segment in self.segments])
            rows = [(short[s.file], f"{s.begin:.6g}", f"{s.end:.6g}", s.settles) for s in self.segments]
            return [("file", "from [s]", "to [s]", "determines"), *rows]
        if self.drop:
            return [("adds least",), *((name,) for name in short_names(self.drop).values())]
        if self.run is None:
            return []
        names = list(self.run.columns)
        head = ("", *names, "block", "kind")
        listed: list[tuple[str, ...]] = [
            (str(k + 1), *(f"{self.run.columns[n][k]:.6g}" for n in names), str(self.run.block[k]), self.run.kind[k])
            for k in range(len(self.run.kind))
        ]
        return [head, *listed]

    def summary(self) -> list[str]:
        """Return what the design is predicted to do, a sentence a line."""
        lines = list(self.sentences)
        if self.segments and self.warmup > 0:
            lines.append(f"Begin each {self.warmup:.3g} s earlier, so that the function has settled.")
        if np.isfinite(self.factor) and not self.drop:
            lines.append(f"Predicted mean variance over the use: {100 * self.factor:.3g} % of today's.")
        return [*lines, *self.unsettled]

    def save(self, path: str | Path, *, follow: bool = False) -> Path:
        """Write the design as a table: .csv, .xlsx, .mf4, .parquet, or .json.

        Points are written in their order with block, kind, ramp and wait; segments and recordings as a list, which has
        no .mf4; planned manoeuvres as time tables, in .csv and .parquet one after the other.

        Args:
            path: the file; its extension selects the format.
            follow: a symbolic link stays one; otherwise it is replaced.

        Raises:
            InputError: the extension is unknown, or the file cannot be written.
        """
        from kennfeld.design.design_files import set_value_table, write_tables

        planned = list(self.tables)
        if self.run is not None:
            planned.append(set_value_table(self.run.columns, self.run.ramp, self.run.wait))
        return write_tables(Path(path), dict(self._tables()), planned, self.as_json(), follow=follow)

    def _tables(self) -> Iterator[tuple[str, Mapping[str, NDArray[Any]]]]:
        """Yield the tables of a design by name."""
        for table in self.tables:
            yield table.name, {"time": table.time, **table.columns}
        if self.run is not None:
            run = self.run
            number = np.arange(1, len(run.kind) + 1)
            further = {"block": run.block, "kind": np.array(run.kind), "ramp": run.ramp, "wait": run.wait}
            # a channel may have the name of one of these
            yield "points", {"number": number} | further | dict(run.columns)
        if self.segments:
            keys = ("file", "begin", "end", "settles")
            yield "segments", {key: np.array([getattr(segment, key) for segment in self.segments]) for key in keys}
        if self.drop:
            yield "drop", {"file": np.array(self.drop)}

    def __str__(self) -> str:
        rows = self.table()
        shown = rows[: MOST_ROWS + 1]
        more = len(rows) - len(shown)
        further = [f"and {count_noun(more, 'more row')}"] if more > 0 else []
        return "\n".join([*aligned(shown), *further, *self.summary()])


def stopped_early(design: Design, chosen: int, wanted: int, noun: str) -> Design:
    """Return a design that says, also by a warning, that its search was stopped; the same if all wanted were chosen."""
    if chosen >= wanted:
        return design
    message = f"stopped: {chosen} of {count_noun(wanted, noun)} were chosen"
    finding = Finding(Location("design"), message, severity="warning")
    return replace(design, findings=(*design.findings, finding), stopped=(chosen, wanted), stop_warning=finding)


# is given a function that makes the design so far, or None; True ends the search with it
Watch = Callable[[Callable[[], Design] | None], bool]


def _nested(values: Mapping[str, Float]) -> dict[str, Any]:
    return {name: nested_or_none(array) for name, array in values.items()}


def _deviations(content: Any) -> dict[str, Float]:
    """Return deviations as JSON has them, where None is undetermined."""
    return {name: np.asarray(_numbers(values), dtype=np.float64) for name, values in content.items()}


def _numbers(item: Any) -> Any:
    return [_numbers(each) for each in item] if isinstance(item, list) else np.inf if item is None else item

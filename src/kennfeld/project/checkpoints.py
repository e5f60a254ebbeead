"""Checkpoints of a search in the results folder, from which it can be resumed.

Each is a calibration file, `saves/START-ITERATION.json` or `saves/START-end.json`, which every command can read; a text
in it holds the state of the search and a checksum. Those of a run that was resumed with other settings or other data
stay beside the later ones, but their costs are not compared.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, field, replace
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import below, within
from kennfeld.calfiles import read
from kennfeld.calfiles.json_file import write_json
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.texts import Text
from kennfeld.optimize.fit.result import Checkpoint, StartResult
from kennfeld.optimize.search.start_runner import with_values

FOLDER, ASIDE, NOTE = "saves", "before", "kennfeld_save"
_NAME = re.compile(r"\d+-(\d+|end)\.json")


@dataclass(frozen=True)
class ResumePoints:
    """The checkpoint to resume each start from, and findings about the files."""

    states: Mapping[int, Checkpoint] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()


class Saves:
    """The checkpoints of one project in one results folder."""

    def __init__(self, results: Path, project: Path) -> None:
        self.folder, self.project = results / FOLDER, project
        self.mark = hashlib.sha256(project.read_bytes()).hexdigest()
        self.missed: Finding | None = None  # about the first checkpoint that could not be written
        self._fresh = False

    def resume_points(self) -> ResumePoints:
        """Return the best checkpoint of the last step of each start.

        Raises `InputError` if there is none. Unreadable files, as a power failure may leave, are reported and skipped.
        """
        saved, findings, marks, others = [], [], set(), set()
        for path in sorted(self.folder.glob("*.json")) if self.folder.is_dir() else ():
            if not _NAME.fullmatch(path.name):
                continue
            try:
                state, mark, file = _read(path)
            except (InputError, KeyError, TypeError, ValueError, StopIteration):
                message = "incomplete or damaged checkpoint, skipped"
                findings.append(Finding(Location(f"{FOLDER}/{path.name}"), message, severity="warning"))
                continue
            # several project files may share a results folder; earlier versions did not write the name
            if file not in ("", self.project.name):
                others.add(file)
                continue
            saved.append(state)
            marks.add(mark)
        if not saved:
            remedy = "Set save_every in [optimizer] and run without --resume first."
            if others:
                remedy = f"Those in it are of {join_names(sorted(others))}: {remedy[0].lower()}{remedy[1:]}"
            raise InputError(
                [*findings, Finding(Location.of_file(self.folder), "no checkpoint to resume from", remedy)]
            )
        if marks != {self.mark}:
            message = "changed since the checkpoints were written; the search resumes from their values"
            findings.append(Finding(Location(self.project.name), message, severity="warning"))
        return ResumePoints(_latest(saved), tuple(findings))

    def begin(self) -> None:
        """Start a new run: its first checkpoint moves those of the previous run into a subfolder."""
        self._fresh = True

    def _archive(self) -> None:
        aside = within(self.folder, ASIDE)
        old = [path for path in self.folder.glob("*.json") if _NAME.fullmatch(path.name)]
        for path in self.folder.glob(".*-*.json"):  # half written by a process that was killed
            path.unlink(missing_ok=True)
        if old:
            # one previous run is kept, not all of them
            for path in aside.glob("*.json") if aside.is_dir() else ():
                path.unlink(missing_ok=True)
            aside.mkdir(exist_ok=True)
        for path in old:
            path.replace(aside / path.name)
        self._fresh = False

    def keep(self, saved: Checkpoint, parameters: ParameterSet) -> None:
        """Write the free values of a checkpoint to the disk, completely or not at all.

        A checkpoint that cannot be written does not end the search; the reason is in `missed`.

        Args:
            saved: the checkpoint.
            parameters: those of the project.
        """
        current = with_values(parameters, saved.values)
        values = [current[name] for name in saved.values if name in current]
        note = _note(saved) | {"project": self.mark, "file": self.project.name}
        # a power failure may leave a file that is valid JSON with other numbers
        note |= {"checksum": _checksum(note, {value.name: value.values for value in values})}
        content = ParameterSet(values, texts=[Text(NOTE, json.dumps(note))])
        last = "end" if saved.ended else f"{saved.iteration:06d}"
        target = self.folder / f"{saved.start}-{last}.json"
        try:
            below(self.project.parent, self.folder).mkdir(parents=True, exist_ok=True)
            if self._fresh:
                self._archive()
            write_whole(target, write_json(content, target.name), durable=True)
            if not saved.ended:
                self._reopen(saved.start)
        except OSError as error:
            message = f"checkpoints cannot be written: {error.strerror or error}"
            self.missed = self.missed or Finding(Location.of_file(self.folder), message, severity="warning")

    def _reopen(self, start: int) -> None:
        """Rename the final checkpoint of a start that is continued to an intermediate one."""
        end = self.folder / f"{start}-end.json"
        if end.exists():
            with suppress(InputError, KeyError, TypeError, ValueError, StopIteration):
                end.replace(self.folder / f"{start}-{_read(end)[0].iteration:06d}.json")


def _note(saved: Checkpoint) -> dict[str, Any]:
    plain = {name: getattr(saved, name) for name in ("start", "step", "iteration", "stage", "problem")}
    ended = None if saved.ended is None else {name: _number(value) for name, value in asdict(saved.ended).items()}
    tables = [name for name in saved.values if not name.startswith("axis ")]
    axes = {name: points.tolist() for name, points in saved.values.items() if name not in tables}
    return plain | {"cost": _number(saved.cost), "free": tables, "axes": axes, "ended": ended}


def _number(value: Any) -> Any:
    return None if isinstance(value, float) and not isfinite(value) else value


def _checksum(note: Mapping[str, Any], values: Mapping[str, Float]) -> str:
    """Return the SHA-256 of a note, without its own checksum, and of values as a file keeps them."""
    text = json.dumps({name: value for name, value in note.items() if name != "checksum"}, sort_keys=True)
    digest = hashlib.sha256(text.encode())
    for name in sorted(values):
        # JSON has no infinity: as a file keeps them, numbers that are not finite are alike
        kept = np.where(np.isfinite(values[name]), values[name], np.nan)
        digest.update(f"{name} {kept.shape}".encode() + kept.tobytes())
    return digest.hexdigest()


def _read(path: Path) -> tuple[Checkpoint, str, str]:
    """Return a checkpoint, and the SHA-256 and the name of its project file. Raises `ValueError` if it is damaged."""
    content = read(path)
    note = json.loads(next(text.text for text in content.texts if text.name == NOTE))
    values = {parameter.name: parameter.values for parameter in content.values()}
    if "checksum" in note and note["checksum"] != _checksum(note, values):  # earlier versions wrote none
        raise ValueError("another checksum")
    row: dict[str, Any] | None = note["ended"] if path.stem.endswith("end") else None
    # null stands for numbers that JSON does not have: an infinite cost
    ended: dict[str, Any] = {name: inf if value is None else value for name, value in (row or {}).items()}
    state = Checkpoint(
        start=note["start"],
        step=note["step"],
        iteration=note["iteration"],
        stage=note["stage"],
        cost=inf if note["cost"] is None else note["cost"],
        values={name: content[name].values for name in note["free"]}
        | {name: np.array(points, dtype=np.float64) for name, points in note.get("axes", {}).items()},
        ended=None if row is None else StartResult(**ended),
        name=f"{FOLDER}/{path.name}",
        problem=note.get("problem", ""),
    )
    return state, note["project"], note.get("file", "")


def _latest(saved: list[Checkpoint]) -> dict[int, Checkpoint]:
    """Return the final checkpoint of each start, else the best of its last step, with the last iteration number."""
    latest: dict[int, Checkpoint] = {}
    for start in sorted({state.start for state in saved}):
        own = [state for state in saved if state.start == start]
        # at the same iteration, the end comes after the intermediate checkpoint
        newest = max(own, key=lambda state: (state.iteration, state.ended is not None))
        own = [state for state in own if state.problem == newest.problem]  # costs of others are not comparable
        step = max(state.step for state in own)
        best = min(
            (state for state in own if state.step == step),
            # the lowest cost, not the last one: a smoothed stage may raise the cost of the exact model on the way
            key=lambda state: (not _is_end(state, newest), state.cost, -state.iteration),
        )
        ended = best.ended if _is_end(best, newest) else None
        latest[start] = replace(best, iteration=newest.iteration, ended=ended)
    return latest


def _is_end(state: Checkpoint, newest: Checkpoint) -> bool:
    """Return whether a checkpoint is the end of a start, from which no later one goes on."""
    return state.ended is not None and state.iteration == newest.iteration

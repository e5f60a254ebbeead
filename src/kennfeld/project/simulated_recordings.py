"""The simulation of each recording by itself, as files for other tools hold it."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset
from kennfeld.measurement.writable_recording import WritableRecording
from kennfeld.preprocessing.model_step import recorded_samples
from kennfeld.preprocessing.prepared_files import cut
from kennfeld.project.simulation import SimulatedPart, Simulation


def simulated_recordings(simulation: Simulation) -> Iterator[WritableRecording]:
    """Yield the simulation of each file of each dataset, in order, at the samples of the file.

    A file whose time starts again yields a recording for each run, so that time increases within each. Only one
    recording is in memory at a time, as far as the simulation itself is evaluated part by part.
    """
    run: list[_Stretch] = []
    number = 1
    for stretch in _stretches(simulation):
        if run and stretch.file != run[0].file:
            yield _recording(run, number)
            run, number = [], 1
        elif run and not stretch.continues(run[-1]):
            yield _recording(run, number)
            run, number = [], number + 1
        run.append(stretch)
    if run:
        yield _recording(run, number)


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Neighbouring samples of one file; `file` are the name of the dataset and the short name of the file."""

    file: tuple[str, str]
    data: Dataset
    pieces: Int

    def continues(self, before: "_Stretch") -> bool:
        """Return whether time increases from the stretch before to this one; points without time always continue."""
        time, last = self.data.time, before.data.time
        return time is None or last is None or bool(time[0] > last[-1])


def _stretches(simulation: Simulation) -> Iterator[_Stretch]:
    """Yield the recorded samples of a simulation, cut between files and where time does not increase."""
    for part in simulation.parts():
        data, pieces = part.data, numbers_of_pieces(part)
        for first, last in pairwise(_edges(data)):
            own, numbers = cut(data, first, last), pieces[first:last]
            if own.recorded is not None:
                own, numbers = recorded_samples(own, own.recorded), numbers[own.recorded]
            if not own.samples:
                continue
            name = own.files.names[0] if own.files is not None else ""
            yield _Stretch((data.name, simulation.files.get(name, name)), own, numbers)


def numbers_of_pieces(part: SimulatedPart) -> Int:
    """Number the pieces of the samples of a part, from 1 within the dataset; Int[samples]."""
    data = part.data
    begins = np.zeros(data.samples, dtype=np.int64)
    begins[data.piece_starts[data.piece_starts < data.samples]] = 1
    return part.piece + np.cumsum(begins)


def _edges(data: Dataset) -> list[int]:
    """Return the first samples of files and of runs in time, and the end; empty if there are no samples."""
    if not data.samples:
        return []
    files = [] if data.files is None else np.cumsum(data.files.sizes(data.samples)).tolist()
    restarts = [] if data.time is None else (np.flatnonzero(np.diff(data.time) <= 0) + 1).tolist()
    return sorted({0, data.samples, *files, *restarts})


def _recording(run: list[_Stretch], number: int) -> WritableRecording:
    first = run[0].data
    dataset, file = run[0].file
    stem = file.rpartition(".")[0] or file
    name = dataset if stem in ("", dataset) else f"{dataset}: {file}"
    return WritableRecording(
        name=name if number == 1 else f"{name} ({number})",
        dataset=dataset,
        use=first.use,
        file=file,
        start_time=first.start_time if first.files is None else first.files.start_times[0],
        parts=[stretch.data for stretch in run],
        pieces=[stretch.pieces for stretch in run],
    )

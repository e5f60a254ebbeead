"""Recordings of the torque engine in files of a million points, and the same points without any file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from benchmarks.torque_data import COLUMNS, SPANS, parameters
from kennfeld.calfiles.files import write
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.preprocessing.prepared_files import DatasetRecipe, PreparedFile, PreparedFiles
from kennfeld.preprocessing.recording_sources import RecordingSource
from kennfeld.project.demo import torque
from kennfeld.project.demo.petrol_engine import torque as engine_torque

__all__ = ["GeneratedFiles", "generate", "write_fleet"]

Float = NDArray[np.float64]
POINTS = 1_000_000  # of a file
PARTITION = 4  # files
PROJECT = """\
[model]
file = "torque.kf"

[[dataset]]
name = "fleet"
files = ["bench_*.parquet"]

[calibration]
initial = "start.json"

[[criterion]]
node = "TorquePredict"
target = {{ channel = "Torque" }}

[optimizer]
continuation = "off"
max_iterations = {iterations}

[cluster]
partition = {partition}
"""


def generate(seed: int, points: int = POINTS) -> dict[str, Float]:
    """Random points with noise, by channel."""
    random = np.random.default_rng(seed)
    inputs = [random.uniform(*span, points) for span in SPANS]
    measured = engine_torque(*inputs) + random.normal(0.0, torque.NOISE, points)
    return dict(zip(COLUMNS, (*inputs, measured), strict=True))


def write_fleet(folder: Path, files: int, iterations: int, points: int = POINTS) -> Path:
    """Write a project with its recordings, and return the project file."""
    folder.mkdir(parents=True)
    for number in range(files):
        table = pa.table(generate(number, points))
        parquet.write_table(table, folder / f"bench_{number:03d}.parquet", compression="none", use_dictionary=False)
    (folder / "torque.kf").write_text(torque.FORMULA)
    write(parameters(520), folder / "start.json")
    project = folder / "kennfeld.toml"
    project.write_text(PROJECT.format(iterations=iterations, partition=PARTITION * points))
    return project


@dataclass(frozen=True)
class GeneratedFiles(PreparedFiles):
    """Files that exist nowhere: each is generated when it is read, and nothing is kept."""

    def file(self, recipe: DatasetRecipe, source: RecordingSource) -> PreparedFile:
        """Return the points of a file, whose address is its number."""
        columns = generate(int(source.address))
        channels = tuple(Channel(name, values) for name, values in columns.items())
        return PreparedFile(Dataset(recipe.entry.name, channels))

    def keep(self, *_: object) -> bool:
        """Keep nothing."""
        return False

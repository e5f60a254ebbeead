"""What `kennfeld surrogate train` reads: a file that says from which recordings a data-driven model is made."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.errors import Finding, InputError, nearest
from kennfeld.project.calculated import read_calculated
from kennfeld.project.loading import Wanted, load
from kennfeld.project.schema import CalibrationEntry, ModelEntry, OptimizerEntry, ProjectFile
from kennfeld.project.section import Section
from kennfeld.project.sections import read_datasets
from kennfeld.project.toml import read_toml
from kennfeld.project.training_section import read_settings
from kennfeld.surrogate import Surrogate
from kennfeld.surrogate.recordings import points_of, raster_of, runs_of
from kennfeld.surrogate.training import SurrogateSettings, train_surrogate

__all__ = ["Training", "read_training"]

SECTIONS = ("surrogate", "calculated", "dataset", "units")


@dataclass(frozen=True, eq=False)
class Training:
    """A training file: its data, the settings, and the file that the surrogate goes to."""

    data: ProjectFile
    settings: SurrogateSettings
    target: Path

    def datasets(self) -> list[Dataset]:
        """The recordings. Raises `InputError` with every problem of theirs."""
        findings: list[Finding] = []
        found = self._datasets(findings)
        if any(finding.severity == "error" for finding in findings):
            raise InputError(findings)
        return found

    def check(self) -> tuple[list[Dataset], list[Finding]]:
        """The recordings, and every problem of theirs, errors and warnings; nothing is trained."""
        findings: list[Finding] = []
        found = self._datasets(findings)
        if not any(finding.severity == "error" for finding in findings):
            findings += self._unfit(found)
        return found, list(dict.fromkeys(findings))

    def _datasets(self, findings: list[Finding]) -> list[Dataset]:
        calculated = read_calculated(self.data, findings)
        needed = dict.fromkeys(self.settings.inputs, "an input of the surrogate")
        needed[self.settings.output] = "the output of the surrogate"
        return load(self.data, Wanted(needed), calculated, findings).datasets

    def _unfit(self, datasets: list[Dataset]) -> Iterator[Finding]:
        """Why a model cannot be trained on the recordings, as far as that is known without doing it."""
        training = [one for one in datasets if one.use == "training"]
        if not training:
            yield Finding(self.data.place("[[dataset]]"), "no dataset is for training", 'Give one use = "training".')
            return
        tables = []
        try:
            step = raster_of(datasets, self.settings.step) if self.settings.kind == "dynamic" else 0.0
            tables = [table for one in training for table in self._tables(one, step)]
        except InputError as error:
            yield from error.findings
            return
        if not tables:
            what = "the training data have no piece without gaps that is long enough"
            yield Finding(self.data.place("[[dataset]]"), what, "Raise max_gap, or give other files.")
            return
        whole = np.concatenate(tables)
        for name, column in zip((*self.settings.inputs, self.settings.output), whole.T, strict=True):
            if np.ptp(column) == 0:
                what = f"channel {name} is {column[0]:g} in all training data"
                yield Finding(self.data.place("[surrogate]"), what, "Nothing can be learnt from it; leave it out.")

    def _tables(self, dataset: Dataset, step: float) -> list[Float]:
        """What is learnt from a dataset: Float[samples, inputs and output] a piece."""
        given = dataset, self.settings.inputs, self.settings.output
        if self.settings.kind == "dynamic":
            return [np.column_stack([run.u, run.y]) for run in runs_of(*given, step)]
        return [np.column_stack(points_of(*given))]

    def train(self, report: Callable[[str], None] = lambda line: None) -> Surrogate:
        """The surrogate; `report` hears how it goes on. Raises `InputError` where the data do not suffice."""
        return train_surrogate(self.datasets(), self.settings, report)


def read_training(path: str | Path) -> Training:
    """The values of a training file. Raises `InputError` with every problem of the file itself."""
    path, findings = Path(path), list[Finding]()
    tables = read_toml(path)
    if "surrogate" not in tables and "model" in tables:
        raise InputError.of(path.name, "this is a project, no training file", "Run `kennfeld calibrate`.")
    root = Section(tables, path.name, findings)
    settings, target = read_settings(root, path)
    data = ProjectFile(
        path=path,
        name=path.stem,
        model=ModelEntry(""),
        channels={},
        calculated=root.text_table("calculated"),
        datasets=read_datasets(root),
        calibration=CalibrationEntry(),
        axes={},
        parameters={},
        criteria=(),
        optimizer=OptimizerEntry(),
        units=root.text_table("units"),
    )
    _check_datasets(root)
    for key in root.values:
        if key not in SECTIONS:
            root.report(f"[{key}]", "is no section that a training file knows", nearest(key, SECTIONS))
    if any(finding.severity == "error" for finding in findings) or settings is None:
        raise InputError(findings)
    return Training(data, settings, path.parent / target)


def _check_datasets(root: Section) -> None:
    """Keys of `[[dataset]]` that a calibration knows, and a training does not."""
    for section in root.sections("dataset"):
        for key in ("weight", "weight_channel", "settle", "average", "step"):
            if section.has(key):
                section.report(key, f"{key} has no meaning in a training file", "Remove it.")
        shift = section.get("shift")
        if isinstance(shift, dict) and "auto" in shift.values():
            section.report("shift", '"auto" has no meaning in a training file', "Write the shift as a number.")

"""The data-driven models of the project: their quality, their training, and where they hold."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from kennfeld.app.answer import finite
from kennfeld.app.folders import confined
from kennfeld.app.questions.recordings import files
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys
from kennfeld.app.wire import ABSENT, Absent
from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.project.toml_file import is_training, read_toml

if TYPE_CHECKING:  # loaded when a surrogate is read
    from kennfeld.analysis.extrapolation import Extrapolation
    from kennfeld.surrogate.surrogate_file import Surrogate

RECORDED = (
    "name",
    "files",
    "dbc",
    "use",
    "raster",
    "where",
    "warmup",
    "max_gap",
    "steady",
)  # keys of training files, too


@dataclass(frozen=True)
class SurrogateQualityRow:
    """Errors of a surrogate on a dataset."""

    dataset: str
    use: str
    mode: str
    samples: int
    rmse: float | None
    r2: float | None
    max_abs: float | None = field(metadata={"wire": "max_abs"})


@dataclass(frozen=True)
class SurrogateRow:
    """A surrogate of the project, or a training file beside it; what follows `problem` is known of a trained one.

    Attributes:
        training: its training file, if there is one.
        training_problem: why that cannot be used.
        problem: why the file cannot be read.
        centres: number of basis functions.
        bounded: true if it knows where its training data lie.
    """

    name: str
    file: str
    state: Literal["trained", "not trained", "unreadable"]
    training: str = ""
    training_problem: str = ""
    problem: str | Absent = ABSENT
    inputs: Sequence[str] | Absent = ABSENT
    output: str | Absent = ABSENT
    unit: str | Absent = ABSENT
    centres: int | Absent = ABSENT
    step: float | Absent | None = ABSENT
    stability: str | Absent = ABSENT
    deviation: str | Absent = ABSENT
    remarks: Sequence[str] | Absent = ABSENT
    quality: Sequence[SurrogateQualityRow] | Absent = ABSENT
    bounded: bool | Absent = ABSENT


@dataclass(frozen=True)
class SurrogateRows:
    """The surrogates of the project, then training files whose surrogate it does not use."""

    surrogates: Sequence[SurrogateRow]


@dataclass(frozen=True)
class FarthestSample:
    """The sample of a dataset that is farthest outside of the training data."""

    sample: int
    piece: int
    time: float | None
    input: str
    value: float | None
    end: float | None
    sentence: str


@dataclass(frozen=True)
class ValidityRow:
    """The share of samples of a dataset at which a surrogate is used outside of its training data."""

    name: str
    dataset: str
    use: str
    samples: int
    outside: int | None
    worst: FarthestSample | None
    share: float
    text: str


@dataclass(frozen=True)
class ValidityRows:
    """Uses of surrogates outside of their training data, by surrogate and dataset."""

    rows: Sequence[ValidityRow]


@dataclass(frozen=True)
class TrainCommand:
    """A training file beside the project."""

    file: str


@dataclass(frozen=True)
class NewSurrogate:
    """A surrogate of a channel by others; `kind` is dynamic or static."""

    name: str
    inputs: Sequence[str]
    output: str
    kind: str = ""


@dataclass(frozen=True)
class WrittenTraining:
    """The training file that was written."""

    file: str


def surrogates(session: Session) -> SurrogateRows:
    """Return the surrogates of the project and the training files beside it, each with its state and quality."""
    folder = session.path.parent
    trainings = {each["target"]: each for each in _trainings(folder)}
    named = session.settings.get("surrogates")
    entries = {str(n): str(f) for n, f in named.items()} if isinstance(named, dict) else {}
    others = [("", file) for file in trainings if file not in entries.values()]
    rows = []
    for name, file in (*entries.items(), *others):
        training = trainings.get(file, {})
        row = _stored(name, file, folder / file)
        rows.append(replace(row, training=training.get("file", ""), training_problem=training.get("problem", "")))
    return SurrogateRows(rows)


def _trainings(folder: Path) -> Iterator[dict[str, str]]:
    """Yield the training files of a folder, with the file that each writes."""
    from kennfeld.project.surrogate_training import read_training

    for path in sorted(folder.glob("*.toml")):
        try:
            if not is_training(read_toml(path)):
                continue
            training = read_training(path)
        except InputError as error:
            yield {"file": path.name, "target": f"{path.stem}.json", "problem": " ".join(map(str, error.findings))}
        else:
            yield {"file": path.name, "target": training.target.name, "problem": ""}


def _stored(name: str, file: str, path: Path) -> SurrogateRow:
    """Return what the file of a surrogate says."""
    from kennfeld.surrogate.surrogate_file import read_surrogate

    if not path.is_file():
        return SurrogateRow(name, file, "not trained")
    try:
        return _described(name, file, read_surrogate(path))
    except InputError as error:
        return SurrogateRow(name, file, "unreadable", problem=" ".join(map(str, error.findings)))


def _described(name: str, file: str, own: "Surrogate") -> SurrogateRow:
    from kennfeld.surrogate.surrogate_file import deviation_note

    quality = [
        SurrogateQualityRow(
            *(line.dataset, line.use, line.mode, line.samples), finite(line.rmse), finite(line.r2), finite(line.max_abs)
        )
        for line in own.quality
    ]
    return SurrogateRow(
        name,
        file,
        "trained",
        inputs=list(own.inputs),
        output=own.output,
        unit=own.units[-1] if own.units else "",
        centres=own.expansion.size,
        step=getattr(own, "step", None),
        stability=getattr(own, "stability", ""),
        deviation=deviation_note(own),
        remarks=list(own.remarks),
        quality=quality,
        bounded=own.validity is not None,
    )


def validity(session: Session) -> ValidityRows:
    """Return by surrogate and dataset the share of samples outside of the training data, at the present values."""
    from kennfeld.analysis.extrapolation import find_extrapolation

    view = session.require_view()
    rows = find_extrapolation(view.model.problem, view.now.parameters)
    return ValidityRows([_validity_row(row) for row in rows])


def _validity_row(row: "Extrapolation") -> ValidityRow:
    worst = (
        None
        if row.worst is None
        else FarthestSample(
            *(row.worst.sample, row.worst.piece, row.worst.time, row.worst.input),
            *(finite(row.worst.value), finite(row.worst.end), row.worst.sentence),
        )
    )
    return ValidityRow(row.name, row.dataset, row.use, row.samples, row.outside, worst, row.share, str(row))


def train_surrogate(session: Session, asked: TrainCommand) -> None:
    """Train what a training file beside the project describes, in a process of its own."""
    session.training.start(confined(session.path.parent, asked.file))


def stop_training(session: Session) -> None:
    """End the training at once; the surrogate stays as it was."""
    session.training.stop()


def new_surrogate(session: Session, asked: NewSurrogate) -> WrittenTraining:
    """Write a training file for a surrogate from the datasets of the project, and name it in the project."""
    from kennfeld.project.document import ProjectDocument
    from kennfeld.project.surrogate_training import TrainingFile

    name, folder = asked.name.strip(), session.path.parent
    if not name.isidentifier():
        raise ArgumentError(f"name={name!r} must be a name that formula text can call, such as engine")
    path = folder / f"{name}.toml"
    if os.path.lexists(path) or name in session.settings.get("surrogates", {}):
        raise ArgumentError(f"{path.name} exists already; choose another name")
    document = ProjectDocument("", path, TrainingFile)
    entry: dict[str, Any] = {"inputs": list(asked.inputs), "output": asked.output}
    kind = {"kind": "dynamic"} if asked.kind == "dynamic" else {}
    document.set(("surrogate",), kind | entry)
    for section in ("calculated", "units"):
        if session.settings.get(section):
            document.set((section,), session.settings[section])
    for number, dataset in enumerate(_datasets(session, {*entry["inputs"], entry["output"]}), 1):
        document.set(("dataset", number), dataset)
    write_whole(path, document.text)
    session.do(SetKeys(f"New surrogate {name}", session.path.name, [(("surrogates", name), f"{name}.json")]))
    return WrittenTraining(path.name)


def _datasets(session: Session, channels: set[str]) -> Iterator[dict[str, Any]]:
    """Yield the datasets of the project all of whose files have these channels."""
    calculated = session.settings.get("calculated", {})
    for row in files(session).datasets:
        if row.use == "off":
            continue
        recorded = [{each.name for each in file.channels} | {*calculated} for file in row.files]
        if all(channels <= names for names in recorded):
            dataset = session.settings["dataset"][row.number - 1]
            yield {key: dataset[key] for key in RECORDED if key in dataset}

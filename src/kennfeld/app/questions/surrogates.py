"""The data-driven models of the project: their quality, their training, and where they hold."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld.app.answer import Answer, Given, finite
from kennfeld.app.folders import confined
from kennfeld.app.questions.recordings import files
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys
from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.project.toml_file import is_training, read_toml

if TYPE_CHECKING:  # loaded when a surrogate is read
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


def surrogates(session: Session, given: Given) -> Answer:
    """Return the surrogates of the project and the training files beside it, each with its state and quality."""
    folder = session.path.parent
    trainings = {each["target"]: each for each in _trainings(folder)}
    named = session.settings.get("surrogates")
    entries = {str(n): str(f) for n, f in named.items()} if isinstance(named, dict) else {}
    others = [("", file) for file in trainings if file not in entries.values()]
    rows = [
        {"name": name, "file": file, **_stored(folder / file), **_training_of(trainings, file)}
        for name, file in (*entries.items(), *others)
    ]
    return Answer({"surrogates": rows})


def _training_of(trainings: Mapping[str, Mapping[str, str]], file: str) -> dict[str, str]:
    training = trainings.get(file, {})
    return {"training": training.get("file", ""), "trainingProblem": training.get("problem", "")}


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


def _stored(path: Path) -> dict[str, Any]:
    """Return what the file of a surrogate says."""
    from kennfeld.surrogate.surrogate_file import read_surrogate

    if not path.is_file():
        return {"state": "not trained"}
    try:
        return {"state": "trained", **_described(read_surrogate(path))}
    except InputError as error:
        return {"state": "unreadable", "problem": " ".join(map(str, error.findings))}


def _described(own: "Surrogate") -> dict[str, Any]:
    quality = [
        asdict(line) | {name: finite(getattr(line, name)) for name in ("rmse", "r2", "max_abs")} for line in own.quality
    ]
    from kennfeld.surrogate.surrogate_file import deviation_note

    step = getattr(own, "step", None)
    return {
        "inputs": list(own.inputs),
        "output": own.output,
        "unit": own.units[-1] if own.units else "",
        "centres": own.expansion.size,
        "step": step,
        "stability": getattr(own, "stability", ""),
        "deviation": deviation_note(own),
        "remarks": list(own.remarks),
        "quality": quality,
        "bounded": own.validity is not None,
    }


def validity(session: Session, given: Given) -> Answer:
    """Return by surrogate and dataset the share of samples outside of the training data, at the present values."""
    from kennfeld.analysis.extrapolation import find_extrapolation

    view = session.require_view()
    rows = find_extrapolation(view.model.problem, view.now.parameters)
    return Answer({"rows": [row.as_json() | {"share": row.share, "text": str(row)} for row in rows]})


def train_surrogate(session: Session, given: Given) -> Answer:
    """Train what the training file `file` beside the project describes, in a process of its own."""
    session.training.start(confined(session.path.parent, str(given["file"])))
    return Answer()


def stop_training(session: Session, given: Given) -> Answer:
    """End the training at once; the surrogate stays as it was."""
    session.training.stop()
    return Answer()


def new_surrogate(session: Session, given: Given) -> Answer:
    """Write a training file for `name` from `inputs`, `output`, `kind` and the datasets of the project, and name it."""
    from kennfeld.project.document import ProjectDocument
    from kennfeld.project.surrogate_training import TrainingFile

    name, folder = str(given["name"]).strip(), session.path.parent
    if not name.isidentifier():
        raise ArgumentError(f"name={name!r} must be a name that formula text can call, such as engine")
    path = folder / f"{name}.toml"
    if os.path.lexists(path) or name in session.settings.get("surrogates", {}):
        raise ArgumentError(f"{path.name} exists already; choose another name")
    document = ProjectDocument("", path, TrainingFile)
    entry: dict[str, Any] = {"inputs": [str(each) for each in given["inputs"]], "output": str(given["output"])}
    kind = {"kind": "dynamic"} if given.get("kind") == "dynamic" else {}
    document.set(("surrogate",), kind | entry)
    for section in ("calculated", "units"):
        if session.settings.get(section):
            document.set((section,), session.settings[section])
    for number, dataset in enumerate(_datasets(session, {*entry["inputs"], entry["output"]}), 1):
        document.set(("dataset", number), dataset)
    write_whole(path, document.text)
    session.do(SetKeys(f"New surrogate {name}", session.path.name, [(("surrogates", name), f"{name}.json")]))
    return Answer({"file": path.name})


def _datasets(session: Session, channels: set[str]) -> Iterator[dict[str, Any]]:
    """Yield the datasets of the project all of whose files have these channels."""
    calculated = session.settings.get("calculated", {})
    for row in files(session, {}).head["datasets"]:
        recorded = [{each["name"] for each in file["channels"]} | {*calculated} for file in row["files"]]
        if all(channels <= names for names in recorded):
            dataset = session.settings["dataset"][row["number"] - 1]
            yield {key: dataset[key] for key in RECORDED if key in dataset}

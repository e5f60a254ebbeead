"""The keys of the project file as a page shows them, and the names that their values choose from."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

from kennfeld.app.questions.overview import FUNCTIONS, RECORDINGS, SCREENS, Screen
from kennfeld.app.questions.recordings import channel_names, recording_names
from kennfeld.app.session.session import Session
from kennfeld.app.wire import ABSENT, Absent
from kennfeld.base.errors import InputError
from kennfeld.base.file_state import while_unchanged
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles import describe, endings
from kennfeld.files.calibrations import IMAGE_ENDINGS
from kennfeld.files.file_format import Role
from kennfeld.files.formats import endings_of
from kennfeld.models.function_files import callable_endings
from kennfeld.project.key_descriptions import describe_sections
from kennfeld.project.schemas import ENDING

MAX_FILES = 2000  # of the folder that are listed
_FILES = {
    "function file": FUNCTIONS,
    "file of functions": callable_endings(),
    "surrogate file": endings_of(Role.SURROGATE),
    "recording": RECORDINGS,
    "CAN database": endings_of(Role.DATABASE),
    "calibration file": tuple(ending for ending in endings() if ending not in IMAGE_ENDINGS),
    "image": IMAGE_ENDINGS,
    "A2L file": endings_of(Role.DESCRIPTION),
}


FormKind = (
    Literal["text", "number", "integer", "flag", "choice", "texts", "numbers", "pair"]
    | Literal["table", "entry", "entries", "named", "either", "list", "toml"]
)


@dataclass(frozen=True)
class KeyForm:
    """The kind of a value, and what its field needs.

    Attributes:
        words: texts in place of a number.
        numbers: true for whole numbers among texts.
        names: the only names of a table.
        values: form of the values of a table.
        word: what messages call an entry.
        single: true if one table may stand for a list of one.
        forms: alternatives.
        item: form of the elements of a list.
    """

    kind: FormKind
    title: str | Absent = ABSENT
    least: float | Absent | None = ABSENT
    above: float | Absent | None = ABSENT
    most: float | Absent | None = ABSENT
    words: Sequence[str] | Absent = ABSENT
    options: Sequence[str] | Absent = ABSENT
    numbers: bool | Absent = ABSENT
    names: Sequence[str] | Absent = ABSENT
    values: "KeyForm | Absent" = ABSENT
    keys: "Sequence[KeyRow] | Absent" = ABSENT
    word: str | Absent = ABSENT
    single: bool | Absent = ABSENT
    forms: "Sequence[KeyForm] | Absent" = ABSENT
    item: "KeyForm | Absent" = ABSENT


@dataclass(frozen=True)
class KeyRow:
    """A key of the project file.

    Attributes:
        holds: what texts are: "channel", "condition" ...
        by: what the names of a table are.
    """

    name: str
    help: str
    type: str
    default: str
    required: bool
    unit: str
    holds: str
    by: str
    form: KeyForm


@dataclass(frozen=True)
class SectionRow(KeyRow):
    """A section of the project file, and the screen that shows it."""

    heading: str
    screen: Screen


@dataclass(frozen=True)
class SchemaReply:
    """The sections of the project file in the documented order."""

    sections: Sequence[SectionRow]


@dataclass(frozen=True)
class NamesReply:
    """Names that values choose from, by what the values are: "channel", "node", "image" ..."""

    names: Mapping[str, Sequence[str]]


def schema(session: Session) -> SchemaReply:
    """Return the sections of the project file with their screens and keys: form, default, unit and help."""
    return SchemaReply(_sections())


@cache
def _sections() -> list[SectionRow]:
    described = ({**each, "screen": SCREENS.get(each["name"], "parameters")} for each in describe_sections())
    return [SectionRow(**{**each, "form": _form(each["form"])}) for each in described]


def _form(described: Mapping[str, Any]) -> KeyForm:
    nested = {name: _NESTED[name](value) for name, value in described.items() if name in _NESTED}
    return KeyForm(**{**described, **nested})


def _key_row(described: Mapping[str, Any]) -> KeyRow:
    return KeyRow(**{**described, "form": _form(described["form"])})


_NESTED: Mapping[str, Callable[[Any], Any]] = {
    "keys": lambda keys: [_key_row(key) for key in keys],
    "values": _form,
    "item": _form,
    "forms": lambda forms: [_form(form) for form in forms],
}


def names(session: Session) -> NamesReply:
    """Return the names that values of keys choose from, by what the values are: "channel", "node", "image" ..."""
    function, settings = session.function, session.settings
    graph = None if function is None else function.graph
    nodes, inputs = (list(graph.names), list(graph.inputs)) if graph is not None else ([], [])
    channels = [*channel_names(session), *_keys(settings, "calculated")]
    parameters = [*(graph.parameters if graph is not None else ()), *_keys(settings, "parameters")]
    return NamesReply(
        {
            "channel": _unique(channels),
            "node": nodes,
            "input": _unique([*inputs, *nodes]),
            "parameter": _unique(parameters),
            "group axis": _keys(settings, "axes"),
            "variant": _variants(session),
            **_files(session.path.parent, set(recording_names(session))),
        }
    )


def _unique(words: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(words))


def _keys(settings: dict[str, Any], section: str) -> list[str]:
    table = settings.get(section)
    return list(table) if isinstance(table, dict) else []


def _files(folder: Path, recordings: Collection[str]) -> dict[str, list[str]]:
    """Return the files of a folder by what they can be; `recordings` of the project are nothing else."""
    files = (path.name for path in folder.iterdir() if path.is_file() and not path.name.endswith(ENDING))
    present = sorted(files)[:MAX_FILES]
    return {
        kind: [
            name for name in present if name.lower().endswith(ends) and (kind == "recording" or name not in recordings)
        ]
        for kind, ends in _FILES.items()
    }


def _variants(session: Session) -> list[str]:
    """Return the variants of the labels in the initial files."""
    calibration = session.settings.get("calibration")
    initial = calibration.get("initial", []) if isinstance(calibration, dict) else []
    items = initial if isinstance(initial, list) else [initial]
    return _unique(variant for item in items for variant in _variants_of_file(session.path.parent, item) if variant)


def _variants_of_file(folder: Path, item: Any) -> Iterator[str]:
    name, a2l = (item.get("hex"), item.get("a2l")) if isinstance(item, dict) else (item, None)
    try:
        path = folder / str(name)
        yield from _described_variants(path, folder / str(a2l) if a2l else None)
    except (InputError, OSError):
        return  # reported as a problem of the project


@while_unchanged(64)
def _described_variants(path: Path, a2l: Path | None) -> tuple[str, ...]:
    """Return the variants of the labels of a file."""
    return tuple(_unique(variant for each in describe(path, a2l).parameters for variant in each.variants))

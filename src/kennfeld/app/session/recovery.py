"""Unsaved edits on disk, so that a crash loses nothing."""

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from kennfeld.app.session.state import Restore, SessionState
from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import below, within
from kennfeld.calfiles.format import CalibrationSource
from kennfeld.calfiles.json_file import read_json, write_json
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter

FOLDER = ".kennfeld"  # beside the project file


@dataclass(frozen=True)
class KeptEdits:
    """Edits of a session that ended without saving, with the texts of files and the tables from which they began."""

    edits: Restore
    known: Mapping[str, str | None]
    tables: Mapping[str, Parameter]


class Recovery:
    """The unsaved edits of one project file."""

    def __init__(self, project: Path) -> None:
        self._project = project
        self.path = project.parent / FOLDER / f"{project.stem}.unsaved.json"

    def write(self, saved: SessionState, state: SessionState, known: Mapping[str, str | None]) -> None:
        """Keep what differs from the saved state. A folder that cannot be written is not an error.

        Args:
            saved: the state that was saved last.
            state: the present one.
            known: the texts of files from which the edits began.
        """
        if state == saved:
            self.remove()
            return
        texts = {name: text for name, text in state.texts.items() if text != saved.texts.get(name)}
        values = {
            name: {"shape": list(np.shape(v)), "values": np.ravel(v).tolist()} for name, v in state.values.items()
        }
        content = {"texts": texts, "values": values, "known": dict(known), "tables": _text(state.tables.values())}
        with suppress(OSError):
            below(self._project.parent, self.path).parent.mkdir(exist_ok=True)
            write_whole(self.path, json.dumps(content))

    def read(self) -> "KeptEdits | None":
        """Return the edits; None if there are none, or the file is damaged.

        The file may come from a stranger: only the project file and formula files within its folder are edited.
        """
        try:
            kept = json.loads(self.path.read_text(encoding="utf-8"))
            texts = {str(name): str(text) for name, text in kept["texts"].items() if self._is_edited(str(name))}
            entries = kept["values"].items()
            values = {str(name): np.array(v["values"], dtype=np.float64).reshape(v["shape"]) for name, v in entries}
            known = {str(name): None if text is None else str(text) for name, text in kept.get("known", {}).items()}
            tables = _tables(str(kept.get("tables", "{}")))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, InputError):
            return None
        # a file that names nothing to edit is not worth a question
        if not texts and not values:
            return None
        edits = Restore("Recovered unsaved edits", texts, values)
        # texts without a known beginning count as new files: whatever is on disk now is a conflict
        return KeptEdits(edits, {**dict.fromkeys(texts), **known}, {n: t for n, t in tables.items() if n in values})

    def _is_edited(self, name: str) -> bool:
        with suppress(OSError):
            within(self._project.parent, name)
            return name == self._project.name or name.lower().endswith(".kf")
        return False

    @property
    def exists(self) -> bool:
        """True if edits were kept."""
        return self.path.is_file()

    def remove(self) -> None:
        """Forget the edits."""
        with suppress(OSError):
            below(self._project.parent, self.path).unlink(missing_ok=True)


def _text(tables: Iterable[Parameter]) -> str:
    """Return tables as a `parameters.json`, each with axes of its own: they may be from different times."""
    own = (each.changed(axes=tuple(axis.changed(name="") for axis in each.axes)) for each in tables if each.axes)
    return write_json(ParameterSet(list(own)), "")


def _tables(text: str) -> dict[str, Parameter]:
    """Return the tables of a `parameters.json`. Raises `InputError` if it is damaged."""
    if text == "{}":
        return {}
    content = read_json(CalibrationSource("tables", text.encode())).parameters
    return {table.name: table for table in content.parameters}

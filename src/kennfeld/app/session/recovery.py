"""Unsaved edits on disk, so that a crash loses nothing."""

import json
from contextlib import suppress
from pathlib import Path

import numpy as np

from kennfeld.app.session.state import Restore, SessionState
from kennfeld.atomic_files import write_whole
from kennfeld.output_paths import below

FOLDER = ".kennfeld"  # beside the project file


class Recovery:
    """The unsaved edits of one project file."""

    def __init__(self, project: Path) -> None:
        self._project = project
        self.path = project.parent / FOLDER / f"{project.stem}.unsaved.json"

    def write(self, saved: SessionState, state: SessionState) -> None:
        """Keep what differs from the saved state. A folder that cannot be written is not an error."""
        if state == saved:
            self.remove()
            return
        texts = {name: text for name, text in state.texts.items() if text != saved.texts.get(name)}
        values = {
            name: {"shape": list(np.shape(v)), "values": np.ravel(v).tolist()} for name, v in state.values.items()
        }
        with suppress(OSError):
            below(self._project.parent, self.path).parent.mkdir(exist_ok=True)
            write_whole(self.path, json.dumps({"texts": texts, "values": values}))

    def read(self, saved: SessionState) -> Restore | None:
        """Return the command that brings the edits back; None if there are none, or the file is damaged."""
        try:
            kept = json.loads(self.path.read_text(encoding="utf-8"))
            texts = {str(name): str(text) for name, text in kept["texts"].items() if name in saved.texts}
            tables = kept["values"].items()
            values = {str(name): np.array(v["values"], dtype=np.float64).reshape(v["shape"]) for name, v in tables}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None
        return Restore("Recovered unsaved edits", texts, values) if texts or values else None

    @property
    def exists(self) -> bool:
        """True if edits were kept."""
        return self.path.is_file()

    def remove(self) -> None:
        """Forget the edits."""
        with suppress(OSError):
            below(self._project.parent, self.path).unlink(missing_ok=True)

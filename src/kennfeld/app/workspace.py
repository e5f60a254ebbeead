"""The open project that all pages share, and the answers to their questions."""

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from kennfeld import __version__
from kennfeld.app.answer import Answer, Given
from kennfeld.app.folders import confined, free_path
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.questions.overview import overview
from kennfeld.app.recent import forget, recent_projects, remember, summarise
from kennfeld.app.session.recovery import Recovery
from kennfeld.app.session.session import Session
from kennfeld.app.session.summary import summarise_session
from kennfeld.base.errors import ArgumentError, InputError, Location
from kennfeld.base.output_paths import plain_name
from kennfeld.project.demo import all_or_none, prepare, write
from kennfeld.project.schemas import PROJECT_SCHEMA, directive, schema_text

UPLOAD_ENDING = ".upload.part"
ABANDONED = 600.0  # s after which an upload is not in progress any more

Push = Callable[[str, Answer], None]


class AppWorkspace:
    """The open project of all pages. All methods are called from one thread."""

    def __init__(self, path: Path | None = None) -> None:
        self._push: Push = lambda topic, answer: None
        self._wake: Callable[[], object] = lambda: None
        self._changed_on_disk = False
        self.session: Session | None = None
        if path is not None:
            self.open(path)

    def subscribe(self, push: Push, wake: Callable[[], object]) -> None:
        """Set the functions that send news to all pages, and that have `pump` called in the thread of the session."""
        self._push, self._wake = push, wake

    def pump(self) -> None:
        """Handle what a running job has reported, and tell all pages."""
        if self.session is not None:
            runs = len(self.session.runs)
            self.session.pump()
            if len(self.session.runs) > runs:
                self._summarise()
            self._push("state", self.snapshot())

    def open(self, path: Path) -> None:
        """Open a project in place of the present one.

        Raises:
            InputError: it does not exist, or is not text.
        """
        if path.is_dir():
            path = path / "kennfeld.toml"
        if not path.is_file():
            raise InputError.of(Location(str(path)), "the project file does not exist", "Name a kennfeld.toml.")
        _remove_parts(path.parent)
        # before the present one is closed, which stays open if this fails
        session = Session(path.resolve(), lambda: self._wake())
        self.close()
        self.session = session
        remember(path)

    def answer(self, ask: str, given: Given) -> Answer:
        """Answer one question of a page. Raises `KennfeldError` if it cannot be answered."""
        if ask in _OWN:
            answer = _OWN[ask](self, given)
            # these do not change the open project
            if ask not in ("projects", "forget"):
                self._push("state", self.snapshot())
            return answer
        question = QUESTIONS.get(ask) or COMMANDS.get(ask)
        if question is None:
            raise ArgumentError(f"unknown question {ask!r}")
        if self.session is None:
            raise ArgumentError("no project is open")
        answer = question(self.session, given)
        if ask in COMMANDS:
            self._push("state", self.snapshot())
        if ask == "save":
            self._summarise()
        return answer

    def watch(self) -> None:
        """Tell all pages if the files on disk have changed, or are as saved again."""
        changed = self.session is not None and self.session.changed_on_disk
        if changed != self._changed_on_disk:
            self._changed_on_disk = changed
            self._push("state", self.snapshot())

    def close(self) -> None:
        """End a running calibration, and keep what the start page shows of the project."""
        if self.session is not None:
            self.session.close()
            self._summarise()

    def _summarise(self) -> None:
        assert self.session is not None
        summarise(self.session.path, summarise_session(self.session))

    def store(self, part: Path, name: str) -> Path:
        """Give an uploaded file its name, a free one of the folder of the project, and return its path."""
        target = free_path(self.folder(), name)
        part.replace(target)
        return target

    def folder(self) -> Path:
        """Return the folder of the project. Raises `ArgumentError` if none is open."""
        if self.session is None:
            raise ArgumentError("no project is open")
        return self.session.path.parent

    def download(self, name: str) -> Path:
        """Return a file of the project's folder. Raises `ArgumentError` if it is outside of it."""
        if self.session is None:
            raise ArgumentError("no project is open")
        return confined(self.session.path.parent, name)

    def snapshot(self) -> Answer:
        """Return the state that every page shows."""
        return Answer({"state": {"project": None} if self.session is None else overview(self.session)})


def _projects(workspace: AppWorkspace, given: Given) -> Answer:
    """Return recent projects with their summaries, the demos, and the folder in which new projects are made."""
    if workspace.session is not None:
        summarise(workspace.session.path, summarise_session(workspace.session))
    recent = [
        {
            "path": str(each.path),
            "name": each.path.parent.name,
            "folder": _short(each.path.parent),
            "opened": each.opened,
            "unsaved": Recovery(each.path).exists,
            "open": workspace.session is not None and workspace.session.path == each.path,
            **each.summary,
        }
        for each in recent_projects()
    ]
    return Answer({"recent": recent, "demos": DEMOS, "folder": _short(Path.cwd()), "version": __version__})


def _short(folder: Path) -> str:
    """Return a path as users write it: `~/calibration`."""
    home = Path.home()
    if not folder.is_relative_to(home):
        return str(folder)
    return "~" if folder == home else f"~/{folder.relative_to(home).as_posix()}"


def _forget(workspace: AppWorkspace, given: Given) -> Answer:
    forget(Path(str(given["path"])))
    return Answer()


def _open(workspace: AppWorkspace, given: Given) -> Answer:
    """Open a project, unless it is open already."""
    path = Path(str(given["path"])).expanduser()
    file = path / "kennfeld.toml" if path.is_dir() else path
    if workspace.session is None or workspace.session.path != file.resolve():
        workspace.open(file)
    return Answer()


def _remove_parts(folder: Path) -> None:
    """Remove what uploads to an earlier server left behind that was killed."""
    with suppress(OSError):
        for path in folder.glob(f".*{UPLOAD_ENDING}"):
            if time.time() - path.stat().st_mtime > ABANDONED:
                path.unlink(missing_ok=True)


def _demo(workspace: AppWorkspace, given: Given) -> Answer:
    """Write a demo into the working directory, unless it is there, and open it."""
    name = str(given["name"])
    folder = Path(f"kennfeld-demo-{name}")
    with all_or_none(folder):
        path = write(name, folder)
        prepare(name, path.parent, lambda line: None)
    workspace.open(path)
    return Answer()


NEW = f'{directive(PROJECT_SCHEMA)}\n\n[model]\nfile = "function.kf"\n'
NEW_FUNCTION = "# A line a node: name[unit] = expression\n"


def _new(workspace: AppWorkspace, given: Given) -> Answer:
    """Create an empty project in a new folder of the working directory, and open it.

    With `free`, the name is that of a file that was dropped, and a number is added if the folder exists.
    """
    name = str(given["name"]).strip()
    folder = free_path(Path(), Path(plain_name(name)).stem) if given.get("free") else Path(name or "project")
    folder = folder.expanduser()
    if folder.exists() and any(folder.iterdir()):
        raise InputError.of(Location(str(folder)), "the folder is not empty", "Choose another name.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "function.kf").write_text(NEW_FUNCTION, encoding="utf-8")
        (folder / PROJECT_SCHEMA).write_text(schema_text(PROJECT_SCHEMA), encoding="utf-8")
        (folder / "kennfeld.toml").write_text(NEW, encoding="utf-8")
    except OSError as error:
        raise InputError.of(Location(str(folder)), f"cannot be created: {error.strerror or error}") from None
    workspace.open(folder / "kennfeld.toml")
    return Answer()


DEMOS = [
    {
        "name": "torque",
        "title": "Engine torque",
        "text": "Three maps and a curve, steady points from a test bench.",
        "facts": "2839 + 1000 points, 519 values",
    },
    {
        "name": "exhaust",
        "title": "Exhaust gas temperature",
        "text": "A map and a time constant, 44 minutes of driving.",
        "facts": "26 482 + 12 000 samples, 154 values",
    },
    {
        "name": "idle",
        "title": "Idle speed governor",
        "text": "Two gains around an engine learnt from recordings.",
        "facts": "1500 samples, 2 values",
    },
]
_OWN: dict[str, Callable[[AppWorkspace, Given], Answer]] = {
    "projects": _projects,
    "open": _open,
    "demo": _demo,
    "new": _new,
    "forget": _forget,
}

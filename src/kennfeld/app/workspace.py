"""The open project that all pages share, and the answers to their questions."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from kennfeld import __version__
from kennfeld.app.answer import Answer
from kennfeld.app.folders import confined, free_path
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.questions.overview import AppState, NoProject, StateNews, overview
from kennfeld.app.recent import RecentProject, forget, recent_projects, remember, summarise
from kennfeld.app.session.recovery import Recovery
from kennfeld.app.session.session import Session
from kennfeld.app.session.summary import PictureLines, summarise_session
from kennfeld.app.wire import ABSENT, Absent, Question, from_json, questions_of, to_answer
from kennfeld.base.errors import ArgumentError, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
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

    def answer(self, ask: str, given: Mapping[str, Any]) -> Answer:
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
        state = NoProject() if self.session is None else overview(self.session)
        # what pages know, also of a project that was opened in place of another one
        self._changed_on_disk = isinstance(state, AppState) and state.changed_on_disk
        return to_answer(StateNews(state))


@dataclass(frozen=True)
class RecentRow:
    """A project that was opened before; the summary that follows `open` may lack any of its parts.

    Attributes:
        opened: when, in s since 1970; 0 if unknown.
        unsaved: true if it has unsaved edits.
        open: true if it is the open project.
        state: status of the last run, or the number of problems.
        problem: the first problem.
        file: formula file.
        node: of the first criterion.
        training: RMSE on training data.
        test: RMSE on test data.
        histogram: of the errors on training data.
        nodes: number of nodes.
        datasets: name, use and samples of each.
        parameters: number of free parameters.
        values: number of free values.
        run: the last run in words.
    """

    path: str
    name: str
    folder: str
    opened: float
    unsaved: bool
    open: bool
    state: str | Absent = ABSENT
    problem: str | Absent = ABSENT
    file: str | Absent = ABSENT
    node: str | Absent = ABSENT
    unit: str | Absent = ABSENT
    training: float | Absent = ABSENT
    test: float | Absent = ABSENT
    histogram: Sequence[float] | Absent = ABSENT
    nodes: int | Absent = ABSENT
    datasets: Sequence[tuple[str, str, int]] | Absent = ABSENT
    parameters: int | Absent = ABSENT
    values: int | Absent = ABSENT
    run: str | Absent = ABSENT
    without_data: int | Absent = ABSENT
    picture: PictureLines | Absent = ABSENT


@dataclass(frozen=True)
class DemoRow:
    """A demo that can be written."""

    name: str
    title: str
    text: str
    facts: str


@dataclass(frozen=True)
class KnownProjects:
    """Recent projects, the demos, the folder in which new projects are made, and the version of Kennfeld."""

    recent: Sequence[RecentRow]
    demos: Sequence[DemoRow]
    folder: str
    version: str


@dataclass(frozen=True)
class ProjectPath:
    """A project by its file or folder."""

    path: str


@dataclass(frozen=True)
class DemoName:
    """A demo by its name."""

    name: str


@dataclass(frozen=True)
class NewProject:
    """A new project.

    Attributes:
        name: of its folder.
        free: the name is that of a file that was dropped, and a number is added if the folder exists.
    """

    name: str
    free: bool = False


def _projects(workspace: AppWorkspace) -> KnownProjects:
    """Return recent projects with their summaries, the demos, and the folder in which new projects are made."""
    if workspace.session is not None:
        summarise(workspace.session.path, summarise_session(workspace.session))
    opened = None if workspace.session is None else workspace.session.path
    recent = [_recent_row(each, is_open=each.path == opened) for each in recent_projects()]
    return KnownProjects(recent, DEMOS, _short(Path.cwd()), __version__)


def _recent_row(own: RecentProject, *, is_open: bool) -> RecentRow:
    """Return a recent project; of a summary that another version has kept, nothing is shown."""
    row = {
        "path": str(own.path),
        "name": own.path.parent.name,
        "folder": _short(own.path.parent),
        "opened": own.opened,
        "unsaved": Recovery(own.path).exists,
        "open": is_open,
    }
    try:
        recent: RecentRow = from_json(RecentRow, {**row, **own.summary}, "recent")
    except ArgumentError:
        recent = from_json(RecentRow, row, "recent")
    return recent


def _short(folder: Path) -> str:
    """Return a path as users write it: `~/calibration`."""
    home = Path.home()
    if not folder.is_relative_to(home):
        return str(folder)
    return "~" if folder == home else f"~/{folder.relative_to(home).as_posix()}"


def _forget(workspace: AppWorkspace, asked: ProjectPath) -> None:
    forget(Path(asked.path))


def _open(workspace: AppWorkspace, asked: ProjectPath) -> None:
    """Open a project, unless it is open already."""
    path = Path(asked.path).expanduser()
    file = path / "kennfeld.toml" if path.is_dir() else path
    if workspace.session is None or workspace.session.path != file.resolve():
        workspace.open(file)


def _remove_parts(folder: Path) -> None:
    """Remove what uploads to an earlier server left behind that was killed."""
    with suppress(OSError):
        for path in folder.glob(f".*{UPLOAD_ENDING}"):
            if time.time() - path.stat().st_mtime > ABANDONED:
                path.unlink(missing_ok=True)


def _demo(workspace: AppWorkspace, asked: DemoName) -> None:
    """Write a demo into the working directory, unless it is there, and open it."""
    name = asked.name
    folder = Path(f"kennfeld-demo-{name}")
    with all_or_none(folder):
        path = write(name, folder)
        prepare(name, path.parent, lambda line: None)
    workspace.open(path)


NEW = f'{directive(PROJECT_SCHEMA)}\n\n[model]\nfile = "function.kf"\n'
NEW_FUNCTION = "# A line a node: name[unit] = expression\n"


def _new(workspace: AppWorkspace, asked: NewProject) -> None:
    """Create an empty project in a new folder of the working directory, and open it."""
    name = asked.name.strip()
    folder = free_path(Path(), Path(plain_name(name)).stem) if asked.free else Path(name or "project")
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


DEMOS = [
    DemoRow(
        "torque",
        "Engine torque",
        "Three maps and a curve, steady points from a test bench.",
        "2839 + 1000 points, 519 values",
    ),
    DemoRow(
        "exhaust",
        "Exhaust gas temperature",
        "A map and a time constant, 44 minutes of driving.",
        "26 482 + 12 000 samples, 154 values",
    ),
    DemoRow(
        "idle",
        "Idle speed governor",
        "Two gains around an engine learnt from recordings.",
        "1500 samples, 2 values",
    ),
]
_OWN: dict[str, Question[AppWorkspace]] = questions_of(
    {"projects": _projects, "open": _open, "demo": _demo, "new": _new, "forget": _forget}
)
